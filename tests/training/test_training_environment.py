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
from mrnav_server.vision.model_store import find_model, model_names
from mrnav_server.vision.vessel_model import load_vessel_model, save_vessel_model, vessel_map

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


def test_stable_baselines_finds_no_fault() -> None:
    from stable_baselines3.common.env_checker import check_env as check

    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        check(VesselNavigation("bifurcation"))
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


def follow(vessel: VesselMap, count: int, steps: int, limit: int) -> dict[str, int]:
    """Run the batch and single environments side by side; return how often each case was met."""
    batch = BatchEnvironment(vessel, count, seed=3, max_steps=limit)
    singles = [VesselNavigation(vessel, max_steps=limit) for _ in range(count)]
    for i, single in enumerate(singles):
        single.reset(options={"start": batch.start_px[i], "target": batch.target_px[i]})
    random = np.random.default_rng(9)
    seen = {"terminated": 0, "truncated": 0, "hit": 0}
    for _ in range(steps):
        actions = random.integers(len(ACTIONS), size=count)
        outcome = batch.step(actions)
        observations, rewards, terminated, truncated, infos = zip(
            *(single.step(action) for single, action in zip(singles, actions, strict=True)), strict=True
        )
        assert np.array_equal(observations, outcome.final)
        assert np.array_equal(rewards, outcome.reward)
        assert np.array_equal(terminated, outcome.terminated)
        assert np.array_equal(truncated, outcome.truncated)
        assert [info["collision"] for info in infos] == outcome.hit.tolist()
        now = np.array(observations)
        for i in map(int, np.flatnonzero(outcome.terminated | outcome.truncated)):
            pair = {"start": batch.start_px[i], "target": batch.target_px[i]}
            now[i], _ = singles[i].reset(options=pair)
        assert np.array_equal(now, batch.observations())
        seen["terminated"] += int(outcome.terminated.sum())
        seen["truncated"] += int(outcome.truncated.sum())
        seen["hit"] += int(outcome.hit.sum())
    return seen


def test_the_batch_equals_the_single_environment_step_for_step(room: VesselMap) -> None:
    seen = follow(room, count=24, steps=400, limit=40)
    assert min(seen.values()) > 10, f"the run must meet every case: {seen}"


def test_the_batch_equals_the_single_environment_on_every_model_that_ships() -> None:
    """At least 100,000 random steps in all."""
    count, total, names = 100, 102_000, model_names()
    for name in names:
        steps = -(-total // (count * len(names)))
        seen = follow(load_vessel_model(find_model(name)), count, steps, limit=150)
        assert min(seen["truncated"], seen["hit"]) > 10, f"{name}: {seen}"


def test_a_batch_goes_on_from_its_state(room: VesselMap) -> None:
    first, second = (BatchEnvironment(room, 32, seed=seed, max_steps=9) for seed in (1, 2))
    actions = np.random.default_rng(0).integers(len(ACTIONS), size=(60, 32))
    for row in actions[:30]:
        first.step(row)
    second.restore(first.state())
    for row in actions[30:]:
        one, other = first.step(row), second.step(row)
        assert np.array_equal(one.reward, other.reward)
        assert np.array_equal(first.observations(), second.observations())


def test_a_batch_refuses_an_action_that_there_is_not(room: VesselMap) -> None:
    with pytest.raises(IndexError):
        BatchEnvironment(room, 2, seed=0).step(np.array([0, len(ACTIONS)]))
