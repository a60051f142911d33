"""Writes a study's report: HTML, PDF, figures and tables as files (docs/report.md)."""

import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from matplotlib.figure import Figure

from mrnav_server.study.latex_table import latex_table
from mrnav_server.study.report_content import report
from mrnav_server.study.report_html import report_html
from mrnav_server.study.report_pdf import write_pdf
from mrnav_server.study.study_data import Study
from mrnav_server.study.style import styled

Kind = Literal["svg", "png"]
_KINDS: tuple[Kind, ...] = ("svg", "png")


@dataclass(frozen=True, slots=True)
class WrittenReport:
    """Where a report's files are.

    Attributes:
        html, pdf: The report.
        files: Everything that was written.
    """

    html: Path
    pdf: Path
    files: tuple[Path, ...]


def write_study_report(
    study: Study, folder: Path, on_file: Callable[[int, int], None] = lambda done, total: None
) -> WrittenReport:
    """Write a study's report into a folder, which is made.

    The same study gives the same files.

    Args:
        study: What was read.
        folder: For ``report.html``, ``report.pdf``, ``figures/`` and ``tables/``.
        on_file: Told how many files of how many are written.
    """
    content = report(study)
    total = 2 + 4 * len(content.figures) + 2 * len(content.tables) + len(content.files)
    written: list[Path] = []

    def keep(path: Path, data: bytes) -> Path:
        path.write_bytes(data)
        return note(path)

    def note(path: Path) -> Path:
        written.append(path)
        on_file(len(written), total)
        return path

    for part in ("figures", "tables"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    with styled():
        pictures = {}
        for figure in content.figures:
            for ending, narrow in (("", False), ("-column", True)):
                drawn = figure.alone(narrow)
                for kind in _KINDS:
                    data = picture(drawn, kind)
                    keep(folder / "figures" / f"{figure.name}{ending}.{kind}", data)
                    # Laid out once: the other kind is the same picture.
                    drawn.set_layout_engine("none")
                    if (kind, narrow) == ("svg", False):
                        pictures[figure.name] = data
        html = keep(folder / "report.html", report_html(content, pictures).encode())
        write_pdf(content, folder / "report.pdf")
        pdf = note(folder / "report.pdf")
    for table in (*content.tables, *content.files):
        keep(folder / "tables" / f"{table.name}.csv", table.csv().encode())
    for table in content.tables:
        keep(folder / "tables" / f"{table.name}.tex", latex_table(table, content.origin).encode())
    return WrittenReport(html, pdf, tuple(written))


def picture(figure: Figure, kind: Kind) -> bytes:
    """Return a figure as a file; the same figure gives the same bytes."""
    file = io.BytesIO()
    figure.savefig(file, format=kind, metadata={"Date": None} if kind == "svg" else {"Software": None})
    return file.getvalue()
