"""The published environment, alone and in batches."""

import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.navigation import ACTIONS, ARRIVAL_PX
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.batch import BatchEnvironment, draw_pairs, free_points
from mrnav_server.training.environment import ENVIRONMENT_ID, VesselNavigation
from mrnav_server.vision.vessel_model import save_vessel_model, vessel_map

RIGHT = ACTIONS.tolist().index([5, 0])


@pytest.fixture(scope="module")
def room() -> VesselMap:
    """Free space x and y 21..99 around a pillar."""
    mask = np.zeros((120, 120), np.uint8)
    mask[11:110, 11:110] = 255
    mask[55:60, 55:60] = 0
    return vessel_map("room", mask, robot_radius_um=100.0)


def test_gymnasium_finds_no_fault() -> None:
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        check_env(gym.make(ENVIRONMENT_ID, model="bifurcation").unwrapped)
    assert [str(warning.message) for warning in said] == []


def test_it_is_made_by_name_or_folder(room: VesselMap, tmp_path: Path) -> None:
    save_vessel_model(tmp_path / "room", room, "room", "test")
    env = gym.make(ENVIRONMENT_ID, model=tmp_path / "room")
    observation, info = env.reset(seed=1)
    assert env.observation_space.shape == (6,)
    assert observation[:2].tolist() == observation[2:4].tolist()
    assert set(info) == {"is_success", "collision", "distance"}


def test_the_seed_decides_start_and_target(room: VesselMap) -> None:
    first, _ = VesselNavigation(room).reset(seed=4)
    again, _ = VesselNavigation(room).reset(seed=4)
    other, _ = VesselNavigation(room).reset(seed=5)
    assert first.tolist() == again.tolist()
    assert first.tolist() != other.tolist()


def test_an_episode_by_hand(room: VesselMap) -> None:
    env = VesselNavigation(room, max_steps=3)
    seen, info = env.reset(options={"start": (80, 30), "target": (99, 30)})
    assert seen.tolist() == [80, 30, 80, 30, 99, 30]
    assert info == {"is_success": False, "collision": False, "distance": 19.0}
    seen, reward, terminated, truncated, info = env.step(np.int64(RIGHT))
    assert seen.tolist() == [85, 30, 80, 30, 99, 30]
    assert reward == pytest.approx(-0.005 * 14 - 0.1)
    assert not terminated
    assert not truncated
    _, reward, terminated, truncated, info = env.step(np.int64(RIGHT))
    assert (reward, terminated, truncated) == (1000.0, True, False)
    assert info == {"is_success": True, "collision": False, "distance": 9.0}


def test_it_is_truncated_and_tells_of_collisions(room: VesselMap) -> None:
    env = VesselNavigation(room, max_steps=2)
    env.reset(options={"start": (97, 30), "target": (30, 30)})
    _, _, _, truncated, info = env.step(np.int64(RIGHT))
    assert (truncated, info["collision"]) == (False, True)
    assert env.step(np.int64(RIGHT))[3]


def test_another_map_can_be_given_at_reset(room: VesselMap) -> None:
    env = VesselNavigation("bifurcation")
    seen, _ = env.reset(options={"map": room, "start": (30, 30)})
    assert seen[:2].tolist() == [30, 30]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"start": (57, 57)}, "start"),
        ({"target": (-5, 0)}, "target"),
        ({"start": (1.0,)}, "start"),
        ({"start": (float("nan"), 3.0)}, "start"),
        ({"start": (30, 30), "target": (33, 30)}, "apart"),
        ({"goal": (30, 30)}, "goal"),
    ],
)
def test_bad_options_are_refused(room: VesselMap, options: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        VesselNavigation(room).reset(options=options)


def test_drawn_pairs_are_free_and_apart(room: VesselMap) -> None:
    start, target = draw_pairs(free_points(room), 2000, np.random.default_rng(0))
    assert (np.hypot(*(start - target).T) >= ARRIVAL_PX).all()
    for points in (start, target):
        assert room.free[points[:, 1].astype(int), points[:, 0].astype(int)].all()


def test_the_batch_equals_the_single_environment_step_for_step(room: VesselMap) -> None:
    count, steps, limit = 24, 400, 40
    batch = BatchEnvironment(room, count, seed=3, max_steps=limit)
    singles = [VesselNavigation(room, max_steps=limit) for _ in range(count)]
    for i, single in enumerate(singles):
        single.reset(options={"start": batch.start_px[i], "target": batch.target_px[i]})
    random = np.random.default_rng(9)
    seen = {"terminated": 0, "truncated": 0, "hit": 0}
    for _ in range(steps):
        actions = random.integers(len(ACTIONS), size=count)
        outcome = batch.step(actions)
        after = batch.observations()
        for i, single in enumerate(singles):
            observation, reward, terminated, truncated, info = single.step(actions[i])
            assert observation.tolist() == outcome.final[i].tolist()
            assert reward == outcome.reward[i]
            assert (terminated, truncated) == (outcome.terminated[i], outcome.truncated[i])
            assert info["collision"] == outcome.hit[i]
            if terminated or truncated:
                pair = {"start": batch.start_px[i].copy(), "target": batch.target_px[i].copy()}
                observation, _ = single.reset(options=pair)
            assert observation.tolist() == after[i].tolist()
        seen["terminated"] += int(outcome.terminated.sum())
        seen["truncated"] += int(outcome.truncated.sum())
        seen["hit"] += int(outcome.hit.sum())
    assert min(seen.values()) > 10, f"the run must meet every case: {seen}"
