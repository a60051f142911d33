"""A table of a report: shown in HTML and PDF, kept as CSV and LaTeX."""

import csv
import html
import io
import math
from dataclasses import dataclass

_LATEX = {
    "\\": r"\textbackslash{}",
    **{each: "\\" + each for each in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "−": "$-$",
    "±": r"$\pm$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "µ": r"\textmu{}",
    "³": r"\textsuperscript{3}",
    "–": "--",
    "·": r"$\cdot$",
    "…": r"\ldots{}",
    "Δ": r"$\Delta$",
    "α": r"$\alpha$",
    "σ": r"$\sigma$",
    **{each: rf"\textsuperscript{{{plain}}}" for each, plain in zip("⁰¹²⁴⁵⁶⁷⁸⁹⁻", "012456789-", strict=True)},
}
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
        header: One name a column.
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

    def to_the_right(self, column: int) -> bool:
        """Whether a column holds numbers."""
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

    def latex(self) -> str:
        """Return the table for LaTeX with the package booktabs; pure ASCII."""
        shown = self.shown
        lines = [
            r"\begin{table}",
            rf"\caption{{{_latex(self.title)}}}",
            rf"\begin{{tabular}}{{{''.join('r' if self.to_the_right(n) else 'l' for n in shown)}}}",
            r"\toprule",
            " & ".join(_latex(self.header[n]) for n in shown) + r" \\",
            r"\midrule",
            *(" & ".join(_latex(row[n].text) for n in shown) + r" \\" for row in self.rows),
            r"\bottomrule",
            r"\end{tabular}",
            *(rf"\par\footnotesize {_latex(note)}" for note in self.notes),
            r"\end{table}",
        ]
        return "\n".join(lines) + "\n"

    def html(self) -> str:
        """Return the table as HTML."""
        shown = self.shown
        side = ["right" if self.to_the_right(n) else "left" for n in range(len(self.header))]
        head = "".join(f'<th class="{side[n]}">{html.escape(self.header[n])}</th>' for n in shown)
        body = "\n".join(
            "<tr>"
            + "".join(f'<td class="{side[n]}">{html.escape(row[n].text)}</td>' for n in shown)
            + "</tr>"
            for row in self.rows
        )
        notes = "".join(f"<p class='note'>{html.escape(note)}</p>" for note in self.notes)
        return (
            f'<section class="table"><h3>{html.escape(self.title)}</h3>'
            f'<div class="wide"><table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>'
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


def _latex(words: str) -> str:
    return "".join(_LATEX.get(each, each) for each in words).encode("ascii", "replace").decode()
