"""Box plots of measures by condition, and each operator's own pair."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from mrnav_server.core.arrays import FloatArray
from mrnav_server.loops.trial_log import Condition
from mrnav_server.study.measures import Measure
from mrnav_server.study.report_table import p_value
from mrnav_server.study.statistics import Analysis
from mrnav_server.study.style import GRAY, LOOKS

_TRIALS = "#B8B8B8"
_LEAST_SPAN = 6.0
"""Of an axis, in units of the last decimal shown."""


def draw_boxes(
    figure: FigureBase,
    measures: Sequence[Measure],
    analyses: Mapping[str, Analysis],
    known: Mapping[str, Mapping[Condition, float]],
) -> None:
    """Draw a box plot of the operators' means for each measure.

    Args:
        figure: Where.
        measures: One panel each.
        analyses: By symbol.
        known: Published means by symbol; empty for none.
    """
    panels = figure.subplots(1, len(measures), squeeze=False)[0]
    for axes, measure in zip(panels, measures, strict=True):
        analysis = analyses[measure.symbol]
        for place, (condition, look) in enumerate(LOOKS.items()):
            trials = analysis.samples.pooled(condition)
            if not trials.size:
                axes.text(
                    place,
                    0.5,
                    "not defined",
                    rotation=90,
                    color=GRAY,
                    ha="center",
                    va="center",
                    transform=axes.get_xaxis_transform(),
                )
            means = _operator_means(analysis, condition)
            _spread_out(axes, place, trials, color=_TRIALS, marker=".", size=5)
            _box(axes, place, means, look.color)
            _spread_out(axes, place, means, color=look.color, marker=look.marker, size=9)
            if measure.symbol in known:
                axes.plot(
                    place, known[measure.symbol][condition], "D", color="black", mfc="white", ms=4.5, zorder=6
                )
        _describe(axes, measure)
        # A measure that one condition does not have is not compared.
        if not math.isnan(analysis.paired_holm):
            axes.set_title(f"{axes.get_title()}\n$p$ = {p_value(analysis.paired_holm).text}")
        else:
            axes.set_title(f"{axes.get_title()}\n")
    legend = [
        Line2D([], [], marker=".", color=_TRIALS, linestyle="", label="trial"),
        *(
            Line2D(
                [],
                [],
                marker=look.marker,
                color=look.color,
                linestyle="",
                ms=4,
                label=f"operator, {look.label}",
            )
            for look in LOOKS.values()
        ),
    ]
    if known:
        legend.append(
            Line2D(
                [], [], marker="D", color="black", mfc="white", linestyle="", ms=4.5, label="published mean"
            )
        )
    figure.legend(handles=legend, loc="outside lower center", ncols=len(legend))


def draw_pairs(figure: FigureBase, measures: Sequence[Measure], analyses: Mapping[str, Analysis]) -> None:
    """Draw each operator's mean without and with autonomy, joined."""
    panels = figure.subplots(1, len(measures), squeeze=False)[0]
    for axes, measure in zip(panels, measures, strict=True):
        pairs = analyses[measure.symbol].samples.pairs()
        sign = 1.0 if measure.better == "higher" else -1.0
        better = sign * pairs.differences > 0
        for first, second, good in zip(pairs.first, pairs.second, better, strict=True):
            line = {"color": GRAY, "linewidth": 0.8} if good else {"color": "black", "linestyle": ":"}
            axes.plot([0, 1], [second, first], **line)
        for place, (values, look) in enumerate(zip((pairs.second, pairs.first), LOOKS.values(), strict=True)):
            axes.plot(np.full(values.size, place), values, look.marker, color=look.color, ms=4)
        if pairs.first.size:
            axes.plot([0, 1], [pairs.second.mean(), pairs.first.mean()], color="black", linewidth=2.2)
        _describe(axes, measure)
        axes.set_title(f"{axes.get_title()}\n{int(better.sum())} of {better.size} better")
    legend = [
        Line2D([], [], color=GRAY, linewidth=0.8, label="an operator, better with autonomy"),
        Line2D([], [], color="black", linestyle=":", label="an operator, not better"),
        Line2D([], [], color="black", linewidth=2.2, label="mean"),
    ]
    figure.legend(handles=legend, loc="outside lower center", ncols=len(legend))


def _operator_means(analysis: Analysis, condition: str) -> FloatArray:
    own: dict[str, list[float]] = {}
    for row in analysis.samples.rows:
        if row.condition == condition and not math.isnan(row.value):
            own.setdefault(row.participant, []).append(row.value)
    return np.array([np.mean(values) for values in own.values()])


def _box(axes: Axes, place: int, values: FloatArray, color: str) -> None:
    if values.size:
        line = {"color": color, "linewidth": 1.1}
        axes.boxplot(
            values,
            positions=[place],
            widths=0.5,
            showfliers=False,
            manage_ticks=False,
            boxprops=line,
            whiskerprops=line,
            capprops=line,
            medianprops={"color": color, "linewidth": 2.0},
        )


def _spread_out(axes: Axes, place: int, values: FloatArray, *, color: str, marker: str, size: float) -> None:
    """Draw values one beside the other, in a fixed order, so that equal ones stay apart."""
    aside = 0.17 * np.sin(2.4 * np.arange(values.size))
    axes.scatter(place + aside, values, s=size, c=color, marker=marker, linewidths=0, zorder=3, alpha=0.85)


def _describe(axes: Axes, measure: Measure) -> None:
    axes.set_xticks(range(len(LOOKS)), [look.label.removesuffix(" autonomy") for look in LOOKS.values()])
    axes.set_xlim(-0.6, len(LOOKS) - 0.4)
    axes.yaxis.set_major_locator(MaxNLocator(5))
    # Differences that the tables do not even show are not blown up.
    low, high = axes.get_ylim()
    wider = max(_LEAST_SPAN * 10.0**-measure.decimals - (high - low), 0.0)
    below = wider / 2.0 if axes.dataLim.ymin < 0 else min(wider / 2.0, max(low, 0.0))
    axes.set_ylim(low - below, high + wider - below)
    axes.set_title(f"{measure.title} {measure.arrow}")
    axes.set_ylabel(" / ".join(filter(None, (measure.symbol, measure.unit))))
