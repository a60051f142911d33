"""Many episodes of the navigation task at once, in numpy; equal to the single environment step for step."""

from dataclasses import dataclass

import numpy as np

from mrnav_server.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from mrnav_server.core.navigation import ARRIVAL_PX, MAX_STEPS, observation, step
from mrnav_server.core.vessel import VesselMap


def free_points(vessel: VesselMap) -> FloatArray:
    """Return every grid pixel (x, y) where the robot's centre fits, shape (n, 2)."""
    rows, columns = np.nonzero(vessel.free)
    return np.stack([columns, rows], axis=1).astype(np.float64)


def draw_pairs(points: FloatArray, count: int, random: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Draw starts and targets at random from the free space, at least the arrival distance apart.

    Args:
        points: As `free_points`.
        count: How many pairs.
        random: Source of all randomness.

    Returns:
        Starts and targets, shape (count, 2) each.
    """
    start, target = points[random.integers(len(points), size=(2, count))]
    while (close := np.hypot(*(start - target).T) < ARRIVAL_PX).any():
        start[close], target[close] = points[random.integers(len(points), size=(2, int(close.sum())))]
    return start, target


@dataclass(frozen=True, slots=True)
class BatchStep:
    """What one step did in every environment.

    Attributes:
        reward: Shape (n,).
        terminated: Whether the target was reached, shape (n,).
        truncated: Whether the steps ran out, shape (n,).
        hit: Whether the move would have entered the wall, shape (n,).
        final: Observations after the step and before any reset, shape (n, 6), float32.
    """

    reward: FloatArray
    terminated: BoolArray
    truncated: BoolArray
    hit: BoolArray
    final: Float32Array


class BatchEnvironment:
    """n independent episodes; one that ends starts anew at once, with a new start and target.

    Args:
        vessel: The vessel model.
        count: Number of environments.
        seed: Of the starts and targets.
        max_steps: Steps until truncation.

    Attributes:
        position_px, start_px, target_px: Shape (n, 2).
    """

    def __init__(self, vessel: VesselMap, count: int, seed: int, max_steps: int = MAX_STEPS) -> None:
        self._free = vessel.free
        self._points = free_points(vessel)
        self._random = np.random.default_rng(seed)
        self._max_steps = max_steps
        self._steps: IntArray = np.zeros(count, dtype=np.int64)
        self.start_px, self.target_px = draw_pairs(self._points, count, self._random)
        self.position_px = self.start_px.copy()

    def observations(self) -> Float32Array:
        """Return what each agent sees now, shape (n, 6), float32."""
        return observation(self.position_px, self.start_px, self.target_px)

    def step(self, actions: IntArray) -> BatchStep:
        """Move every agent; actions of shape (n,)."""
        moved = step(self._free, self.position_px, self.target_px, actions)
        self.position_px = moved.position_px
        self._steps += 1
        truncated = ~moved.arrived & (self._steps >= self._max_steps)
        final = self.observations()
        ended = moved.arrived | truncated
        if ended.any():
            self.restart(ended)
        return BatchStep(moved.reward, moved.arrived, truncated, moved.hit, final)

    def restart(self, which: BoolArray) -> None:
        """Begin new episodes where the mask, shape (n,), is True."""
        pairs = draw_pairs(self._points, int(which.sum()), self._random)
        self.start_px[which], self.target_px[which] = pairs
        self.position_px[which] = self.start_px[which]
        self._steps[which] = 0
