"""The planner behind the policy's interface."""

import numpy as np
import pytest

from mrnav_server.autonomy.geodesic_policy import GeodesicPolicy, sees
from mrnav_server.autonomy.policy import Sampler
from mrnav_server.core.navigation import free_actions, observation, step
from mrnav_server.core.vessel import VesselMap


@pytest.fixture(scope="module")
def geodesic(corner: VesselMap) -> GeodesicPolicy:
    return GeodesicPolicy(corner)


def test_sight_ends_at_the_wall(corner: VesselMap) -> None:
    start = np.array([[35.0, 45.0], [35.0, 45.0], [155.0, 45.0], [35.0, 45.0]])
    end = np.array([[160.0, 45.0], [155.0, 160.0], [155.0, 160.0], [35.0, 120.0]])
    assert sees(corner, start, end).tolist() == [True, False, True, False]


def test_it_heads_for_a_target_in_sight(geodesic: GeodesicPolicy) -> None:
    here, there = np.array([[40.0, 45.0]]), np.array([[150.0, 50.0]])
    assert geodesic.waypoints(here, there).tolist() == there.tolist()


def test_it_heads_for_the_corner_before_a_hidden_target(geodesic: GeodesicPolicy) -> None:
    waypoint = geodesic.waypoints(np.array([[40.0, 45.0]]), np.array([[155.0, 160.0]]))[0]
    assert 125 < waypoint[0] < 170
    assert 40 < waypoint[1] < 75


def test_path_length_is_that_around_the_corner(geodesic: GeodesicPolicy) -> None:
    start, target = np.array([[40.0, 45.0]]), np.array([[155.0, 160.0]])
    # The robot's centre turns on a circle of its radius about the inner corner; this chord is the bound.
    by_hand = np.hypot(141 - 40, 59 - 45) + np.hypot(155 - 141, 160 - 59)
    assert geodesic.path_length_px(start, target)[0] == pytest.approx(by_hand, rel=0.03)


def test_it_forbids_the_wall_and_arrives(corner: VesselMap, geodesic: GeodesicPolicy) -> None:
    position, start, target = np.array([[40.0, 45.0]]), np.array([[40.0, 45.0]]), np.array([[155.0, 160.0]])
    sampler = Sampler(greedy=True)
    for _ in range(60):
        logits = geodesic.logits(observation(position, start, target))
        assert logits.dtype == np.float32
        assert ((logits > -1e8) == free_actions(corner.free, position)).all()
        moved = step(corner.free, position, target, sampler.choose(logits))
        position = moved.position_px
        if moved.arrived[0]:
            return
    pytest.fail(f"not there after 60 steps, but at {position}")


def test_a_batch_answers_as_each_alone(corner: VesselMap, geodesic: GeodesicPolicy) -> None:
    points = np.argwhere(corner.free)[:, ::-1].astype(float)
    random = np.random.default_rng(0)
    seen = observation(*points[random.integers(len(points), size=(3, 40))])
    together = geodesic.logits(seen)
    alone = np.concatenate([GeodesicPolicy(corner).logits(seen[i : i + 1]) for i in range(0, 40, 8)])
    np.testing.assert_allclose(together[::8], alone, atol=1e-4)
