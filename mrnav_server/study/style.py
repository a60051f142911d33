"""One look for every figure of a report: sizes, colours, the watermark (docs/report.md)."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D

from mrnav_server.loops.trial_log import Condition

# Okabe and Ito's colours, as on the pages; colour-blind readers tell them apart.
BLUE, VERMILION, GREEN, GRAY = "#0072B2", "#D55E00", "#009E73", "#666666"
WIDTH_IN, COLUMN_IN = 7.2, 3.46
"""Two columns of a journal, 183 mm, and one, 88 mm."""

_STYLE: dict[Any, object] = {
    "font.family": "sans-serif",
    # The first comes with matplotlib, so figures are the same everywhere; Verdana is as wide, for SVG.
    "font.sans-serif": ["DejaVu Sans", "Verdana"],
    "font.size": 7.5,
    "axes.titlesize": 8.0,
    "axes.labelsize": 7.5,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.2,
    "savefig.dpi": 300,
    "pdf.fonttype": 42,  # journals ask for fonts that are outlines, not Type 3
    "svg.fonttype": "none",  # text stays text: an editor, and a journal, can change it
    "svg.hashsalt": "mrnav",  # the same figure gives the same file
}


@dataclass(frozen=True, slots=True)
class Look:
    """How a condition is drawn: colour, and marker and line for who sees none."""

    label: str
    color: str
    marker: str
    line: Literal["-", "--"]


LOOKS: Mapping[Condition, Look] = {
    "without_autonomy": Look("without", VERMILION, "s", "--"),
    "with_autonomy": Look("with autonomy", BLUE, "o", "-"),
}
"""The conditions, in the order in which they are drawn."""


@contextmanager
def styled() -> Iterator[None]:
    """Draw in the report's style inside the block."""
    with mpl.rc_context(_STYLE):
        yield


def panel_grid(figure: FigureBase, count: int, across: int) -> list[Axes]:
    """Return panels, row by row; what the last row has too many is left empty."""
    cells = figure.subplots(-(-count // across), across, squeeze=False).ravel()
    for spare in cells[count:]:
        spare.axis("off")
    return list(cells)


def put_legend(figure: FigureBase, panels: list[Axes], count: int, handles: list[Artist]) -> None:
    """Explain the marks: in the first empty cell of a grid, or else below it."""
    if len(panels) > count:
        panels[count].legend(handles=handles, loc="center")
    else:
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))


def published_mean() -> Line2D:
    """Return the mark of a published mean, for a legend."""
    return Line2D(
        [], [], marker="D", color="black", mfc="white", linestyle="", ms=4.5, label="published mean"
    )


def letter(place: int) -> str:
    """Return a panel's letter, for example ``(a)``."""
    return f"({chr(ord('a') + place)})"


def watermark(figure: FigureBase, text: str) -> None:
    """Write across a figure what it is not."""
    width_in = figure.get_window_extent().width / figure.get_figure(root=True).dpi
    look: dict[str, Any] = {"fontsize": 6.1 * width_in, "color": GRAY, "alpha": 0.16, "zorder": 9}
    figure.text(0.5, 0.5, text, rotation=25, ha="center", va="center", **look)
