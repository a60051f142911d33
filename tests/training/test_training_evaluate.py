"""Figures of merit, by policies whose figures are known."""

import math

import numpy as np
import pytest

from mrnav_server.autonomy.geodesic_policy import GeodesicPolicy
from mrnav_server.autonomy.policy import Sampler
from mrnav_server.core.arrays import Float32Array
from mrnav_server.core.navigation import ACTIONS
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.evaluate import Task, evaluate, wilson_interval
from mrnav_server.training.failures import failures_figure
from mrnav_server.training.robustness import WORLDS, markdown, robustness
from mrnav_server.training.rollout import Disturbance, Runs, Trace, roll_out
from mrnav_server.training.shortest import shortest_ways
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


class Dithering:
    """Steps right where x is even and left where it is odd, for as long as it may."""

    name = "dithering"
    kind = "test"

    def logits(self, observations: Float32Array) -> Float32Array:
        logits = np.full((len(observations), len(ACTIONS)), -2e9, np.float32)
        even = observations[:, 0].astype(int) % 2 == 0
        logits[np.arange(len(even)), np.where(even, RIGHT, LEFT)] = 0.0
        return logits


RIGHT, LEFT = (ACTIONS.tolist().index(move) for move in ([5, 0], [-5, 0]))


@pytest.fixture(scope="module")
def room() -> VesselMap:
    mask = np.zeros((160, 160), np.uint8)
    mask[10:150, 10:150] = 255
    return vessel_map("room", mask, robot_radius_um=100.0)


def run(
    vessel: VesselMap,
    action: int | None,
    start: tuple[float, float],
    target: tuple[float, float],
    disturbance: Disturbance | None = None,
    max_steps: int = 1000,
    trace: Trace | None = None,
) -> Runs:
    policy = Dithering() if action is None else Stubborn(action)
    start_px, target_px = np.array([start]), np.array([target])
    sampler = Sampler(greedy=True)
    world = disturbance or Disturbance()
    return roll_out(policy, vessel, start_px, target_px, sampler, world, max_steps=max_steps, trace=trace)


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
    assert 0.9 < result.steps_ratio < 1.1
    assert result.simulated
    assert "simulated" in result.summary()


def test_a_stubborn_policy_runs_into_the_wall_and_fails(room: VesselMap) -> None:
    result = evaluate(Stubborn(RIGHT), room, pairs=40, max_steps=100)
    assert result.success < 0.3
    assert result.spl <= result.success
    # At most 28 steps cross the room; the rest of a failed pair is spent at the wall.
    assert result.wall_hits > (1 - result.success) * (100 - 28)


def test_figures_that_nobody_earned_are_null_in_json(room: VesselMap) -> None:
    result = evaluate(Stubborn(RIGHT), room, pairs=1, seed=1, max_steps=1)
    assert (result.success, math.isnan(result.steps_ratio)) == (0.0, True)
    record = result.record()
    assert list(record)[:9] == [
        *("model", "policy", "mode", "n", "success", "success_low", "spl", "wall_hits", "steps_ratio")
    ]
    assert record["steps_ratio"] is None


def test_a_straight_run_in_closed_form(room: VesselMap) -> None:
    # From x = 40 in steps of 5: 90 is 15 px from 105, and 100 is 5 px from it, the first below 10.
    runs = run(room, RIGHT, (40, 80), (105, 80))
    assert (runs.arrived[0], runs.steps[0], runs.path_px[0], runs.hits[0]) == (True, 12, 60.0, 0)
    assert runs.end_px.tolist() == [[100.0, 80.0]]
    halved = run(room, RIGHT, (40, 80), (105, 80), Disturbance(scale=0.5))
    assert (halved.steps[0], halved.path_px[0]) == (23, 57.5)


def test_what_repeats_for_ever_is_counted_as_if_it_ran(room: VesselMap) -> None:
    looped = run(room, RIGHT, (40, 80), (80, 120), max_steps=20_000)
    # The free space ends at x = 138 or 139: 19 moves, then nothing but the wall.
    assert (looped.arrived[0], looped.steps[0]) == (False, 20_000)
    assert looped.hits[0] == pytest.approx(20_000 - 19, abs=1)
    for action in (RIGHT, None):
        # A disturbance too small to matter keeps the shortcut out.
        plainly = run(room, action, (40, 80), (80, 120), Disturbance(scale=1.0 + 1e-12), max_steps=5000)
        shortly = run(room, action, (40, 80), (80, 120), max_steps=5000)
        assert (plainly.hits == shortly.hits).all()
        assert (plainly.steps == shortly.steps).all()
        assert np.allclose(plainly.end_px, shortly.end_px, atol=1e-6)


def test_a_delayed_policy_sees_where_it_was(room: VesselMap) -> None:
    seen: list[float] = []

    class Watching(Stubborn):
        def logits(self, observations: Float32Array) -> Float32Array:
            seen.append(float(observations[0, 0]))
            return super().logits(observations)

    start, target = np.array([[40.0, 80.0]]), np.array([[130.0, 120.0]])
    sampler = Sampler(greedy=True)
    roll_out(Watching(RIGHT), room, start, target, sampler, Disturbance(delay_steps=2), max_steps=6)
    assert seen == [40, 40, 40, 45, 50, 55]


def test_noise_is_seen_repeats_by_seed_and_does_not_move_the_agent(room: VesselMap) -> None:
    planner = GeodesicPolicy(room)
    task = Task.draw(room, 30, seed=4)
    noisy = task.run(planner, "greedy", Disturbance(noise_px=3.0))[0]
    assert noisy == task.run(planner, "greedy", Disturbance(noise_px=3.0))[0]
    assert noisy.spl < task.run(planner, "greedy")[0].spl
    still = run(room, RIGHT, (40, 80), (105, 80), Disturbance(noise_px=3.0))
    assert still.end_px.tolist() == [[100.0, 80.0]]


def test_the_shortest_ways_in_closed_form(room: VesselMap, corner: VesselMap) -> None:
    length_px, steps = shortest_ways(room, np.array([[40.0, 40.0]]), np.array([[80.0, 70.0]]))
    assert (length_px.tolist(), steps.tolist()) == ([50.0], [6.0])  # (40 - 10) / 5
    around, _ = shortest_ways(corner, np.array([[40.0, 45.0]]), np.array([[155.0, 160.0]]))
    # The robot's centre turns about (140, 60), a robot's radius off the lumen's inner corner at (130, 70).
    bend = math.dist((40, 45), (140, 60)) + math.dist((140, 60), (155, 160))
    assert around[0] == pytest.approx(bend, rel=0.02)


def test_the_table_holds_every_world_in_both_modes(room: VesselMap) -> None:
    planner = GeodesicPolicy(room)
    rows = robustness(planner, Task.draw(room, 10, seed=0))
    assert [(row.mode, row.disturbance) for row in rows] == [
        *(("greedy", world) for world in WORLDS),
        *(("sample", world) for world in WORLDS),
    ]
    table = markdown(rows)
    assert "(simulated)" in table
    for words in ("plain", "noise 10 px", "delay 6 steps", "scale 0.5", "scale 1.5"):
        assert table.count(f"| {words} |") == 2


def test_the_failures_are_drawn_with_their_ways(room: VesselMap) -> None:
    task, trace = Task.draw(room, 20, seed=0), Trace(every=1)
    result, runs = task.run(Stubborn(RIGHT), max_steps=60, trace=trace)
    failed = np.flatnonzero(~runs.arrived)
    way = trace.of(int(failed[0]))
    assert way[0].tolist() == task.start_px[failed[0]].tolist()
    assert (np.diff(way[:, 0]) >= 0).all()
    assert way[-1].tolist() == runs.end_px[failed[0]].tolist()
    title = failures_figure(task, result, runs, trace).axes[0].get_title()
    assert f"{len(failed)} of 20 pairs failed" in title
    assert "simulated" in title
