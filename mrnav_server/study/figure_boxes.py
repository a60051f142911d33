"""Box plots of measures by condition, and each operator's own pair."""

import math
import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from mrnav_server.core.arrays import FloatArray
from mrnav_server.loops.trial_log import Condition
from mrnav_server.study.measures import Measure
from mrnav_server.study.report_table import p_value
from mrnav_server.study.statistics import Analysis
from mrnav_server.study.style import GRAY, LOOKS, letter, panel_grid, published_mean, put_legend

_TRIALS = "#A6A6A6"
_LEAST_SPAN = 6.0
"""Of an axis, in units of the last decimal shown."""
_TITLE_CHARACTERS = 16
_NARROW_ACROSS = 2
_BOX_ASIDE = 0.1
"""The trials stand at the left of the box, which makes room for them."""


def draw_boxes(
    figure: FigureBase,
    narrow: bool,
    *,
    measures: Sequence[Measure],
    analyses: Mapping[str, Analysis],
    known: Mapping[str, Mapping[Condition, float]],
) -> None:
    """Draw a box plot of the operators' means for each measure.

    Args:
        figure: Where.
        narrow: Whether it is as wide as one column alone.
        measures: One panel each.
        analyses: By symbol.
        known: Published means by symbol; empty for none.
    """
    panels = panel_grid(figure, len(measures), _NARROW_ACROSS if narrow else len(measures))
    titles = _titles(measures)
    for axes, measure, title in zip(panels, measures, titles, strict=False):
        analysis = analyses[measure.symbol]
        counts = []
        for tick, (condition, look) in enumerate(LOOKS.items()):
            means = operator_means(analysis, condition)
            counts.append(means.size)
            if not means.size:
                _say_undefined(axes, tick)
            trials = analysis.samples.pooled(condition)
            _spread_out(axes, tick - 0.28, trials, reach=0.09, color=_TRIALS, marker=".", size=7)
            place = tick + _BOX_ASIDE
            _box(axes, place, means, look.color)
            _spread_out(axes, place, means, reach=0.14, color=look.color, marker=look.marker, size=9)
            if measure.symbol in known:
                value = known[measure.symbol][condition]
                axes.plot(place, value, "D", color="black", mfc="white", ms=4.5, zorder=6)
        _describe(axes, measure, counts)
        # A measure that one condition does not have is not compared.
        tested = not math.isnan(analysis.paired_holm)
        axes.set_title(f"{title}\n" + (f"$p$ = {p_value(analysis.paired_holm).text}" if tested else ""))
    legend: list[Artist] = [
        Line2D([], [], marker=".", color=_TRIALS, linestyle="", label="a trial"),
    ]
    for look in LOOKS.values():
        label = f"an operator, {look.label}"
        legend.append(Line2D([], [], marker=look.marker, color=look.color, linestyle="", ms=4, label=label))
    if known:
        legend.append(published_mean())
    put_legend(figure, panels, len(measures), legend)


def draw_pairs(
    figure: FigureBase, narrow: bool, *, measures: Sequence[Measure], analyses: Mapping[str, Analysis]
) -> None:
    """Draw each operator's mean without and with autonomy, joined.

    Args:
        figure: Where.
        narrow: Whether it is as wide as one column alone.
        measures: One panel each.
        analyses: By symbol.
    """
    panels = panel_grid(figure, len(measures), _NARROW_ACROSS if narrow else len(measures))
    for axes, measure, title in zip(panels, measures, _titles(measures), strict=False):
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
        _describe(axes, measure, [better.size] * 2)
        axes.set_title(f"{title}\n{int(better.sum())} of {better.size} better")
    legend: list[Artist] = [
        Line2D([], [], color=GRAY, linewidth=0.8, label="better with autonomy"),
        Line2D([], [], color="black", linestyle=":", label="not better"),
        Line2D([], [], color="black", linewidth=2.2, label="mean of all"),
    ]
    put_legend(figure, panels, len(measures), legend)


def operator_means(analysis: Analysis, condition: str) -> FloatArray:
    """Return each operator's mean under a condition, of those who have one, shape (n,)."""
    own: dict[str, list[float]] = {}
    for row in analysis.samples.rows:
        if row.condition == condition and not math.isnan(row.value):
            own.setdefault(row.participant, []).append(row.value)
    return np.array([np.mean(values) for values in own.values()])


def _titles(measures: Sequence[Measure]) -> list[str]:
    """Return the panels' letters and titles, all of as many lines."""
    wrapped = [
        textwrap.wrap(f"{letter(place)} {each.title}\u00a0{each.arrow}", _TITLE_CHARACTERS)
        for place, each in enumerate(measures)
    ]
    most = max(map(len, wrapped))
    return ["\n".join([*lines, *[" "] * (most - len(lines))]) for lines in wrapped]


def _say_undefined(axes: Axes, place: int) -> None:
    where = axes.get_xaxis_transform()
    axes.text(place, 0.5, "not defined", rotation=90, color=GRAY, ha="center", va="center", transform=where)


def _box(axes: Axes, place: float, values: FloatArray, color: str) -> None:
    if values.size:
        line = {"color": color, "linewidth": 1.1}
        axes.boxplot(
            values,
            positions=[place],
            widths=0.42,
            showfliers=False,
            manage_ticks=False,
            boxprops=line,
            whiskerprops=line,
            capprops=line,
            medianprops={"color": color, "linewidth": 2.0},
        )


def _spread_out(
    axes: Axes, place: float, values: FloatArray, *, reach: float, color: str, marker: str, size: float
) -> None:
    """Draw values one beside the other, in a fixed order, so that equal ones stay apart."""
    aside = reach * np.sin(2.4 * np.arange(values.size))
    axes.scatter(place + aside, values, s=size, c=color, marker=marker, linewidths=0, zorder=3, alpha=0.85)


def _describe(axes: Axes, measure: Measure, counts: Sequence[int]) -> None:
    names = [look.label.removesuffix(" autonomy") for look in LOOKS.values()]
    ticks = [f"{name}\n$n$ = {count}" for name, count in zip(names, counts, strict=True)]
    axes.set_xticks(range(len(LOOKS)), ticks)
    axes.set_xlim(-0.6, len(LOOKS) - 0.4)
    axes.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))
    # Differences that the tables do not even show are not blown up.
    low, high = axes.get_ylim()
    wider = max(_LEAST_SPAN * 10.0**-measure.decimals - (high - low), 0.0)
    low, high = low - wider / 2.0, high + wider / 2.0
    if axes.dataLim.ymin >= 0.0 > low:
        # Times, counts and lengths have nothing below zero.
        low, high = -0.03 * (high - low), high - low if axes.dataLim.ymax == 0.0 else high
    axes.set_ylim(low, high)
    axes.set_ylabel(measure.axis)
