"""A table drawn on pages: ruled above and below, split where a page ends."""

import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from matplotlib.figure import FigureBase
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.textpath import text_to_path

from mrnav_server.study.report_table import Table
from mrnav_server.study.style import WIDTH_IN

_LARGEST_PT, _SMALLEST_PT = 7.5, 4.6
_LEAST_GAP_EM, _MOST_GAP_EM = 1.0, 2.4
_ROW_IN = 0.165
_TITLE_IN = 0.3
_NOTE_IN = 0.135
_NOTE_CHARACTERS = 152
_ROWS = 52
"""At most so many on a page."""
_HEADER_WIDTH = 13
"""Header lines are broken after so many characters."""


@dataclass(frozen=True, slots=True)
class TableBlock:
    """A part of a table on one page: its height and what draws it."""

    height_in: float
    draw: Callable[[FigureBase], None]


def table_blocks(table: Table) -> list[TableBlock]:
    """Return a table's parts, each with the header, the last with the notes."""
    header = [textwrap.wrap(table.header[n], _HEADER_WIDTH) or [""] for n in table.shown]
    cells = [[row[n].text for n in table.shown] for row in table.rows]
    rights = [table.to_the_right(n) for n in table.shown]
    widths_em = [max(map(_em, [*names, *(row[n] for row in cells)])) for n, names in enumerate(header)]
    gaps = max(len(header) - 1, 1)
    size_pt = min(_LARGEST_PT, 72.0 * WIDTH_IN / (sum(widths_em) + _LEAST_GAP_EM * gaps))
    size_pt = max(size_pt, _SMALLEST_PT)
    # Narrow tables spread out, and end where their last column does.
    gap_em = min((72.0 * WIDTH_IN / size_pt - sum(widths_em)) / gaps, _MOST_GAP_EM)
    edges_in = _edges_in(widths_em, rights, gap_em, size_pt)
    width_in = (sum(widths_em) + gap_em * (len(header) - 1)) * size_pt / 72.0
    notes = [line for note in table.notes for line in textwrap.wrap(note, _NOTE_CHARACTERS)]
    parts = [cells[at : at + _ROWS] for at in range(0, len(cells), _ROWS)] or [[]]
    blocks = []
    for number, rows in enumerate(parts):
        title = table.title if number == 0 else f"{table.title}, continued"
        below = notes if number == len(parts) - 1 else []
        lines = max(map(len, header))
        height_in = _TITLE_IN + _ROW_IN * (len(rows) + lines) + 0.1 + _NOTE_IN * len(below)
        draw = partial(
            _draw,
            height_in=height_in,
            title=title,
            header=header,
            rows=rows,
            notes=below,
            edges_in=edges_in,
            width_in=width_in,
            rights=rights,
            size_pt=size_pt,
        )
        blocks.append(TableBlock(height_in, draw))
    return blocks


def _edges_in(widths_em: list[float], rights: list[bool], gap_em: float, size_pt: float) -> list[float]:
    """Return where each column's text begins, or ends where it is set to the right."""
    edges, at_em = [], 0.0
    for width_em, right in zip(widths_em, rights, strict=True):
        edges.append((at_em + (width_em if right else 0.0)) * size_pt / 72.0)
        at_em += width_em + gap_em
    return edges


def _draw(
    figure: FigureBase,
    *,
    height_in: float,
    title: str,
    header: list[list[str]],
    rows: list[list[str]],
    notes: list[str],
    edges_in: list[float],
    width_in: float,
    rights: list[bool],
    size_pt: float,
) -> None:
    def put(x_in: float, down_in: float, text: str, size: float, *, right: bool = False) -> None:
        figure.text(
            x_in / WIDTH_IN,
            1.0 - down_in / height_in,
            text,
            fontsize=size,
            ha="right" if right else "left",
            va="center",
            parse_math=False,
        )

    def rule(down_in: float, width: float) -> None:
        y = 1.0 - down_in / height_in
        figure.add_artist(Line2D([0.0, width_in / WIDTH_IN], [y, y], color="black", linewidth=width))

    figure.text(0.0, 1.0 - 0.12 / height_in, title, fontsize=8.5, fontweight="bold", va="center")
    down_in = _TITLE_IN
    rule(down_in, 1.0)
    lines = max(map(len, header))
    for x_in, right, names in zip(edges_in, rights, header, strict=True):
        # Names of several lines end on the same one.
        for row_number, name in enumerate(names, start=lines - len(names)):
            put(x_in, down_in + (row_number + 0.5) * _ROW_IN, name, size_pt, right=right)
    down_in += lines * _ROW_IN
    rule(down_in, 0.5)
    for row in rows:
        for x_in, right, cell in zip(edges_in, rights, row, strict=True):
            put(x_in, down_in + 0.5 * _ROW_IN, cell, size_pt, right=right)
        down_in += _ROW_IN
    rule(down_in, 1.0)
    for line in notes:
        down_in += _NOTE_IN
        put(0.0, down_in, line, 6.5)


def _em(text: str) -> float:
    """Return a text's width in units of its font's size."""
    font = FontProperties(family="DejaVu Sans", size=10.0)
    width, _, _ = text_to_path.get_text_width_height_descent(text, font, ismath=False)
    return float(width) / 10.0
