"""A report as PDF: its sections one after the other on A4 pages, figures as vectors."""

import textwrap
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure, FigureBase

from mrnav_server.study.figure import ReportFigure
from mrnav_server.study.pdf_table import table_blocks
from mrnav_server.study.report_content import Report
from mrnav_server.study.report_table import Table
from mrnav_server.study.style import GRAY, VERMILION, WIDTH_IN

_PAGE_IN = (8.27, 11.69)
_TOP_IN, _BOTTOM_IN = 0.75, 0.65
_ROOM_IN = _PAGE_IN[1] - _TOP_IN - _BOTTOM_IN
_GAP_IN = 0.22
_LINE_IN = 0.155
_HEADING_IN = 0.42
_CHARACTERS = 130
"""About so many fit on a line at 7.5 points."""


@dataclass(frozen=True, slots=True)
class Block:
    """What stays together on a page.

    Attributes:
        height_in: How much of it.
        draw: Draws it onto a figure of that height.
    """

    height_in: float
    draw: Callable[[FigureBase], None]


Item = Callable[[float], list[Block]]
"""Gives its blocks, told how much of the page is left in inches."""


def write_pdf(report: Report, path: Path) -> None:
    """Write a report."""
    pages = list(_pages(_items(report)))
    metadata = {"Title": report.title, "Subject": report.origin, "CreationDate": None}
    with PdfPages(path, metadata=metadata) as file:
        for number, blocks in enumerate(pages, start=1):
            file.savefig(_page(report, blocks, f"{number} / {len(pages)}"))


def _pages(items: Iterable[Item]) -> Iterator[list[Block]]:
    page: list[Block] = []
    left_in = _ROOM_IN
    for item in items:
        for block in item(left_in):
            if page and block.height_in > left_in:
                yield page
                page, left_in = [], _ROOM_IN
            page.append(block)
            left_in -= block.height_in + _GAP_IN
    if page:
        yield page


def _page(report: Report, blocks: list[Block], number: str) -> Figure:
    page = Figure(figsize=_PAGE_IN, layout="constrained")
    layout = page.get_layout_engine()
    assert layout is not None
    layout.set(w_pad=0.04, h_pad=0.04, wspace=0.0, hspace=0.0)  # type: ignore[call-arg]
    heights_in = [_TOP_IN]
    for block in blocks:
        heights_in += [block.height_in, _GAP_IN]
    heights_in.append(max(_PAGE_IN[1] - sum(heights_in), 0.01))
    side_in = (_PAGE_IN[0] - WIDTH_IN) / 2.0
    parts = page.subfigures(
        len(heights_in),
        3,
        squeeze=False,
        wspace=0.0,
        hspace=0.0,
        height_ratios=heights_in,
        width_ratios=[side_in, WIDTH_IN, side_in],
    )
    for part, block in zip(parts[1::2, 1], blocks, strict=False):
        block.draw(part)
    edge = side_in / _PAGE_IN[0]
    simulated = "simulated" in report.origin
    page.text(edge, 0.965, report.title, fontsize=7.5, color=GRAY)
    page.text(
        1 - edge, 0.965, report.origin, fontsize=7.5, ha="right", color=VERMILION if simulated else GRAY
    )
    page.text(0.5, 0.025, number, fontsize=7.5, ha="center", color=GRAY)
    return page


def _items(report: Report) -> Iterator[Item]:
    yield _whole([Block(0.45, _line(report.title, 16.0))])
    for section in report.sections:
        # Its heading and words stay with what follows.
        ahead = [Block(_HEADING_IN, _line(section.heading, 12.0))]
        if section.words:
            ahead.append(_words(section.words))
        if not section.items:
            yield _whole(ahead)
        for item in section.items:
            number = report.number(item)
            if isinstance(item, ReportFigure):
                yield _whole([*ahead, _figure(item, number)])
            else:
                yield partial(_table, ahead, item, number)
            ahead = []


def _whole(blocks: list[Block]) -> Item:
    return lambda _: [_together(blocks)]


def _table(ahead: list[Block], table: Table, number: int, room_in: float) -> list[Block]:
    ahead_in = sum(block.height_in for block in ahead)
    parts = table_blocks(table, number, room_in - ahead_in, _ROOM_IN - ahead_in)
    first, *others = (Block(part.height_in, part.draw) for part in parts)
    return [_together([*ahead, first]), *others]


def _together(blocks: list[Block]) -> Block:
    if len(blocks) == 1:
        return blocks[0]

    def draw(figure: FigureBase) -> None:
        ratios = [block.height_in for block in blocks]
        parts = figure.subfigures(len(blocks), 1, squeeze=False, hspace=0.0, height_ratios=ratios)
        for part, block in zip(parts[:, 0], blocks, strict=True):
            block.draw(part)

    return Block(sum(block.height_in for block in blocks), draw)


def _figure(figure: ReportFigure, number: int) -> Block:
    caption = _words(f"Figure {number}. {figure.caption}")
    return _together([Block(figure.height_in, figure.onto), caption])


def _line(text: str, size: float) -> Callable[[FigureBase], None]:
    def draw(figure: FigureBase) -> None:
        figure.text(0.0, 0.25, text, fontsize=size, fontweight="bold", va="bottom")

    return draw


def _words(text: str) -> Block:
    lines = textwrap.wrap(text, _CHARACTERS)

    def draw(figure: FigureBase) -> None:
        figure.text(0.0, 1.0, "\n".join(lines), fontsize=7.5, va="top", linespacing=1.35)

    return Block(_LINE_IN * (len(lines) + 0.6), draw)
