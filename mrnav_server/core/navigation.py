"""The navigation task in the vessel's grid: what training and serving share, in one copy.

Everything works on one agent (trailing shape alone) and on batches (any leading shape).
"""

import math
from dataclasses import dataclass

import numpy as np

from mrnav_server.core.arrays import BoolArray, Float32Array, FloatArray, IntArray

ARRIVAL_PX = 10.0
"""The target counts as reached when it is closer than this."""
MAX_STEPS = 20_000
"""An episode is truncated after this many steps."""
ARRIVAL_REWARD = 1000.0
WALL_REWARD = -10.0
DISTANCE_WEIGHT_PER_PX = -0.005
STEP_WEIGHT_PER_PX = -0.02


def _square_outline(half_px: int) -> IntArray:
    """Return the integer points on a square's outline, sorted by angle, shape (8 * half, 2)."""
    side = range(-half_px, half_px + 1)
    points = [(dx, dy) for dx in side for dy in side if max(abs(dx), abs(dy)) == half_px]
    return np.array(sorted(points, key=lambda p: math.atan2(p[1], p[0])), dtype=np.int64)


ACTIONS: IntArray = _square_outline(5)
"""The 40 moves (dx, dy) in grid pixels: the outline of a square of side 10, sorted by angle."""
STEP_PX: FloatArray = np.hypot(ACTIONS[:, 0], ACTIONS[:, 1])
"""Length of each action, shape (40,); the largest is 7.07."""
DIRECTIONS: FloatArray = ACTIONS / STEP_PX[:, None]
"""Unit vector of each action, shape (40, 2)."""
for _table in (ACTIONS, STEP_PX, DIRECTIONS):
    _table.setflags(write=False)


@dataclass(frozen=True, slots=True)
class Transition:
    """What one step did, for one agent or a batch.

    Attributes:
        position_px: Where the agent is now, shape (..., 2).
        reward: Shape (...), float64.
        arrived: Whether the target is reached, shape (...).
        hit: Whether the move would have entered the wall, shape (...); the agent then stayed.
        distance_px: To the target, after the step, shape (...).
    """

    position_px: FloatArray
    reward: FloatArray
    arrived: BoolArray
    hit: BoolArray
    distance_px: FloatArray


def observation(position_px: FloatArray, start_px: FloatArray, target_px: FloatArray) -> Float32Array:
    """Return what the policy sees: x, y, x_start, y_start, x_target, y_target.

    Args:
        position_px: In the vessel's grid, shape (..., 2).
        start_px: Where the episode began, shape (..., 2).
        target_px: Shape (..., 2).

    Returns:
        Shape (..., 6), float32, in grid pixels.

    Source: the published system, observation of the navigation task.
    """
    return np.concatenate([position_px, start_px, target_px], axis=-1).astype(np.float32)


def is_free(free: BoolArray, position_px: FloatArray) -> BoolArray:
    """Tell whether the robot's centre fits at the nearest grid pixel.

    Args:
        free: The vessel's free space, shape (size, size), indexed [y, x].
        position_px: Shape (..., 2).

    Returns:
        Shape (...); False outside the grid.
    """
    nearest = np.rint(position_px).astype(np.int64)
    size = free.shape[0]
    inside = ((nearest >= 0) & (nearest < size)).all(axis=-1)
    i, j = nearest[..., 0].clip(0, size - 1), nearest[..., 1].clip(0, size - 1)
    return np.asarray(free[j, i] & inside)


def free_actions(free: BoolArray, position_px: FloatArray) -> BoolArray:
    """Tell which of the 40 actions stay out of the wall: shape (..., 2) to shape (..., 40)."""
    return is_free(free, np.asarray(position_px)[..., None, :] + ACTIONS)


def reward(distance_px: FloatArray, step_px: FloatArray, hit: BoolArray, arrived: BoolArray) -> FloatArray:
    """Return the reward of a step.

    +1000 on arrival; otherwise -0.005 d - 0.02 t, and a further -10 when the move would enter the wall
    (the published minimum of -23 is -10 - 0.005 * 2544 - 0.02 * 7.07).

    Args:
        distance_px: Distance d to the target after the step, shape (...).
        step_px: Length t of the attempted move, shape (...).
        hit: Whether the move would have entered the wall, shape (...).
        arrived: Whether the target is reached, shape (...).

    Source: the published system, reward of the navigation task.
    """
    travel = DISTANCE_WEIGHT_PER_PX * distance_px + STEP_WEIGHT_PER_PX * step_px + WALL_REWARD * hit
    return np.where(arrived, ARRIVAL_REWARD, travel)


def step(free: BoolArray, position_px: FloatArray, target_px: FloatArray, action: IntArray) -> Transition:
    """Move, or stay if the wall is in the way.

    The end point alone is checked: a chord of 7.07 px cuts a disc's wall by at most 0.125 px.

    Args:
        free: The vessel's free space, shape (size, size), indexed [y, x].
        position_px: Shape (..., 2).
        target_px: Shape (..., 2).
        action: Index into ACTIONS, shape (...).
    """
    wanted = position_px + ACTIONS[action]
    hit = ~is_free(free, wanted)
    moved = np.where(hit[..., None], position_px, wanted)
    distance_px = np.hypot(moved[..., 0] - target_px[..., 0], moved[..., 1] - target_px[..., 1])
    arrived = distance_px < ARRIVAL_PX
    gain = reward(distance_px, STEP_PX[action], hit, arrived)
    return Transition(moved, gain, arrived, hit, distance_px)
