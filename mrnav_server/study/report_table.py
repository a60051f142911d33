"""A table of a report: shown in HTML and PDF, kept as CSV and LaTeX."""

import csv
import html
import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

DIGIT_SPACE, POINT_SPACE = "\u2007", "\u2008"
"""As wide as a digit and as the decimal point."""
_GROUP = ": "
_NUMBER = re.compile(r"−?\d+(\.\d+)?|–")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True, slots=True)
class Cell:
    """What a table holds in one place.

    Attributes:
        text: As it is read.
        value: As it is computed with; None where there is none.
    """

    text: str
    value: float | str | None


@dataclass(frozen=True, slots=True)
class Table:
    """A table.

    Attributes:
        name: Of its files.
        title: Above it.
        header: One name a column, no two the same. Neighbours named ``group: name`` stand under one heading.
        rows: Cells, as many as there are names.
        notes: Below it.
        file_only: Names of columns that the CSV alone holds.
    """

    name: str
    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()
    file_only: tuple[str, ...] = ()

    @property
    def shown(self) -> tuple[int, ...]:
        """Numbers of the columns that are read."""
        return tuple(n for n, name in enumerate(self.header) if name not in self.file_only)

    @property
    def names(self) -> list[str]:
        """What stands above each shown column."""
        return [self.header[n].rpartition(_GROUP)[2] for n in self.shown]

    @property
    def groups(self) -> list[tuple[str, int]]:
        """Headings above the names, "" for none, each with how many shown columns it stands over."""
        titles = [self.header[n].rpartition(_GROUP)[0] for n in self.shown]
        found = []
        for title, same in groupby(titles):
            count = len(list(same))
            found += [(title, count)] if title else [("", 1)] * count
        return found

    @property
    def texts(self) -> list[list[str]]:
        """The shown cells, row by row; the decimal points of a column stand one below the other."""
        columns = [_aligned([row[n].text for row in self.rows]) for n in self.shown]
        return [list(row) for row in zip(*columns, strict=True)]

    @property
    def rights(self) -> list[bool]:
        """Whether each shown column holds numbers, which are set to the right."""
        return [self._holds_numbers(n) for n in self.shown]

    def _holds_numbers(self, column: int) -> bool:
        cells = [row[column] for row in self.rows]
        return any(isinstance(cell.value, float) for cell in cells) and not any(
            isinstance(cell.value, str) for cell in cells
        )

    def csv(self) -> str:
        """Return the table as CSV, numbers in full."""
        file = io.StringIO()
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(self.header)
        writer.writerows(["" if cell.value is None else cell.value for cell in row] for row in self.rows)
        return file.getvalue()

    def html(self, number: int) -> str:
        """Return the table as HTML, numbered."""
        side = ["right" if right else "left" for right in self.rights]
        above = ""
        if any(title for title, _ in self.groups):
            cells = (
                f'<th class="group" colspan="{count}">{html.escape(title)}</th>' if title else "<th></th>"
                for title, count in self.groups
            )
            above = f"<tr>{''.join(cells)}</tr>"
        head = _html_row("th", self.names, side)
        body = "\n".join(_html_row("td", row, side) for row in self.texts)
        notes = "".join(f"<p class='note'>{html.escape(note)}</p>" for note in self.notes)
        return (
            f'<section class="table"><h3>Table {number}. {html.escape(self.title)}</h3>'
            f'<div class="wide"><table><thead>{above}{head}</thead>\n<tbody>{body}</tbody></table></div>'
            f"{notes}</section>"
        )


def text(words: str) -> Cell:
    """Return a cell of words."""
    return Cell(words, words)


def number(value: float, decimals: int) -> Cell:
    """Return a cell of a number; a dash where it is not defined."""
    if math.isnan(value):
        return Cell("–", None)
    # −0.00 is no number a reader should meet.
    shown = round(value, decimals) + 0.0
    return Cell(f"{shown:.{decimals}f}".replace("-", "−"), float(value))


def p_value(p: float) -> Cell:
    """Return a cell of a p: three digits after the point, a power of ten below a thousandth."""
    if math.isnan(p):
        return Cell("–", None)
    if p >= 0.001:
        return Cell(f"{p:.3f}", float(p))
    if p == 0.0:
        return Cell("0", 0.0)
    mantissa, power = f"{p:.0e}".split("e")
    return Cell(f"{mantissa}·10{str(int(power)).translate(_RAISED)}", float(p))


def _aligned(texts: Sequence[str]) -> list[str]:
    """Return numbers followed by as much space as brings their points below one another."""
    if not all(map(_NUMBER.fullmatch, texts)):
        return list(texts)
    decimals = [len(each.partition(".")[2]) for each in texts]
    most = max(decimals, default=0)
    return [
        each + (POINT_SPACE if most and not own else "") + DIGIT_SPACE * (most - own)
        for each, own in zip(texts, decimals, strict=True)
    ]


def _html_row(tag: str, texts: Sequence[str], side: Sequence[str]) -> str:
    cells = (
        f'<{tag} class="{where}">{html.escape(each)}</{tag}>' for each, where in zip(texts, side, strict=True)
    )
    return f"<tr>{''.join(cells)}</tr>"
