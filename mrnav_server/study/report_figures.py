"""The figures of a report, with their captions (docs/report.md)."""

from collections.abc import Callable
from functools import partial

from matplotlib.figure import FigureBase

from mrnav_server.study import published
from mrnav_server.study.figure import ReportFigure
from mrnav_server.study.figure_boxes import draw_boxes, draw_pairs
from mrnav_server.study.figure_paths import draw_paths, tasks
from mrnav_server.study.figure_workload import draw_workload
from mrnav_server.study.measures import FIVE, HANDOVER
from mrnav_server.study.report_tables import Analyses
from mrnav_server.study.study_data import Study

WINDOW = (
    "The window is the 2.5 s after the switch to the operator, or up to the trial's end; without autonomy,"
    " the 2.5 s after the robot entered the critical area. A trial's median S hides it. Take-over time: from"
    " the switch to the hand's grip, 0 for a hand that was there."
)
_ROW_IN = 3.05
"""Height of a row of panels, with titles and legend."""
_MAP_IN, _MAP_LEGEND_IN = 2.95, 0.7


def boxes_figure(study: Study, analyses: Analyses) -> ReportFigure:
    """Return the five metrics by condition."""
    return _figure(
        study,
        "five-metrics",
        "The five metrics by condition",
        "Boxes: median, quartiles and range within 1.5 interquartile ranges of the own means of the"
        f" {study.people} (large marks); small dots: trials. Diamonds: published means. p: paired analysis,"
        " adjusted by Holm over the five. ↑ higher is better, ↓ lower is better: lower G is straighter, lower"
        " S is smoother.",
        _ROW_IN,
        partial(draw_boxes, measures=FIVE, analyses=analyses, known=published.METRICS),
    )


def pairs_figure(study: Study, analyses: Analyses) -> ReportFigure:
    """Return everybody's own pair."""
    return _figure(
        study,
        "pairs",
        "Every operator without and with autonomy",
        f"A line joins the two means of one of the {study.people}. ↑ higher is better, ↓ lower is better.",
        _ROW_IN,
        partial(draw_pairs, measures=FIVE, analyses=analyses),
    )


def handover_figure(study: Study, analyses: Analyses) -> ReportFigure:
    """Return the window after the switch."""
    return _figure(
        study,
        "handover",
        "The window after the switch",
        f"Marks as in the figure of the five metrics. {WINDOW} p: paired analysis, adjusted by Holm over the"
        " measures that both conditions have; exploratory. ↓ lower is better.",
        _ROW_IN,
        partial(draw_boxes, measures=HANDOVER, analyses=analyses, known={}),
    )


def paths_figure(study: Study) -> ReportFigure:
    """Return the mean trajectories."""
    return _figure(
        study,
        "trajectories",
        "Mean trajectories",
        f"Mean of the own means of the {study.people}, over the share of the way done (arc length); band: one"
        " standard deviation between them, perpendicular to the mean. Trials that reached the target.",
        _MAP_LEGEND_IN + _MAP_IN * len(tasks(study)),
        partial(draw_paths, study=study),
    )


def workload_figure(study: Study, analyses: Analyses) -> ReportFigure:
    """Return NASA-TLX; only people answer it."""
    return _figure(
        study,
        "workload",
        "NASA-TLX by condition",
        "Bars and whiskers: mean and standard deviation of the participants' own means (marks); diamonds:"
        " published means. Lower is less workload; performance runs from good (0) to poor (100).",
        _ROW_IN,
        partial(draw_workload, analyses=analyses),
    )


def _figure(
    study: Study,
    name: str,
    title: str,
    caption: str,
    height_in: float,
    draw: Callable[[FigureBase], None],
) -> ReportFigure:
    return ReportFigure(name, title, f"{title} ({study.origin}). {caption}", height_in, draw, study.mark)
