"""Why the discount decides whether an agent arrives: what the way pays against what waiting pays."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from mrnav_server.autonomy.geodesic_policy import GeodesicPolicy
from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.navigation import (
    ARRIVAL_PX,
    ARRIVAL_REWARD,
    DISTANCE_WEIGHT_PER_PX,
    STEP_PX,
    STEP_WEIGHT_PER_PX,
)
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.batch import draw_pairs, free_points
from mrnav_server.training.pictures import BLUE, GREEN, PURPLE, VERMILION

DISCOUNTS = (0.98, 0.985, 0.99, 0.9925, 0.995, 0.9965, 0.998, 0.999, 0.9995)
STRIDE_PX = float(STEP_PX.mean())
"""Length of a step along the way; the mean of the 40 actions."""
_STYLES = ((BLUE, "-"), (VERMILION, "--"), (GREEN, "-."), (PURPLE, ":"))


def distances_along(
    vessel: VesselMap, start_px: FloatArray, target_px: FloatArray, corners: int = 200
) -> list[FloatArray]:
    """Return the crow's distance to the target after every step along the shortest way, for each pair.

    Args:
        vessel: The vessel model.
        start_px: Shape (n, 2).
        target_px: Shape (n, 2).
        corners: A way has at most so many pieces.

    Returns:
        Shape (k,) each, in grid pixels; the last is the first within the arrival distance.
    """
    planner = GeodesicPolicy(vessel)
    points = [start_px]
    for _ in range(corners):
        points.append(planner.waypoints(points[-1], target_px))
        if (points[-1] == points[-2]).all():
            break
    ways = np.stack(points, axis=1)
    return [_distances(way, target) for way, target in zip(ways, target_px, strict=True)]


def _distances(way_px: FloatArray, target_px: FloatArray) -> FloatArray:
    at_px = np.append(0.0, np.cumsum(np.hypot(*np.diff(way_px, axis=0).T)))
    every = np.append(np.arange(STRIDE_PX, at_px[-1], STRIDE_PX), at_px[-1])
    steps = np.stack([np.interp(every, at_px, way_px[:, axis]) for axis in (0, 1)], axis=1)
    distance_px: FloatArray = np.hypot(*(steps - target_px).T)
    return distance_px[: int(np.argmax(distance_px < ARRIVAL_PX)) + 1]


def way_pays(distance_px: FloatArray, discount: float) -> bool:
    """Tell whether going on beats waiting for ever at every place of a way.

    Waiting is stepping to and fro where the distance to the target is as it is: each step costs
    ``0.005 d + 0.02 · 5``, for ever, so ``-(0.005 d + 0.1) / (1 - γ)``. The episode's end after 20,000 steps
    is far enough not to count.

    Args:
        distance_px: As `distances_along`.
        discount: γ.
    """
    travel = DISTANCE_WEIGHT_PER_PX * distance_px + STEP_WEIGHT_PER_PX * STRIDE_PX
    onward = ARRIVAL_REWARD
    for k in range(len(distance_px) - 2, -1, -1):
        shuffle = DISTANCE_WEIGHT_PER_PX * distance_px[k] + STEP_WEIGHT_PER_PX * float(STEP_PX.min())
        if onward < shuffle / (1.0 - discount):
            return False
        onward = travel[k] + discount * onward
    return True


def shares_that_pay(
    vessel: VesselMap, pairs: int, seed: int, discounts: Sequence[float] = DISCOUNTS
) -> list[float]:
    """Return for each discount the share of random pairs whose way pays more than waiting anywhere on it."""
    ways = distances_along(vessel, *draw_pairs(free_points(vessel), pairs, np.random.default_rng(seed)))
    return [float(np.mean([way_pays(way, discount) for way in ways])) for discount in discounts]


def discount_figure(shares: dict[str, list[float]], pairs: int) -> Figure:
    """Draw the shares of each model over the discount."""
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    axes = figure.subplots()
    horizon = [1.0 / (1.0 - discount) for discount in DISCOUNTS]
    for (model, row), (color, style) in zip(shares.items(), _STYLES * len(shares), strict=False):
        axes.plot(
            horizon, [100 * share for share in row], color=color, linestyle=style, marker="o", label=model
        )
    axes.set_xscale("log")
    axes.set_xticks(horizon, [f"{discount:g}" for discount in DISCOUNTS], rotation=45, minor=False)
    axes.set_xticks([], minor=True)
    axes.set(xlabel="discount γ", ylabel="pairs whose way pays / %", ylim=(0, 103))
    axes.set_title(
        f"Going to the target beats waiting on the way, {pairs} random pairs (simulated)", fontsize="medium"
    )
    axes.legend(frameon=False)
    return figure
