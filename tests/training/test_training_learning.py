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
from mrnav_server.training.experience import Episodes, advantages
from mrnav_server.training.expert import draw_states
from mrnav_server.training.learner import Learner
from mrnav_server.training.network import Features, PolicyNetwork, wall_levels
from mrnav_server.training.presets import (
    PRESETS,
    A2cSettings,
    Algorithm,
    CloningSettings,
    PpoSettings,
    Preset,
    find_preset,
)
from mrnav_server.training.progress import Report
from mrnav_server.training.train import train
from mrnav_server.vision.vessel_model import save_vessel_model, vessel_map


@pytest.fixture
def brief_evaluation(monkeypatch: pytest.MonkeyPatch) -> None:
    """End hopeless evaluation runs early: a policy that was barely trained may never arrive."""
    monkeypatch.setattr("mrnav_server.training.train.evaluate", partial(evaluate, max_steps=500))


def test_features_of_a_known_observation() -> None:
    features = Features("fourier", size_px=1800)(torch.tensor([[450.0, 900.0, 7.0, 7.0, 450.0, 1000.0]]))[0]
    assert features.shape == (61,)
    assert features[:4].tolist() == pytest.approx([-0.5, 0.0, -0.5, 1 / 9], abs=1e-6)
    assert features[4:10].tolist() == pytest.approx([0, 1 / 9, 0, 0.5, 0, 1], abs=1e-5)
    sines = [math.sin(math.pi / 4 * 2**k) for k in range(6)] + [
        math.sin(math.pi / 2 * 2**k) for k in range(6)
    ]
    assert features[10:22].tolist() == pytest.approx(sines, abs=1e-4)
    cosines = [math.cos(math.pi / 4 * 2**k) for k in range(6)]
    assert features[34:40].tolist() == pytest.approx(cosines, abs=1e-4)
    assert features[-3:].tolist() == pytest.approx([0, 1, 1 / 9], abs=1e-5)


def test_raw_features_are_scaled_to_one() -> None:
    features = Features("raw", size_px=1800)(torch.tensor([[0.0, 900.0, 1800.0, 0.0, 0.0, 450.0]]))
    assert features.tolist() == [[-1, 0, 1, -1, -1, -0.5]]


def test_the_wall_allows_the_best_level_within_reach(corner: VesselMap) -> None:
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


def test_between_pixels_the_nearest_counts(corner: VesselMap) -> None:
    network = PolicyNetwork(corner, hidden=8)
    points = np.argwhere(corner.free)[:, ::-1][::61].astype(float)
    between = points + np.random.default_rng(0).uniform(-0.49, 0.49, points.shape)
    on, off = (
        network.allowed(torch.from_numpy(observation(each, points, points))) for each in (points, between)
    )
    assert torch.equal(on, off)


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


def test_a_trace_that_does_not_decay_gives_n_step_returns() -> None:
    rewards = np.array([[1.0], [2.0], [4.0]], np.float32)
    values = np.array([[10.0], [20.0], [30.0]], np.float32)
    follows = np.array([[20.0], [30.0], [40.0]], np.float32)
    none = np.zeros((3, 1), bool)
    estimate = advantages(rewards, values, none, none, follows, discount=0.5, trace_decay=1.0)
    # Returns at discount 0.5, bootstrapped with 40: 4 + 20 = 24; 2 + 12 = 14; 1 + 7 = 8.
    assert (estimate + values).ravel().tolist() == pytest.approx([8, 14, 24])


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


@pytest.mark.parametrize(
    "settings",
    [
        PpoSettings(
            steps=100_000,
            environments=128,
            horizon=32,
            minibatch=1024,
            critic_updates=0,
            max_steps=200,
            entropy=0.005,
            discount=0.99,
            learning_rate=2e-3,
        ),
        A2cSettings(
            steps=200_000,
            environments=128,
            critic_updates=0,
            max_steps=200,
            entropy=0.005,
            discount=0.99,
            learning_rate=2e-3,
        ),
    ],
    ids=["ppo", "a2c"],
)
def test_reinforcement_learning_improves_a_policy_without_a_teacher(
    corner: VesselMap, settings: PpoSettings | A2cSettings
) -> None:
    torch.manual_seed(0)
    network = PolicyNetwork(corner, hidden=32)
    rates: list[float | None] = []
    Learner(network, corner, settings, 32, seed=0).learn(lambda report, _: rates.append(report.reward))
    few = len(rates) // 8
    first, last = (np.mean([rate or 0.0 for rate in part]) for part in (rates[:few], rates[-few:]))
    assert last > 2 * first


@pytest.mark.parametrize(
    "settings",
    [PpoSettings(environments=16, horizon=16, minibatch=64), A2cSettings(environments=16)],
    ids=["ppo", "a2c"],
)
def test_the_critic_learns_alone_at_first(corner: VesselMap, settings: PpoSettings | A2cSettings) -> None:
    torch.manual_seed(0)
    network = PolicyNetwork(corner, hidden=16)
    learner = Learner(network, corner, settings, 16, seed=0)
    before = [weight.detach().clone() for weight in network.head.parameters()]
    critic_before = [weight.detach().clone() for weight in learner.critic.parameters()]
    learner.algorithm.update(learner.collector.collect(), critic_only=True)
    assert all(map(torch.equal, before, network.head.parameters()))
    assert not all(map(torch.equal, critic_before, learner.critic.parameters()))
    learner.algorithm.update(learner.collector.collect(), critic_only=False)
    assert not all(map(torch.equal, before, network.head.parameters()))


def test_a2c_is_ppo_with_one_pass_over_one_minibatch(corner: VesselMap) -> None:
    """Huang et al. 2022: where the ratio is 1 the clip is idle, and both gradients agree."""
    gradients = []
    for settings in (
        PpoSettings(environments=16, horizon=8, minibatch=128, epochs=1, trace_decay=1.0),
        A2cSettings(environments=16, horizon=8),
    ):
        torch.manual_seed(0)
        network = PolicyNetwork(corner, hidden=16)
        learner = Learner(network, corner, settings, 16, seed=0)
        learner.algorithm.update(learner.collector.collect(), critic_only=False)
        gradients.append(
            torch.cat([p.grad.flatten() for p in network.head.parameters() if p.grad is not None])
        )
    assert gradients[0].abs().max() > 1e-4
    assert torch.allclose(gradients[0], gradients[1], atol=1e-6)


def test_episodes_are_counted_whole(corner: VesselMap) -> None:
    """Truncated after 10 steps: every environment ends one in every 10 steps, at the latest."""
    learner = Learner(
        PolicyNetwork(corner, hidden=8),
        corner,
        PpoSettings(environments=4, horizon=16, steps=128, minibatch=64, max_steps=10),
        8,
        seed=0,
    )
    told: list[Episodes] = []
    learner.learn(lambda _, episodes: told.append(episodes))
    steps = np.concatenate([one.steps for one in told])
    arrived = np.concatenate([one.arrived for one in told])
    rewards = np.concatenate([one.rewards for one in told])
    assert len(steps) >= 12
    assert (steps[~arrived] == 10).all()
    assert steps.sum() <= 128
    assert (rewards[~arrived] < 0).all()
    assert (rewards[arrived] > 900).all()
    assert all(set(one.ended_after) <= set(range(4, 65, 4)) for one in told)


@pytest.mark.usefixtures("brief_evaluation")
@pytest.mark.parametrize("algorithm", ["ppo", "a2c"])
@pytest.mark.parametrize("name", list(PRESETS))
def test_every_preset_runs_with_either_algorithm(tmp_path: Path, name: str, algorithm: Algorithm) -> None:
    chamber = vessel_map("chamber", np.full((50, 50), 255, np.uint8), robot_radius_um=100.0)
    save_vessel_model(tmp_path / "chamber", chamber, "chamber", "test")
    settings = ["steps=256", "environments=8", "horizon=16", "max_steps=50", "cloning.updates=2"]
    if PRESETS[name].cloning.labels:
        settings.append("cloning.labels=200")
    out = tmp_path / "out"
    result = train(tmp_path / "chamber", name, 0, out, pairs=1, algorithm=algorithm, settings=settings)
    identity = load_policy(out, chamber).identity
    assert identity.preset == (name if algorithm == "ppo" else f"{name}-a2c")
    assert result.environment_steps == 256
    assert (out / "policy.pt").stat().st_size < 400_000


def test_an_unknown_preset_names_those_there_are() -> None:
    with pytest.raises(ConfigError, match=r"best, paper\+, paper"):
        find_preset("bset")


def test_evaluation_repeats_by_seed(corner: VesselMap) -> None:
    from mrnav_server.autonomy.geodesic_policy import GeodesicPolicy

    policy = GeodesicPolicy(corner)
    assert evaluate(policy, corner, 20, "sample", seed=2) == evaluate(policy, corner, 20, "sample", seed=2)
    assert evaluate(policy, corner, 20, "sample", seed=2) != evaluate(policy, corner, 20, "sample", seed=3)
