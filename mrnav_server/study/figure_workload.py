"""NASA-TLX as a chart: weighted and raw workload, and the six scales."""

from typing import Any

import numpy as np
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D

from mrnav_server.study import published
from mrnav_server.study.measures import WORKLOAD
from mrnav_server.study.report_tables import Analyses
from mrnav_server.study.style import LOOKS, published_mean

_WIDTH = 0.36


def draw_workload(figure: FigureBase, narrow: bool, *, analyses: Analyses) -> None:
    """Draw a group of two bars for each score."""
    axes = figure.subplots()
    for side, (condition, look) in enumerate(LOOKS.items()):
        for group, measure in enumerate(WORKLOAD):
            pairs = analyses[measure.symbol].samples.pairs()
            values = pairs.first if condition == "with_autonomy" else pairs.second
            place = group + (side - 0.5) * (_WIDTH + 0.04)
            if values.size:
                spread = float(values.std(ddof=1)) if values.size > 1 else 0.0
                axes.bar(place, values.mean(), _WIDTH, color=look.color, alpha=0.35, zorder=1)
                axes.errorbar(place, values.mean(), spread, color=look.color, capsize=2.5, linewidth=1.1)
            aside = 0.1 * np.sin(2.4 * np.arange(values.size))
            axes.scatter(place + aside, values, s=8, c=look.color, marker=look.marker, linewidths=0, zorder=3)
            known = published.TLX.get(measure.symbol)
            if known is not None:
                axes.plot(place, known[condition], "D", color="black", mfc="white", ms=4.5, zorder=4)
    turned: dict[str, Any] = {"rotation": 40, "ha": "right", "rotation_mode": "anchor"} if narrow else {}
    axes.set_xticks(range(len(WORKLOAD)), [measure.title for measure in WORKLOAD], **turned)
    axes.set_xlim(-0.6, len(WORKLOAD) - 0.4)
    axes.set_ylim(-4.0, 104.0)
    axes.axhline(0.0, color="black", linewidth=0.6)
    axes.set_ylabel("score ↓ (0 to 100)")
    legend = [
        *(
            Line2D([], [], marker=look.marker, color=look.color, linestyle="", ms=4, label=look.label)
            for look in LOOKS.values()
        ),
        published_mean(),
    ]
    figure.legend(handles=legend, loc="outside lower center", ncols=len(legend))
