"""The navigation task's rules, by hand-computed values."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.core.arrays import BoolArray
from mrnav_server.core.navigation import (
    ACTIONS,
    DIRECTIONS,
    STEP_PX,
    free_actions,
    is_free,
    observation,
    reward,
    step,
)

RIGHT = ACTIONS.tolist().index([5, 0])


def field(size: int = 100) -> BoolArray:
    """A free square with a wall of 10 px around it."""
    free = np.zeros((size, size), dtype=bool)
    free[10:-10, 10:-10] = True
    return free


def test_actions_are_the_outline_of_a_square_sorted_by_angle() -> None:
    assert ACTIONS.shape == (40, 2)
    assert len({tuple(move) for move in ACTIONS.tolist()}) == 40
    assert (np.abs(ACTIONS).max(axis=1) == 5).all()
    angles = [math.atan2(dy, dx) for dx, dy in ACTIONS]
    assert angles == sorted(angles)
    assert STEP_PX.max() == pytest.approx(math.sqrt(50))
    assert STEP_PX.min() == 5.0
    np.testing.assert_allclose(np.hypot(*DIRECTIONS.T), 1.0)


def test_observation_is_position_start_target_in_pixels() -> None:
    seen = observation(np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([5.0, 6.0]))
    assert seen.dtype == np.float32
    assert seen.tolist() == [1, 2, 3, 4, 5, 6]
    assert observation(np.zeros((7, 2)), np.zeros((7, 2)), np.zeros((7, 2))).shape == (7, 6)


@pytest.mark.parametrize(
    ("distance_px", "step_px", "hit", "arrived", "expected"),
    [
        (9.9, 5.0, False, True, 1000.0),
        (9.9, 5.0, True, True, 1000.0),
        (100.0, 5.0, False, False, -0.6),
        (100.0, 5.0, True, False, -10.6),
        # The published minimum: across the whole grid, along a diagonal, into the wall.
        (2544.0, math.sqrt(50), True, False, -22.861421),
    ],
)
def test_reward_has_the_published_values(
    distance_px: float, step_px: float, hit: bool, arrived: bool, expected: float
) -> None:
    gain = reward(np.float64(distance_px), np.float64(step_px), np.bool_(hit), np.bool_(arrived))  # type: ignore[arg-type]
    assert float(gain) == pytest.approx(expected, abs=1e-6)


def test_a_move_into_the_wall_leaves_the_agent_where_it_is() -> None:
    position, target = np.array([87.0, 50.0]), np.array([20.0, 50.0])
    moved = step(field(), position, target, np.int64(RIGHT))  # type: ignore[arg-type]
    assert moved.hit
    assert moved.position_px.tolist() == [87.0, 50.0]
    assert float(moved.reward) == pytest.approx(-10 - 0.005 * 67 - 0.02 * 5)


def test_arrival_is_strictly_closer_than_ten_pixels() -> None:
    position = np.array([[30.0, 50.0], [29.0, 50.0]])
    target = np.array([[44.0, 50.0], [44.0, 50.0]])
    moved = step(field(), position, target, np.array([RIGHT, RIGHT]))
    assert moved.distance_px.tolist() == [9.0, 10.0]
    assert moved.arrived.tolist() == [True, False]
    assert moved.reward.tolist() == pytest.approx([1000.0, -0.15])


def test_outside_the_grid_is_not_free() -> None:
    everything = np.ones((20, 20), dtype=bool)
    assert is_free(everything, np.array([[0.0, 0.0], [-0.6, 5.0], [19.4, 19.4], [19.6, 3.0]])).tolist() == [
        *(True, False, True, False)
    ]


@given(x=st.integers(10, 89), y=st.integers(10, 89), action=st.integers(0, 39), batch=st.integers(1, 3))
def test_one_agent_and_a_batch_agree_and_stay_free(x: int, y: int, action: int, batch: int) -> None:
    free, target = field(), np.array([50.0, 50.0])
    one = step(free, np.array([x, y], float), target, np.asarray(action))
    many = step(free, np.full((batch, 2), (x, y), float), np.tile(target, (batch, 1)), np.full(batch, action))
    assert is_free(free, one.position_px)
    assert (many.position_px == one.position_px).all()
    assert (many.reward == one.reward).all()
    assert bool(one.hit) is not bool(free_actions(free, np.array([x, y], float))[action])
