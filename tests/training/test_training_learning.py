"""Networks, advantage estimates, and that a short training learns."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from mrnav_server.autonomy.torchscript import load_policy
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.navigation import ACTIONS, free_actions, observation
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.evaluate import evaluate
from mrnav_server.training.expert import draw_states
from mrnav_server.training.network import Features, PolicyNetwork, wall_levels
from mrnav_server.training.ppo import PpoLearner, advantages
from mrnav_server.training.presets import (
    PRESETS,
    CloningSettings,
    PpoSettings,
    Preset,
    find_preset,
)
from mrnav_server.training.progress import Report
from mrnav_server.training.train import train
from mrnav_server.vision.vessel_model import save_vessel_model, vessel_map


@pytest.fixture(scope="module")
def corner() -> VesselMap:
    mask = np.zeros((200, 200), np.uint8)
    mask[20:71, 20:181] = 255
    mask[20:181, 130:181] = 255
    return vessel_map("corner", mask, robot_radius_um=100.0)


@pytest.fixture
def brief_evaluation(monkeypatch: pytest.MonkeyPatch) -> None:
    """End hopeless evaluation runs early: a policy that was barely trained may never arrive."""
    monkeypatch.setattr("mrnav_server.training.train.evaluate", partial(evaluate, max_steps=500))


def test_features_of_a_known_observation() -> None:
    features = Features("fourier", size_px=1800)(torch.tensor([[450.0, 900.0, 7.0, 7.0, 450.0, 1000.0]]))[0]
    assert features.shape == (61,)
    assert features[:4].tolist() == pytest.approx([-0.5, 0.0, -0.5, 1 / 9], abs=1e-6)
    assert features[4:6].tolist() == pytest.approx([math.sin(math.pi / 4), 1.0], abs=1e-5)
    tail = [0, 1 / 9, 0, 0.5, 0, 1, 0, 1, 1 / 9]
    assert features[-9:].tolist() == pytest.approx(tail, abs=1e-5)


def test_raw_features_are_scaled_to_one() -> None:
    features = Features("raw", size_px=1800)(torch.tensor([[0.0, 900.0, 1800.0, 0.0, 0.0, 450.0]]))
    assert features.tolist() == [[-1, 0, 1, -1, -1, -0.5]]


def test_the_packed_wall_allows_the_best_level_within_reach(corner: VesselMap) -> None:
    network = PolicyNetwork(corner, hidden=8)
    levels = np.pad(wall_levels(corner, 5.0), 10)
    points = np.argwhere(corner.free)[:, ::-1][::61].astype(float)
    reached = points.astype(int)[:, None] + ACTIONS + 10
    level = levels[reached[..., 1], reached[..., 0]]
    wanted = level == level.max(axis=1, keepdims=True)
    allowed = network.allowed(torch.from_numpy(observation(points, points, points))).numpy()
    assert (allowed == wanted).all()
    assert (allowed <= free_actions(corner.free, points)).all()
    assert 0 < allowed.mean() < 1


def test_outside_the_grid_is_never_allowed() -> None:
    everywhere = vessel_map("plate", np.full((60, 60), 255, np.uint8), robot_radius_um=10.0)
    corner = np.array([[2.0, 2.0]])
    allowed = PolicyNetwork(everywhere, hidden=8).allowed(
        torch.from_numpy(observation(corner, corner, corner))
    )
    assert (ACTIONS[allowed[0].numpy()] + 2 >= 0).all()


def test_advantages_in_closed_form() -> None:
    rewards = np.array([[1.0], [2.0], [4.0]], np.float32)
    values = np.array([[10.0], [20.0], [30.0]], np.float32)
    follows = np.array([[20.0], [30.0], [40.0]], np.float32)
    none = np.zeros((3, 1), bool)
    # Surprises at discount 0.5: 1 + 10 - 10 = 1; 2 + 15 - 20 = -3; 4 + 20 - 30 = -6.
    estimate = advantages(rewards, values, none, none, follows, discount=0.5, trace_decay=0.5)
    assert estimate.ravel().tolist() == pytest.approx([1 - 3 / 4 - 6 / 16, -3 - 6 / 4, -6])


def test_advantages_stop_at_the_end_and_bootstrap_a_truncation() -> None:
    rewards, values = np.ones((2, 2), np.float32), np.zeros((2, 2), np.float32)
    follows = np.full((2, 2), 8.0, np.float32)
    terminated = np.array([[True, False], [False, False]])
    truncated = np.array([[False, True], [False, False]])
    estimate = advantages(rewards, values, terminated, truncated, follows, discount=0.5, trace_decay=1.0)
    assert estimate.tolist() == [[1.0, 5.0], [5.0, 5.0]]


def test_the_states_to_clone_are_free_and_partly_near(corner: VesselMap) -> None:
    states = draw_states(corner, 4000, np.random.default_rng(0))
    for points in (states[:, 0:2], states[:, 4:6]):
        assert corner.free[points[:, 1].astype(int), points[:, 0].astype(int)].all()
    distance = np.hypot(*(states[:, 0:2] - states[:, 4:6]).T)
    assert distance.min() >= 10
    assert np.median(distance[:800]) < np.median(distance[800:])


TINY = Preset(
    "tiny",
    "a test",
    hidden=32,
    cloning=CloningSettings(labels=4000, updates=250, batch=256),
    ppo=PpoSettings(steps=8192, environments=64, horizon=32, minibatch=512, max_steps=200, critic_updates=2),
)


@pytest.mark.usefixtures("brief_evaluation")
def test_a_short_training_learns_and_repeats(corner: VesselMap, tmp_path: Path) -> None:
    save_vessel_model(tmp_path / "corner", corner, "corner", "test")
    reports: list[Report] = []
    result = train(tmp_path / "corner", TINY, 0, tmp_path / "out", reports.append, pairs=60)
    assert result.greedy.success > 0.95
    assert result.sampled.success > 0.95
    assert result.environment_steps == 8192
    assert [steps for steps, _ in result.curve] == [2048, 4096, 6144, 8192]
    assert {report.stage for report in reports} == {"plan", "clone", "reinforce", "evaluate"}
    untrained = replace(TINY, cloning=CloningSettings(labels=0), ppo=PpoSettings(steps=0))
    before = train(tmp_path / "corner", untrained, 0, tmp_path / "before", pairs=60)
    assert before.greedy.spl < 0.5 < 0.8 < result.greedy.spl

    again = train(tmp_path / "corner", TINY, 0, tmp_path / "again", pairs=1)
    golden = draw_states(corner, 20, np.random.default_rng(1))
    first, second = (load_policy(folder, corner) for folder in (result.folder, again.folder))
    assert (first.logits(golden) == second.logits(golden)).all()


@pytest.mark.usefixtures("brief_evaluation")
def test_the_card_says_what_it_is(corner: VesselMap, tmp_path: Path) -> None:
    import yaml

    save_vessel_model(tmp_path / "corner", corner, "corner", "test")
    short = replace(TINY, cloning=CloningSettings(labels=200, updates=1), ppo=PpoSettings(steps=0))
    result = train(tmp_path / "corner", short, 3, pairs=10)
    _, front, body = (result.folder / "card.md").read_text().split("---\n", 2)
    card = yaml.safe_load(front)
    assert (card["name"], card["seed"], card["simulated"]) == ("corner-tiny", 3, True)
    assert card["success_greedy"] == pytest.approx(result.greedy.success, abs=1e-4)
    assert card["map_sha256"] == corner.digest
    assert "simulated" in body
    assert "## Limits" in body


def test_reinforcement_learning_improves_a_policy_without_a_teacher(corner: VesselMap) -> None:
    torch.manual_seed(0)
    network = PolicyNetwork(corner, hidden=32)
    settings = PpoSettings(
        steps=100_000,
        environments=128,
        horizon=32,
        minibatch=1024,
        learning_rate=2e-3,
        entropy=0.005,
        discount=0.99,
        critic_updates=0,
        max_steps=200,
    )
    rates: list[float | None] = []
    PpoLearner(network, corner, settings, 32, seed=0).learn(lambda report: rates.append(report.reward))
    first, last = (np.mean([rate or 0.0 for rate in part]) for part in (rates[:3], rates[-3:]))
    assert last > 2 * first


def test_the_critic_learns_alone_at_first(corner: VesselMap) -> None:
    torch.manual_seed(0)
    network = PolicyNetwork(corner, hidden=16)
    learner = PpoLearner(network, corner, PpoSettings(environments=16, horizon=16, minibatch=64), 16, seed=0)
    before = [weight.detach().clone() for weight in network.head.parameters()]
    critic_before = [weight.detach().clone() for weight in learner.critic.parameters()]
    learner.update(learner.collect(), critic_only=True)
    assert all(map(torch.equal, before, network.head.parameters()))
    assert not all(map(torch.equal, critic_before, learner.critic.parameters()))
    learner.update(learner.collect(), critic_only=False)
    assert not all(map(torch.equal, before, network.head.parameters()))


@pytest.mark.usefixtures("brief_evaluation")
def test_every_preset_runs(tmp_path: Path) -> None:
    chamber = vessel_map("chamber", np.full((50, 50), 255, np.uint8), robot_radius_um=100.0)
    save_vessel_model(tmp_path / "chamber", chamber, "chamber", "test")
    for preset in PRESETS.values():
        s = preset.ppo
        short = replace(
            preset,
            cloning=replace(preset.cloning, labels=min(200, preset.cloning.labels), updates=2),
            ppo=replace(s, steps=2 * 8 * s.horizon, environments=8, minibatch=64, max_steps=50),
        )
        result = train(tmp_path / "chamber", short, 0, tmp_path / preset.name, pairs=1)
        assert load_policy(result.folder, chamber).identity.preset == preset.name
        assert (result.folder / "policy.pt").stat().st_size < 400_000


def test_an_unknown_preset_names_those_there_are() -> None:
    with pytest.raises(ConfigError, match="best, paper"):
        find_preset("bset")


def test_evaluation_repeats_by_seed(corner: VesselMap) -> None:
    from mrnav_server.autonomy.geodesic_policy import GeodesicPolicy

    policy = GeodesicPolicy(corner)
    assert evaluate(policy, corner, 20, "sample", seed=2) == evaluate(policy, corner, 20, "sample", seed=2)
    assert evaluate(policy, corner, 20, "sample", seed=2) != evaluate(policy, corner, 20, "sample", seed=3)
