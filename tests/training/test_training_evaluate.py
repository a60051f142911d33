"""Figures of merit, by policies whose figures are known."""

import numpy as np
import pytest

from mrnav_server.autonomy.geodesic_policy import GeodesicPolicy
from mrnav_server.core.arrays import Float32Array
from mrnav_server.core.navigation import ACTIONS
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.evaluate import evaluate, wilson_interval
from mrnav_server.vision.vessel_model import vessel_map


class Stubborn:
    """Always prefers one action."""

    name = "stubborn"
    kind = "test"

    def __init__(self, action: int) -> None:
        self._action = action

    def logits(self, observations: Float32Array) -> Float32Array:
        logits = np.zeros((len(observations), len(ACTIONS)), np.float32)
        logits[:, self._action] = 50.0
        return logits


@pytest.fixture(scope="module")
def room() -> VesselMap:
    mask = np.zeros((160, 160), np.uint8)
    mask[10:150, 10:150] = 255
    return vessel_map("room", mask, robot_radius_um=100.0)


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    # Closed form at z = 1.96: 500 of 500 gives 1 / (1 + z^2 / 500); 5 of 10 is 0.5 +- 0.2634.
    [(500, 500, 0.99238, 1.0), (0, 500, 0.0, 0.00762), (5, 10, 0.23659, 0.76341)],
)
def test_wilson_interval(successes: int, trials: int, low: float, high: float) -> None:
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=1e-5)


def test_wilson_interval_needs_a_trial() -> None:
    with pytest.raises(ValueError, match="at least one trial"):
        wilson_interval(0, 0)


def test_the_planner_is_near_perfect_in_a_room(room: VesselMap) -> None:
    result = evaluate(GeodesicPolicy(room), room, pairs=50)
    assert result.success == 1.0
    assert 0.9 < result.spl < 0.999  # moves of 5 to 7 px cannot be straight in every direction
    assert result.wall_hits == 0.0
    assert result.simulated
    assert "simulated" in result.summary()


def test_a_stubborn_policy_runs_into_the_wall_and_fails(room: VesselMap) -> None:
    result = evaluate(Stubborn(ACTIONS.tolist().index([5, 0])), room, pairs=40, max_steps=100)
    assert result.success < 0.3
    assert result.spl <= result.success
    # At most 28 steps cross the room; the rest of a failed pair is spent at the wall.
    assert result.wall_hits > (1 - result.success) * (100 - 28)
