"""Learning curves from the monitor files of training runs: PPO against A2C, mean and spread over seeds."""

import csv
import json
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.training.monitor import MONITOR_FILE
from mrnav_server.training.pictures import BLUE, GREEN, PURPLE, VERMILION

BINS = 50
_COLORS = {"ppo": (BLUE, "-"), "a2c": (VERMILION, "--")}
_OTHERS = ((GREEN, "-."), (PURPLE, ":"))


@dataclass(frozen=True, slots=True)
class LearningRun:
    """The episodes of one training run, in the order in which they ended.

    Attributes:
        model: The vessel model's name.
        preset: The recipe.
        algo: ``"ppo"`` or ``"a2c"``.
        seed: Of the training.
        ended_step: Environment steps of the whole run when each episode ended, shape (n,), ascending.
        arrived: Whether it ended at its target, shape (n,).
        steps: Environment steps of the whole run.
    """

    model: str
    preset: str
    algo: str
    seed: int
    ended_step: FloatArray
    arrived: FloatArray
    steps: float

    def arrivals_per_1000(self, edges: FloatArray) -> FloatArray:
        """Return the arrivals per 1000 environment steps between edges, shape (k,) to (k - 1,).

        Unlike the success rate of the episodes that ended, this cannot be flattered by agents that wait for
        ever: their steps count. Past the run's end it is NaN.
        """
        counts, _ = np.histogram(self.ended_step[self.arrived > 0], edges)
        rate = 1000.0 * counts / np.diff(edges)
        return np.where(edges[1:] <= self.steps * 1.001, rate, np.nan)

    def record(self) -> dict[str, Any]:
        """Return what it was for JSON, with the arrivals per 1000 steps in its last tenth."""
        last = np.array([0.9, 1.0]) * self.steps
        return {
            "model": self.model,
            "preset": self.preset,
            "algo": self.algo,
            "seed": self.seed,
            "steps": int(self.steps),
            "episodes": len(self.arrived),
            "arrived": int(self.arrived.sum()),
            "arrivals_per_1000_at_the_end": float(self.arrivals_per_1000(last)[0]),
        }


def read_run(folder: Path) -> LearningRun:
    """Read a training run's folder.

    Args:
        folder: Holds ``monitor.csv``, as `training.monitor.MonitorFile` writes it.

    Raises:
        ConfigError: If a file or a field is missing.
    """
    path = folder / MONITOR_FILE
    if not path.is_file():
        raise ConfigError(f"{folder} is no training run: {MONITOR_FILE} is missing")
    with path.open(newline="") as lines:
        first = lines.readline()
        rows = list(csv.DictReader(lines))
    try:
        about = json.loads(first.lstrip("#"))
        arrived = np.array([row["is_success"] == "True" for row in rows], dtype=float)
        ended = np.array([float(row["s"]) for row in rows])
        return LearningRun(
            str(about["model"]),
            str(about["preset"]),
            str(about["algo"]),
            int(about["seed"]),
            ended,
            arrived,
            float(about["steps"]),
        )
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"{path}: {error} is missing or unreadable: is it a run of `mrnav train`?"
        ) from None


def curves_figure(runs: Sequence[LearningRun], best_per_1000: dict[str, float]) -> Figure:
    """Draw one panel a model and preset: arrivals per 1000 steps over steps, a line for each algorithm.

    Args:
        runs: At least one.
        best_per_1000: Of each model, what an agent on the shortest way would reach; a dotted line.

    Raises:
        ConfigError: If there are no runs.
    """
    if not runs:
        raise ConfigError("there are no training runs to draw")
    models, presets = sorted({run.model for run in runs}), sorted({run.preset for run in runs})
    figure = Figure(figsize=(4.6 * len(presets), 3.2 * len(models) + 0.6), layout="constrained")
    panels = figure.subplots(len(models), len(presets), squeeze=False)
    for row, model in zip(panels, models, strict=True):
        for axes, preset in zip(row, presets, strict=True):
            here = [run for run in runs if (run.model, run.preset) == (model, preset)]
            if not here:
                axes.set_axis_off()
                continue
            _draw_panel(axes, here)
            title = f"{model}, preset {preset}"
            if model in best_per_1000:
                axes.axhline(best_per_1000[model], color="black", linewidth=0.8, linestyle=":")
                title += f" (shortest ways: {best_per_1000[model]:.1f})"
            axes.set_title(title, fontsize="medium")
            axes.set(xlabel="environment steps / million", ylabel="arrivals per 1000 steps")
            axes.legend(fontsize="small", frameon=False)
    figure.suptitle(
        "Learning (simulated): mean over seeds, least and largest shaded;\ndotted: the shortest ways"
    )
    return figure


def _draw_panel(axes: Axes, runs: Sequence[LearningRun]) -> None:
    by_algo: dict[str, list[LearningRun]] = defaultdict(list)
    for run in runs:
        by_algo[run.algo].append(run)
    others = iter(_OTHERS * len(by_algo))
    for algo, same in sorted(by_algo.items()):
        edges = np.linspace(0.0, max(run.steps for run in same), BINS + 1)
        rates = np.array([run.arrivals_per_1000(edges) for run in same])
        known = np.isfinite(rates).any(axis=0)
        middle = 0.5 * (edges[1:] + edges[:-1])[known] / 1e6
        mean, low, high = (each(rates[:, known], axis=0) for each in (np.nanmean, np.nanmin, np.nanmax))
        color, style = _COLORS.get(algo) or next(others)
        seeds = f"{len(same)} seeds" if len(same) > 1 else "1 seed"
        axes.plot(middle, mean, color=color, linestyle=style, label=f"{algo.upper()}, {seeds}")
        axes.fill_between(middle, low, high, color=color, alpha=0.2, linewidth=0.0)
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(left=0.0)
