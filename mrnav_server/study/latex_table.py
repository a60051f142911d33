"""A table of a report for LaTeX: with ``booktabs``, where it is long with ``longtable``; pure ASCII."""

import re
from itertools import accumulate

from mrnav_server.study.report_table import DIGIT_SPACE, POINT_SPACE, Table

_SIGNS = {
    "\\": r"\textbackslash{}",
    **{each: "\\" + each for each in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "−": "$-$",
    "±": r"$\pm$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "µ": r"$\mu$",
    "–": "--",
    "·": r"$\cdot$",
    "…": r"\ldots{}",
    "Δ": r"$\Delta$",
    "α": r"$\alpha$",
    "σ": r"$\sigma$",
    DIGIT_SPACE: r"\phantom{0}",
    POINT_SPACE: r"\phantom{.}",
}
_WORDS = {"d_z": "$d_z$", "r_rb": r"$r_\mathrm{rb}$"}
_RAISED, _LOWERED = "⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "₋₀₁₂₃₄₅₆₇₈₉"
_PLAIN = "-0123456789"
_PIECE = re.compile(rf"{'|'.join(_WORDS)}|[{_RAISED}]+|[{_LOWERED}]+|.", re.DOTALL)
_LONG, _WIDE, _WIDER = 45, 55, 95
"""More rows go over several pages; rows of more characters over both columns, or are set smaller."""


def latex_table(table: Table, origin: str) -> str:
    """Return a table for LaTeX, whose caption says where its figures come from."""
    columns = "".join("r" if right else "l" for right in table.rights)
    caption = rf"\caption{{{_latex(f'{table.title} ({origin}).')}}}\label{{tab:{table.name}}}"
    head = [r"\toprule", *_groups(table), _row(table.names), r"\midrule"]
    rows = [_row(row) for row in table.texts]
    notes = [rf"\par\smallskip\raggedright {_latex(note)}" for note in table.notes]
    columns_of = zip(table.names, *table.texts, strict=True)
    width = sum(max(map(len, column)) for column in columns_of)
    size = (r"\scriptsize" if width > _WIDER else r"\footnotesize") + r"\setlength{\tabcolsep}{3pt}"
    if len(rows) > _LONG:
        lines = [
            r"% \usepackage{booktabs,longtable}, and \onecolumn where a journal has two",
            rf"{{{size}",
            rf"\begin{{longtable}}{{{columns}}}",
            rf"{caption}\\",
            *head,
            r"\endfirsthead",
            *head,
            r"\endhead",
            r"\bottomrule",
            r"\endlastfoot",
            *rows,
            r"\end{longtable}",
            *notes,
            r"\par}",
        ]
    else:
        place = "table*" if width > _WIDE else "table"
        lines = [
            r"% \usepackage{booktabs}",
            rf"\begin{{{place}}}",
            rf"\centering{size}",
            caption,
            rf"\begin{{tabular}}{{{columns}}}",
            *head,
            *rows,
            r"\bottomrule",
            r"\end{tabular}",
            *notes,
            rf"\end{{{place}}}",
        ]
    return "\n".join(lines) + "\n"


def _groups(table: Table) -> list[str]:
    """Return the row of headings and the rules under them; nothing without any."""
    groups = table.groups
    if not any(title for title, _ in groups):
        return []
    ends = list(accumulate(count for _, count in groups))
    cells = [rf"\multicolumn{{{count}}}{{c}}{{{_latex(title)}}}" if title else "" for title, count in groups]
    rules = [
        rf"\cmidrule(lr){{{end - count + 1}-{end}}}"
        for (title, count), end in zip(groups, ends, strict=True)
        if title
    ]
    return [" & ".join(cells) + r" \\", "".join(rules)]


def _row(texts: list[str]) -> str:
    return " & ".join(map(_latex, texts)) + r" \\"


def _latex(words: str) -> str:
    return "".join(map(_piece, _PIECE.findall(words))).encode("ascii", "replace").decode()


def _piece(piece: str) -> str:
    if piece in _WORDS:
        return _WORDS[piece]
    if piece[0] in _RAISED:
        return f"$^{{{piece.translate(str.maketrans(_RAISED, _PLAIN))}}}$"
    if piece[0] in _LOWERED:
        return f"$_{{{piece.translate(str.maketrans(_LOWERED, _PLAIN))}}}$"
    return _SIGNS.get(piece, piece)
