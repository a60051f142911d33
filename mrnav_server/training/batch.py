"""Many episodes of the navigation task at once, in numpy; equal to the single environment step for step."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from mrnav_server.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from mrnav_server.core.navigation import ACTIONS, ARRIVAL_PX, MAX_STEPS, STEP_PX, observation, reward
from mrnav_server.core.vessel import VesselMap

_REACH_PX = int(np.abs(ACTIONS).max())


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
        final: Observations after the step and before any reset, shape (n, 6), float32; overwritten by the
            next step.
    """

    reward: FloatArray
    terminated: BoolArray
    truncated: BoolArray
    hit: BoolArray
    final: Float32Array


class BatchEnvironment:
    """n independent episodes; one that ends starts anew at once, with a new start and target.

    The wall is looked up in one flat array with a blocked border as wide as a move, so that no index needs
    clipping; what a step works on is allocated once.

    Args:
        vessel: The vessel model.
        count: Number of environments.
        seed: Of the starts and targets.
        max_steps: Steps until truncation.
    """

    def __init__(self, vessel: VesselMap, count: int, seed: int, max_steps: int = MAX_STEPS) -> None:
        self._points = free_points(vessel)
        self._random = np.random.default_rng(seed)
        self._max_steps = max_steps
        self._stride = vessel.size_px + 2 * _REACH_PX
        self._free = np.pad(vessel.free, _REACH_PX).ravel()
        self._shift_of = ACTIONS[:, 1] * self._stride + ACTIONS[:, 0]
        self._move_of = ACTIONS.T.astype(np.float64)
        self._steps: IntArray = np.zeros(count, dtype=np.int64)
        self._cell: IntArray = np.zeros(count, dtype=np.int64)
        self._wanted, self._shift = self._cell.copy(), self._cell.copy()
        self._open = np.zeros(count, dtype=bool)
        # Coordinates as rows: x and y are then contiguous.
        self._position, self._target = np.zeros((2, count)), np.zeros((2, count))
        self._move = np.zeros((2, count))
        self._seen: Float32Array = np.zeros((count, 6), dtype=np.float32)
        self._begin(np.arange(count))

    @property
    def position_px(self) -> FloatArray:
        """Where the agents are, shape (n, 2)."""
        return self._seen[:, 0:2].astype(np.float64)

    @property
    def start_px(self) -> FloatArray:
        """Where their episodes began, shape (n, 2)."""
        return self._seen[:, 2:4].astype(np.float64)

    @property
    def target_px(self) -> FloatArray:
        """Where they are to go, shape (n, 2)."""
        return self._seen[:, 4:6].astype(np.float64)

    def observations(self) -> Float32Array:
        """Return what each agent sees now, shape (n, 6), float32; overwritten by the next step."""
        return self._seen

    def step(self, actions: IntArray) -> BatchStep:
        """Move every agent; actions of shape (n,).

        Raises:
            IndexError: If there is no such action.
        """
        np.take(self._shift_of, actions, out=self._shift)
        np.add(self._cell, self._shift, out=self._wanted)
        np.take(self._free, self._wanted, out=self._open, mode="wrap")
        self._shift *= self._open
        self._cell += self._shift
        np.take(self._move_of, actions, axis=1, out=self._move, mode="wrap")
        self._move *= self._open
        self._position += self._move
        way = np.subtract(self._position, self._target, out=self._move)
        distance_px = np.hypot(way[0], way[1])
        arrived = distance_px < ARRIVAL_PX
        hit = ~self._open
        gain = reward(distance_px, STEP_PX[actions], hit, arrived)
        self._steps += 1
        truncated = (self._steps >= self._max_steps) & ~arrived
        self._seen[:, 0] = self._position[0]
        self._seen[:, 1] = self._position[1]
        final = self._seen
        ended = arrived | truncated
        if ended.any():
            final = final.copy()
            self._begin(np.flatnonzero(ended))
        return BatchStep(gain, arrived, truncated, hit, final)

    def state(self) -> dict[str, Any]:
        """Return all that `restore` needs to go on as if never interrupted."""
        return {
            "seen": self._seen.copy(),
            "steps": self._steps.copy(),
            "random": self._random.bit_generator.state,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state."""
        self._seen[:] = state["seen"]
        self._steps[:] = state["steps"]
        self._random.bit_generator.state = state["random"]
        self._place(np.arange(len(self._seen)))

    def _begin(self, which: IntArray) -> None:
        """Begin new episodes in the environments of these numbers."""
        start, target = draw_pairs(self._points, len(which), self._random)
        self._seen[which] = observation(start, start, target)
        self._steps[which] = 0
        self._place(which)

    def _place(self, which: IntArray) -> None:
        """Derive the working arrays from the observations."""
        x, y = self._seen[which, 0].astype(np.int64), self._seen[which, 1].astype(np.int64)
        self._cell[which] = (y + _REACH_PX) * self._stride + x + _REACH_PX
        self._position[:, which] = self._seen[which, 0:2].T
        self._target[:, which] = self._seen[which, 4:6].T
