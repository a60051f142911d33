"""The figures of a report, with their captions (docs/report.md)."""

from collections.abc import Callable
from functools import partial

from matplotlib.figure import FigureBase

from mrnav_server.study import published
from mrnav_server.study.figure import ReportFigure
from mrnav_server.study.figure_boxes import draw_boxes, draw_pairs
from mrnav_server.study.figure_paths import draw_paths, tasks
from mrnav_server.study.figure_workload import draw_workload
from mrnav_server.study.measures import FIVE, HANDOVER, WORKLOAD
from mrnav_server.study.report_tables import Analyses
from mrnav_server.study.study_data import Study

_WINDOW = (
    "The window is the 2.5 s after the switch to the operator, or up to the trial's end; without autonomy,"
    " the 2.5 s after the robot entered the critical area. A trial's median S hides it. Jump: largest"
    " distance of a setpoint from where the velocity before it led. Take-over time: from the switch to the"
    " hand's grip, 0 for a hand that was there."
)
_ROW_IN = 2.9
"""Height of a row of panels, with titles and legend."""
_GRID_IN = 6.6
"""The same panels, two beside each other."""
_MAP_IN, _NARROW_MAP_IN, _MAP_LEGEND_IN = 2.65, 2.0, 0.75


def boxes_figure(study: Study, analyses: Analyses) -> ReportFigure:
    """Return the five metrics by condition."""
    return _figure(
        study,
        "five-metrics",
        "The five metrics by condition",
        f"{_boxes(study)} Diamonds: published means, of five participants on hardware. p: {_tests(analyses)},"
        " adjusted by Holm over the five. ↑ higher is better, ↓ lower is better: lower G is straighter, lower"
        " S is smoother.",
        (_ROW_IN, _GRID_IN),
        partial(draw_boxes, measures=FIVE, analyses=analyses, known=published.METRICS),
    )


def pairs_figure(study: Study, analyses: Analyses) -> ReportFigure:
    """Return everybody's own pair."""
    return _figure(
        study,
        "pairs",
        "Every operator without and with autonomy",
        f"A line joins the two means over trials of one of the n {study.people}; dotted: not better with"
        " autonomy; thick: mean of all. ↑ higher is better, ↓ lower is better: lower G is"
        " straighter, lower S is smoother.",
        (_ROW_IN, _GRID_IN),
        partial(draw_pairs, measures=FIVE, analyses=analyses),
    )


def handover_figure(study: Study, analyses: Analyses) -> ReportFigure:
    """Return the window after the switch."""
    return _figure(
        study,
        "handover",
        "The window after the switch",
        f"{_WINDOW} {_boxes(study)} p: {_tests(analyses)}, adjusted by Holm over the measures that both"
        " conditions have; exploratory. ↓ lower is better.",
        (_ROW_IN, _GRID_IN),
        partial(draw_boxes, measures=HANDOVER, analyses=analyses, known={}),
    )


def paths_figure(study: Study) -> ReportFigure:
    """Return the mean trajectories."""
    count = len(tasks(study))
    return _figure(
        study,
        "trajectories",
        "Mean trajectories",
        f"Mean over the n {study.people} of each one's mean path, by the share of the way done (arc length),"
        " of the trials that reached the target; y points down, as in the microscope's picture. Band: ± one"
        " standard deviation (SD) between operators, perpendicular to the mean; its size along the way, and"
        " its median, stand at the right.",
        (_MAP_LEGEND_IN + _MAP_IN * count, _MAP_LEGEND_IN + _NARROW_MAP_IN * count),
        partial(draw_paths, study=study),
    )


def workload_figure(study: Study, analyses: Analyses) -> ReportFigure:
    """Return NASA-TLX; only people answer it."""
    counts = {len(analyses[each.symbol].samples.pairs().participants) for each in WORKLOAD}
    return _figure(
        study,
        "workload",
        "NASA-TLX by condition",
        f"Bars and whiskers: mean and standard deviation of the answers (marks) of the n = {max(counts)}"
        " participants who answered in both conditions; diamonds: published means, of five participants"
        " on hardware. Lower is less workload; performance runs from good (0) to poor (100).",
        (_ROW_IN, _ROW_IN),
        partial(draw_workload, analyses=analyses),
    )


def _boxes(study: Study) -> str:
    return (
        "Boxes: median and quartiles of the n operators' means over their trials (large marks); whiskers:"
        f" range within 1.5 interquartile ranges; small dots: the {len(study.trials)} trials."
    )


def _tests(analyses: Analyses) -> str:
    names = sorted({each.paired.test for each in analyses.values() if each.paired.test})
    return f"paired analysis ({' or '.join(names)}, two-sided)" if names else "paired analysis"


def _figure(
    study: Study,
    name: str,
    title: str,
    caption: str,
    heights_in: tuple[float, float],
    draw: Callable[[FigureBase, bool], None],
) -> ReportFigure:
    return ReportFigure(name, title, f"{title} ({study.origin}). {caption}", *heights_in, draw, study.mark)
