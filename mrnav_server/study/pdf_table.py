"""A table drawn on pages: ruled above and below, split where a page ends."""

import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

from matplotlib.figure import FigureBase
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.textpath import text_to_path

from mrnav_server.study.report_table import DIGIT_SPACE, POINT_SPACE, Table
from mrnav_server.study.style import WIDTH_IN

_LARGEST_PT, _SMALLEST_PT = 7.5, 4.6
_LEAST_GAP_EM, _MOST_GAP_EM = 1.0, 2.4
_ROW_IN = 0.165
_TITLE_IN = 0.3
_NOTE_IN = 0.135
_NOTE_CHARACTERS = 152
_LONG, _LEAST = 30, 8
"""A table of more rows is split; so many of them at least begin it on a page."""
_HEADER_WIDTH = 13
"""Header lines are broken after so many characters."""


@dataclass(frozen=True, slots=True)
class TableBlock:
    """A part of a table on one page: its height and what draws it."""

    height_in: float
    draw: Callable[[FigureBase], None]


def table_blocks(table: Table, number: int, room_in: float, page_in: float) -> list[TableBlock]:
    """Return a table's parts, each with the header, the last with the notes.

    Args:
        table: The table.
        number: Which of the report's tables it is.
        room_in: What is left of the page; a first part that is higher goes onto the next one.
        page_in: Room of a whole page.
    """
    names = [textwrap.wrap(name, _HEADER_WIDTH) or [""] for name in table.names]
    cells, rights = table.texts, table.rights
    widths_em = [max(map(_em, [*lines, *(row[n] for row in cells)])) for n, lines in enumerate(names)]
    widths_em = _room_for_groups(widths_em, table.groups)
    gaps = max(len(names) - 1, 1)
    size_pt = min(_LARGEST_PT, 72.0 * WIDTH_IN / (sum(widths_em) + _LEAST_GAP_EM * gaps))
    size_pt = max(size_pt, _SMALLEST_PT)
    # Narrow tables spread out, and end where their last column does.
    gap_em = min((72.0 * WIDTH_IN / size_pt - sum(widths_em)) / gaps, _MOST_GAP_EM)
    grid = _Grid(_columns_in(widths_em, gap_em, size_pt), rights, names, table.groups, size_pt)
    notes = [line for note in table.notes for line in textwrap.wrap(note, _NOTE_CHARACTERS)]
    around_in = _TITLE_IN + _ROW_IN * grid.header_lines + 0.1
    fitting = [int((each - around_in - _NOTE_IN * len(notes)) / _ROW_IN) for each in (room_in, page_in)]
    parts = _split(cells, *fitting)
    blocks = []
    for part, rows in enumerate(parts, start=1):
        title = f"Table {number}. {table.title}" + (", continued" if part > 1 else "")
        below = notes if part == len(parts) else []
        height_in = around_in + _ROW_IN * len(rows) + _NOTE_IN * len(below)
        draw = partial(_draw, height_in=height_in, title=title, grid=grid, rows=rows, notes=below)
        blocks.append(TableBlock(height_in, draw))
    return blocks


def _split(rows: list[list[str]], here: int, page: int) -> list[list[list[str]]]:
    """Return rows in parts: as many as fit here, if that is worth it, then as many as fit on a page."""
    if len(rows) <= _LONG:
        return [rows]
    first = here if here >= _LEAST else page
    return [rows[:first], *(rows[at : at + page] for at in range(first, len(rows), page))]


@dataclass(frozen=True, slots=True)
class _Grid:
    """How a table is set: the left and right edge of each column, and what stands above them."""

    columns_in: list[tuple[float, float]]
    rights: list[bool]
    names: list[list[str]]
    groups: list[tuple[str, int]]
    size_pt: float

    @property
    def grouped(self) -> bool:
        return any(title for title, _ in self.groups)

    @property
    def header_lines(self) -> int:
        return max(map(len, self.names)) + self.grouped


def _room_for_groups(widths_em: list[float], groups: list[tuple[str, int]]) -> list[float]:
    """Return the columns' widths, widened where the heading above them needs more."""
    wider, at = list(widths_em), 0
    for title, count in groups:
        lacking_em = _em(title) - sum(wider[at : at + count]) - _LEAST_GAP_EM * (count - 1)
        for column in range(at, at + count):
            wider[column] += max(lacking_em, 0.0) / count
        at += count
    return wider


def _columns_in(widths_em: list[float], gap_em: float, size_pt: float) -> list[tuple[float, float]]:
    edges, at_em = [], 0.0
    for width_em in widths_em:
        edges.append((at_em * size_pt / 72.0, (at_em + width_em) * size_pt / 72.0))
        at_em += width_em + gap_em
    return edges


def _draw(
    figure: FigureBase, *, height_in: float, title: str, grid: _Grid, rows: list[list[str]], notes: list[str]
) -> None:
    def put(x_in: float, down_in: float, text: str, size: float = grid.size_pt) -> None:
        y = 1.0 - down_in / height_in
        figure.text(x_in / WIDTH_IN, y, text, fontsize=size, va="center", parse_math=False)

    def put_in(column: int, down_in: float, text: str) -> None:
        left_in, right_in = grid.columns_in[column]
        # What is set to the right is so by its measured width, which counts the spaces at its end.
        put(right_in - _em(text) * grid.size_pt / 72.0 if grid.rights[column] else left_in, down_in, text)

    def rule(down_in: float, width: float, from_in: float, to_in: float) -> None:
        y = 1.0 - down_in / height_in
        ends = [from_in / WIDTH_IN, to_in / WIDTH_IN]
        figure.add_artist(Line2D(ends, [y, y], color="black", linewidth=width))

    width_in = grid.columns_in[-1][1]
    figure.text(0.0, 1.0 - 0.12 / height_in, title, fontsize=8.5, fontweight="bold", va="center")
    down_in = _TITLE_IN
    rule(down_in, 1.0, 0.0, width_in)
    first = 0
    for group, count in grid.groups:
        left_in, right_in = grid.columns_in[first][0], grid.columns_in[first + count - 1][1]
        if group:
            middle_in = (left_in + right_in - _em(group) * grid.size_pt / 72.0) / 2.0
            put(middle_in, down_in + 0.5 * _ROW_IN, group)
            rule(down_in + _ROW_IN, 0.4, left_in, right_in)
        first += count
    for column, lines in enumerate(grid.names):
        # Names of several lines end on the same one.
        for line, name in enumerate(lines, start=grid.header_lines - len(lines)):
            put_in(column, down_in + (line + 0.5) * _ROW_IN, name)
    down_in += grid.header_lines * _ROW_IN
    rule(down_in, 0.5, 0.0, width_in)
    for row in rows:
        for column, cell in enumerate(row):
            put_in(column, down_in + 0.5 * _ROW_IN, cell)
        down_in += _ROW_IN
    rule(down_in, 1.0, 0.0, width_in)
    for note in notes:
        down_in += _NOTE_IN
        put(0.0, down_in, note, 6.5)


@cache
def _em(text: str) -> float:
    """Return a text's width in units of its font's size."""
    font = FontProperties(family="DejaVu Sans", size=10.0)
    # A space at the end has no ink, and would not be measured.
    inked = text.replace(DIGIT_SPACE, "0").replace(POINT_SPACE, ".")
    width, _, _ = text_to_path.get_text_width_height_descent(inked, font, ismath=False)
    return float(width) / 10.0
