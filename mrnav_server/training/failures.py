"""Draws the pairs that a policy failed, over the vessel."""

import numpy as np
from matplotlib.figure import Figure

from mrnav_server.training.evaluate import Evaluation, Task
from mrnav_server.training.pictures import BLUE, GRAY, VERMILION, draw_vessel
from mrnav_server.training.rollout import Runs, Trace

MOST_DRAWN = 40


def failures_figure(task: Task, evaluation: Evaluation, runs: Runs, trace: Trace) -> Figure:
    """Draw way, last place and target of the failed pairs, the first 40 of them.

    Args:
        task: The pairs.
        evaluation: Its figures are the title.
        runs: What every pair came to.
        trace: The positions of that run.
    """
    failed = np.flatnonzero(~runs.arrived)
    figure = Figure(figsize=(7.0, 7.6), layout="constrained")
    axes = figure.subplots()
    mm_per_px = draw_vessel(axes, task.vessel)
    for agent in failed[:MOST_DRAWN]:
        way = trace.of(int(agent))
        axes.plot(*(way * mm_per_px).T, color=GRAY, linewidth=0.8)
        ends = np.stack([runs.end_px[agent], task.target_px[agent]]) * mm_per_px
        axes.plot(*ends.T, color=VERMILION, linewidth=0.6, linestyle=":")
    drawn = failed[:MOST_DRAWN]
    for points, marker, color, label in (
        (task.start_px, "o", GRAY, "start"),
        (runs.end_px, "x", VERMILION, "last place"),
        (task.target_px, "*", BLUE, "target"),
    ):
        axes.plot(*(points[drawn] * mm_per_px).T, marker, color=color, label=label, markersize=6)
    more = f", {MOST_DRAWN} drawn" if len(failed) > MOST_DRAWN else ""
    axes.set_title(
        f"{evaluation.policy}, {evaluation.mode}, {evaluation.disturbance} (simulated)\n"
        f"{len(failed)} of {evaluation.pairs} pairs failed{more}"
    )
    axes.set(xlabel="x / mm", ylabel="y / mm")
    figure.legend(loc="outside lower center", ncols=3, fontsize="small", frameon=False)
    return figure
