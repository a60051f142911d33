"""One look for every figure of a report: sizes, colours, the watermark (docs/report.md)."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import matplotlib as mpl
from matplotlib.figure import FigureBase

from mrnav_server.loops.trial_log import Condition

# Okabe and Ito's colours, as on the pages; colour-blind readers tell them apart.
BLUE, VERMILION, GREEN, GRAY = "#0072B2", "#D55E00", "#009E73", "#666666"
WIDTH_IN = 7.2
"""Two columns of a journal."""

_STYLE: dict[Any, object] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so figures are the same everywhere
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
    "savefig.dpi": 200,
    "pdf.fonttype": 42,  # journals ask for fonts that are outlines, not Type 3
    "svg.fonttype": "path",
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


def watermark(figure: FigureBase, text: str) -> None:
    """Write across a figure what it is not."""
    figure.text(
        0.5, 0.5, text, rotation=25, ha="center", va="center", fontsize=44, color=GRAY, alpha=0.16, zorder=9
    )
