"""Draws the same tasks as the policy's roll-outs in the grid and as drives on the simulated rig."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mrnav_server.autonomy.path import PathPlanner
from mrnav_server.autonomy.policy import Policy, Sampler
from mrnav_server.autonomy.torchscript import load_policy
from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.vessel import VesselMap
from mrnav_server.settings import Settings
from mrnav_server.training.pictures import BLUE, GRAY, GREEN, PURPLE, VERMILION, draw_vessel
from mrnav_server.training.rig_runs import LockStepRig, RigRun, random_tasks
from mrnav_server.training.rollout import Disturbance, Trace, roll_out
from mrnav_server.vision.vessel_model import load_vessel_model

_COLORS = (BLUE, VERMILION, GREEN, PURPLE)


@dataclass(frozen=True, slots=True)
class ModelTrajectories:
    """Random sets of one model.

    Attributes:
        vessel: The vessel model.
        grid_px: The policy's roll-outs, shape (k, 2) each, in grid pixels.
        rig: The same tasks on the simulated rig.
    """

    vessel: VesselMap
    grid_px: tuple[FloatArray, ...]
    rig: tuple[RigRun, ...]

    @property
    def deviation_um(self) -> tuple[float, float]:
        """Mean and largest distance of the driven from the planned paths, over all ticks."""
        all_um = np.concatenate([run.deviation_um for run in self.rig])
        return float(all_um.mean()), float(all_um.max())

    def record(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        mean_um, largest_um = self.deviation_um
        return {
            "model": self.vessel.name,
            "sets": len(self.rig),
            "arrived": sum(run.arrived for run in self.rig),
            "policy_paths": sum(run.source == "policy" for run in self.rig),
            "contacts": sum(run.contacts for run in self.rig),
            "replans": sum(run.replans for run in self.rig),
            "deviation_mean_um": mean_um,
            "deviation_max_um": largest_um,
            "deviation_max_um_by_set": [float(run.deviation_um.max()) for run in self.rig],
            "time_s": sum(run.time_s for run in self.rig),
            "simulated": True,
        }


def run_trajectories(folder: Path, sets: int, seed: int) -> ModelTrajectories:
    """Run random tasks of one model in the grid and on the simulated rig.

    Args:
        folder: The model's folder, with its policy.
        sets: Number of tasks.
        seed: Of the tasks and of the rig.
    """
    vessel = load_vessel_model(folder)
    policy = load_policy(folder, vessel)
    planner = PathPlanner(vessel)
    tasks = random_tasks(vessel, sets, seed)
    rig = tuple(
        LockStepRig(vessel, planner, policy, start, Settings(), seed + number).drive(target)
        for number, (start, target) in enumerate(tasks)
    )
    return ModelTrajectories(vessel, _grid_paths(policy, vessel, rig), rig)


def trajectories_figure(models: list[ModelTrajectories]) -> Figure:
    """Draw one row a model: the grid on the left, the simulated rig on the right."""
    figure = Figure(figsize=(9.0, 4.7 * len(models)), layout="constrained")
    rows = figure.subplots(len(models), 2, squeeze=False)
    for (grid, rig), each in zip(rows, models, strict=True):
        mm_per_px = draw_vessel(grid, each.vessel)
        draw_vessel(rig, each.vessel)
        for number, (way_px, run) in enumerate(zip(each.grid_px, each.rig, strict=True)):
            color = _COLORS[number % len(_COLORS)]
            grid.plot(*(way_px * mm_per_px).T, color=color, linewidth=1.4)
            rig.plot(*(run.planned_px * mm_per_px).T, color="black", linewidth=0.8, linestyle="--")
            rig.plot(*(run.driven_px * mm_per_px).T, color=color, linewidth=1.8, alpha=0.8)
            for axes in (grid, rig):
                _draw_ends(axes, run, mm_per_px)
        mean_um, largest_um = each.deviation_um
        grid.set_title(f"{each.vessel.name}: policy in the grid", fontsize="medium")
        rig.set_title(
            "simulated rig: driven (colour) off planned (dashed)\n"
            f"by {mean_um:.0f} µm in the mean, {largest_um:.0f} µm at most",
            fontsize="medium",
        )
        for axes in (grid, rig):
            axes.set(xlabel="x / mm", ylabel="y / mm")
    figure.suptitle("Random starts (circle) and targets (star), simulated")
    return figure


def _draw_ends(axes: Axes, run: RigRun, mm_per_px: float) -> None:
    axes.plot(run.start.x_px * mm_per_px, run.start.y_px * mm_per_px, "o", color=GRAY, markersize=6)
    axes.plot(run.target.x_px * mm_per_px, run.target.y_px * mm_per_px, "*", color="black", markersize=9)


def _grid_paths(policy: Policy, vessel: VesselMap, rig: tuple[RigRun, ...]) -> tuple[FloatArray, ...]:
    start_px = np.array([(run.start.x_px, run.start.y_px) for run in rig])
    target_px = np.array([(run.target.x_px, run.target.y_px) for run in rig])
    trace = Trace(every=1)
    sampler = Sampler(greedy=True, agents=len(rig))
    runs = roll_out(policy, vessel, start_px, target_px, sampler, Disturbance(), trace=trace)
    return tuple(
        np.vstack([trace.of(agent), runs.end_px[agent]]).astype(np.float64) for agent in range(len(rig))
    )
