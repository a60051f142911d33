"""A report as one HTML file that needs nothing else."""

import base64
import html
from collections.abc import Mapping

from mrnav_server.study.figure import ReportFigure
from mrnav_server.study.report_content import Report, Section

_CSS = """
:root { color-scheme: light; }
body { margin: 0 auto; max-width: 1040px; padding: 24px; font: 15px/1.5 system-ui, sans-serif; color: #1b1f23;
  background: #fff; font-variant-numeric: tabular-nums; }
h1 { font-size: 26px; margin: 0 0 8px; } h2 { font-size: 20px; margin: 40px 0 8px; }
h3 { font-size: 15px; margin: 24px 0 6px; }
.origin { position: sticky; top: 0; padding: 8px 12px; border-left: 4px solid #d55e00; background: #fff4ec; }
.hardware { border-color: #0072b2; background: #eef6fc; }
nav a { margin-right: 16px; color: #0072b2; } h2 { scroll-margin-top: 56px; }
figure { margin: 24px 0; } figure img { width: 100%; height: auto; }
figcaption, .note { font-size: 13px; color: #4a5560; margin: 6px 0; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; border-top: 2px solid #1b1f23; border-bottom: 2px solid #1b1f23;
  font-size: 13px; }
th { text-align: left; font-weight: 600; border-bottom: 1px solid #1b1f23; vertical-align: bottom; }
th, td { padding: 3px 14px 3px 0; } td { white-space: nowrap; } .right { text-align: right; }
th.group { text-align: center; } th:empty { border-bottom: none; }
@media print { body { max-width: none; padding: 0; }
  nav { display: none; } .origin { position: static; } figure, tr { break-inside: avoid; } }
"""


def report_html(report: Report, pictures: Mapping[str, bytes]) -> str:
    """Return a report as one page.

    Args:
        report: What it holds.
        pictures: Every figure as SVG, by name.
    """
    links = "".join(f'<a href="#{_anchor(each)}">{html.escape(each.heading)}</a>' for each in report.sections)
    body = "\n".join(_section(each, report, pictures) for each in report.sections)
    kind = "origin" if "simulated" in report.origin else "origin hardware"
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>{html.escape(report.title)}</title><style>{_CSS}</style></head><body>\n"
        f"<h1>{html.escape(report.title)}</h1>"
        f'<p class="{kind}">{html.escape(report.origin.capitalize())}.</p><nav>{links}</nav>\n'
        f"{body}\n</body></html>\n"
    )


def _section(section: Section, report: Report, pictures: Mapping[str, bytes]) -> str:
    words = f"<p>{html.escape(section.words)}</p>" if section.words else ""
    items = "\n".join(
        _figure(each, report.number(each), pictures[each.name])
        if isinstance(each, ReportFigure)
        else each.html(report.number(each))
        for each in section.items
    )
    return f'<h2 id="{_anchor(section)}">{html.escape(section.heading)}</h2>\n{words}{items}'


def _figure(figure: ReportFigure, number: int, picture: bytes) -> str:
    inside = base64.b64encode(picture).decode()
    caption = html.escape(figure.caption)
    return (
        f'<figure><img alt="{html.escape(figure.title)}" src="data:image/svg+xml;base64,{inside}">'
        f"<figcaption><b>Figure {number}.</b> {caption}</figcaption></figure>"
    )


def _anchor(section: Section) -> str:
    return "".join(each if each.isalnum() else "-" for each in section.heading.lower())
