"""Drawing actions from logits, and the shield before the wall."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.autonomy.policy import FORBIDDEN_LOGIT, Sampler, shield
from mrnav_server.core.arrays import Float32Array
from mrnav_server.core.navigation import ACTIONS, DIRECTIONS, free_actions
from mrnav_server.core.vessel import VesselMap
from mrnav_server.vision.vessel_model import vessel_map


def make_corridor() -> VesselMap:
    """A bent corridor 50 px wide for a robot of 10 px radius."""
    mask = np.zeros((200, 200), np.uint8)
    mask[20:70, 20:180] = 255
    mask[20:180, 130:180] = 255
    return vessel_map("corridor", mask, robot_radius_um=100.0)


CORRIDOR = make_corridor()
FREE_POINTS = np.argwhere(CORRIDOR.free)[:, ::-1]


def action_towards(dx: int, dy: int) -> int:
    return int(ACTIONS.tolist().index([dx, dy]))


def heading_for(degrees: float) -> int:
    """The action that goes most nearly in a direction."""
    return int((DIRECTIONS @ [np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))]).argmax())


def logits_preferring(*actions: int) -> Float32Array:
    """Logits of one agent: the first action is best, the next second best, and so on."""
    logits = np.zeros((1, 40), np.float32)
    for rank, action in enumerate(actions):
        logits[0, action] = 10.0 - rank
    return logits


def test_greedy_takes_the_best_action() -> None:
    assert Sampler(greedy=True).choose(logits_preferring(7)).tolist() == [7]


def test_greedy_does_not_turn_back() -> None:
    right, left, up = action_towards(5, 0), action_towards(-5, 0), action_towards(0, -5)
    sampler = Sampler(greedy=True)
    assert sampler.choose(logits_preferring(right)).tolist() == [right]
    assert sampler.choose(logits_preferring(left, up)).tolist() == [up]


def test_greedy_turns_when_nothing_else_is_allowed() -> None:
    right, left = action_towards(5, 0), action_towards(-5, 0)
    only_left = np.full((1, 40), FORBIDDEN_LOGIT, np.float32)
    only_left[0, left] = 0.0
    sampler = Sampler(greedy=True)
    sampler.choose(logits_preferring(right))
    assert sampler.choose(only_left).tolist() == [left]


def test_an_agent_that_circles_wanders_over_what_is_allowed_and_then_goes_on() -> None:
    sampler = Sampler(greedy=True)
    round_and_round = [heading_for(22.5 * step) for step in range(16)]
    forbidden = heading_for(10.0)
    obeyed = []
    for step in range(400):
        wished = round_and_round[step % 16]
        logits = logits_preferring(wished)
        logits[0, forbidden] = FORBIDDEN_LOGIT
        chosen = int(sampler.choose(logits)[0])
        assert chosen != forbidden
        obeyed.append(chosen == wished)
    assert all(obeyed[:32])
    assert not all(obeyed[32:80])
    assert obeyed[-200:].count(True) > 50


def test_a_way_that_winds_to_and_fro_is_no_circling() -> None:
    sampler = Sampler(greedy=True)
    there = [heading_for(45.0 * step) for step in range(5)]
    for _ in range(20):
        for wished in there + there[-2:0:-1]:
            assert int(sampler.choose(logits_preferring(wished))[0]) == wished


def test_memory_fades_so_that_a_detour_can_end() -> None:
    right, left, up = action_towards(5, 0), action_towards(-5, 0), action_towards(0, -5)
    sampler = Sampler(greedy=True)
    for _ in range(5):
        sampler.choose(logits_preferring(right))
    for _ in range(12):
        sampler.choose(logits_preferring(up))
    assert sampler.choose(logits_preferring(left, up)).tolist() == [left]


def test_memory_belongs_to_the_agents_that_stay() -> None:
    right, left, up = action_towards(5, 0), action_towards(-5, 0), action_towards(0, -5)
    sampler = Sampler(greedy=True, agents=2)
    sampler.choose(np.concatenate([logits_preferring(left), logits_preferring(right)]))
    sampler.keep(np.array([False, True]))
    assert sampler.choose(logits_preferring(left, up)).tolist() == [up]


def test_sampling_repeats_by_seed() -> None:
    logits = np.random.default_rng(3).normal(size=(200, 40)).astype(np.float32)
    first = Sampler(greedy=False, seed=5).choose(logits)
    assert (Sampler(greedy=False, seed=5).choose(logits) == first).all()
    assert (Sampler(greedy=False, seed=6).choose(logits) != first).any()


def test_sampling_follows_the_distribution() -> None:
    logits = np.full((20_000, 40), FORBIDDEN_LOGIT, np.float32)
    logits[:, 4], logits[:, 9] = np.log(0.25), np.log(0.75)
    drawn = Sampler(greedy=False, seed=1).choose(logits)
    assert set(drawn.tolist()) == {4, 9}
    assert (drawn == 9).mean() == pytest.approx(0.75, abs=0.015)


@given(
    where=st.integers(0, len(FREE_POINTS) - 1),
    seed=st.integers(0, 1000),
    spread=st.floats(0.0, 200.0),
    forbidden=st.floats(0.0, 1.0),
    greedy=st.booleans(),
)
def test_the_shield_never_lets_into_the_wall(
    where: int, seed: int, spread: float, forbidden: float, greedy: bool
) -> None:
    random = np.random.default_rng(seed)
    positions = np.repeat(FREE_POINTS[where : where + 1].astype(float), 8, axis=0)
    logits = (random.normal(size=(8, 40)) * spread).astype(np.float32)
    logits[random.random((8, 40)) < forbidden] = FORBIDDEN_LOGIT
    free = free_actions(CORRIDOR.free, positions)
    assert free.any(axis=1).all()
    sampler = Sampler(greedy=greedy, seed=seed, agents=8)
    for _ in range(3):
        actions = sampler.choose(shield(CORRIDOR, positions, logits))
        assert free[np.arange(8), actions].all()


def test_the_shield_keeps_what_the_policy_forbids_while_it_can() -> None:
    middle = np.array([[100.0, 45.0]])
    logits = np.zeros((1, 40), np.float32)
    logits[0, :20] = FORBIDDEN_LOGIT
    assert (shield(CORRIDOR, middle, logits)[0, :20] == FORBIDDEN_LOGIT).all()


def test_the_shield_leaves_a_trapped_agent_to_the_policy() -> None:
    outside = np.array([[100.0, 150.0]])
    shielded = shield(CORRIDOR, outside, logits_preferring(action_towards(0, -5)))
    assert shielded.argmax() == action_towards(0, -5)
    assert np.isfinite(DIRECTIONS[shielded.argmax()]).all()
