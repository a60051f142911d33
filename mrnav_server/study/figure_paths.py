"""Mean trajectories over each vessel, with their spread perpendicular to the path."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon
from matplotlib.ticker import MaxNLocator, MultipleLocator

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.trial_log import Condition
from mrnav_server.study.mean_trajectory import MeanTrajectory, mean_trajectory
from mrnav_server.study.study_data import Study, StudyTrial
from mrnav_server.study.style import GRAY, GREEN, LOOKS, letter

_LUMEN, _WALL = "#EDEFF1", "#9AA3AB"
_COARSE = 6
"""The wall is drawn from every sixth pixel, which is finer than the line."""
_ROOM_MM = 0.8


def tasks(study: Study) -> list[str]:
    """Return the study's tasks that a target was reached in, sorted."""
    return sorted({trial.task for trial in study.trials if trial.reached})


def task_mean(study: Study, task: str, condition: Condition) -> MeanTrajectory | None:
    """Return the mean of a task's trials that reached the target; None without one."""
    paths_um: dict[str, list[FloatArray]] = {}
    for trial in _trials(study, task):
        if trial.header.condition == condition and trial.reached and len(trial.path_um) > 1:
            paths_um.setdefault(trial.header.participant, []).append(trial.path_um)
    return mean_trajectory(paths_um) if paths_um else None


def outside_share(mean: MeanTrajectory, vessel: VesselMap) -> float:
    """Return which share of a mean path lies outside the lumen: its trials took different ways."""
    column, row = np.clip(np.round(mean.xy_um / vessel.um_per_px).astype(int), 0, vessel.size_px - 1).T
    return float((~vessel.lumen[row, column]).mean())


def draw_paths(figure: FigureBase, narrow: bool, *, study: Study) -> None:
    """Draw a row for each task: its mean without and with autonomy, and the spread along the way.

    Args:
        figure: Where.
        narrow: Whether it is as wide as one column alone, which has no room for the spread.
        study: The study.
    """
    names = tasks(study)
    widths = [1.0, 1.0] if narrow else [1.0, 1.0, 0.72]
    panels = figure.subplots(len(names), len(widths), squeeze=False, width_ratios=widths)
    for n, (row, task) in enumerate(zip(panels, names, strict=True)):
        means = {condition: task_mean(study, task, condition) for condition in LOOKS}
        letters = [letter(n * len(widths) + place) for place in range(len(widths))]
        for axes, mark, condition in zip(row, letters, LOOKS, strict=False):
            _map(axes, mark, study, task, condition, means[condition], narrow)
        row[0].set_ylabel(f"{task}\ny (mm)")
        if not narrow:
            _spread(row[2], letters[2], means)
    for axes in panels[-1, :2]:
        axes.set_xlabel("x (mm)")
    if not narrow:
        panels[-1, 2].set_xlabel("share of the way (%)")
    figure.align_ylabels(panels[:, 0])
    legend = [
        *(
            Line2D([], [], color=look.color, linestyle=look.line, label=f"mean, {look.label}")
            for look in LOOKS.values()
        ),
        Patch(
            color=GRAY, alpha=0.35, linewidth=0, label="± 1 SD" if narrow else "± 1 SD perpendicular to it"
        ),
        Line2D([], [], color=GRAY, linewidth=0.4, label="an operator's mean"),
        Line2D([], [], marker="o", color="black", linestyle="", ms=3, label="start"),
        Line2D([], [], marker="o", color=GREEN, mfc="none", linestyle="", ms=7, label="critical area"),
    ]
    figure.legend(handles=legend, loc="outside lower center", ncols=2 if narrow else 3)


def _map(
    axes: Axes,
    mark: str,
    study: Study,
    task: str,
    condition: Condition,
    mean: MeanTrajectory | None,
    narrow: bool,
) -> None:
    some, look = _trials(study, task)[0], LOOKS[condition]
    vessel = study.vessels[some.header.vessel]
    _lumen(axes, vessel)
    name = look.label.removesuffix(" autonomy")
    if mean is None:
        axes.set_title(f"{mark} {name}\nno trial reached the target")
    else:
        for each_mm in mean.each_um / 1000.0:
            axes.plot(*each_mm.T, color=GRAY, linewidth=0.3, zorder=2)
        if mean.operators > 1:
            left_um, right_um = mean.band_um()
            edge_mm = np.concatenate([left_um, right_um[::-1]]) / 1000.0
            axes.add_patch(Polygon(edge_mm, color=look.color, alpha=0.35, linewidth=0, zorder=3))
        axes.plot(*mean.xy_um.T / 1000.0, color=look.color, linestyle=look.line, linewidth=0.7, zorder=4)
        axes.plot(*mean.xy_um[0] / 1000.0, "o", color="black", ms=3, zorder=5)
        counted = f"$n$ = {mean.operators}, {mean.paths} trials"
        title = f"{mark} {name}\n{counted}" if narrow else f"{mark} {name}, {counted}"
        if outside_share(mean, vessel) > 0.02:
            title += "\ndifferent ways: this mean is no way"
        axes.set_title(title)
    _area(axes, some)
    axes.set_aspect("equal")


def _spread(axes: Axes, mark: str, means: Mapping[Condition, MeanTrajectory | None]) -> None:
    """Draw the standard deviation along the way: on the map it is thinner than a line."""
    medians_um = []
    for condition, look in LOOKS.items():
        mean = means[condition]
        if mean is not None and mean.operators > 1:
            share = np.linspace(0.0, 100.0, len(mean.sd_um))
            axes.plot(share, mean.sd_um, color=look.color, linestyle=look.line)
            medians_um.append(f"{np.median(mean.sd_um):.0f}")
        else:
            medians_um.append("–")
    axes.set_title(f"{mark} median spread\nwithout {medians_um[0]}, with {medians_um[1]} µm")
    axes.set_ylabel("SD (µm)")
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.set_xlim(0.0, 100.0)
    axes.set_ylim(bottom=0.0)


def _lumen(axes: Axes, vessel: VesselMap) -> None:
    """Draw the lumen as an outline, so that it stays sharp at any size."""
    mm_per_px = vessel.um_per_px / 1000.0
    distance = vessel.distance_px[::_COARSE, ::_COARSE]
    at_mm = np.arange(distance.shape[0]) * _COARSE * mm_per_px
    axes.contourf(
        at_mm, at_mm, distance, levels=[0.0, float(distance.max()) + 1.0], colors=[_LUMEN], zorder=0
    )
    axes.contour(at_mm, at_mm, distance, levels=[0.0], colors=[_WALL], linewidths=0.6, zorder=1)
    rows, columns = (np.flatnonzero(vessel.lumen.any(axis=axis)) * mm_per_px for axis in (1, 0))
    axes.set(
        xlim=(columns[0] - _ROOM_MM, columns[-1] + _ROOM_MM), ylim=(rows[-1] + _ROOM_MM, rows[0] - _ROOM_MM)
    )
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(5.0))


def _area(axes: Axes, trial: StudyTrial) -> None:
    header = trial.header
    if header.area_px is None or header.area_epsilon_um is None:
        return
    x_mm, y_mm = (each * header.um_per_px / 1000.0 for each in header.area_px)
    radius_mm = header.area_epsilon_um / 1000.0
    axes.add_patch(Circle((x_mm, y_mm), radius_mm, fill=False, edgecolor=GREEN, linewidth=1.0, zorder=5))
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    reach_mm = radius_mm + 0.2
    axes.set_xlim(min(left, x_mm - reach_mm), max(right, x_mm + reach_mm))
    axes.set_ylim(max(bottom, y_mm + reach_mm), min(top, y_mm - reach_mm))


def _trials(study: Study, task: str) -> list[StudyTrial]:
    return [trial for trial in study.trials if trial.task == task]
