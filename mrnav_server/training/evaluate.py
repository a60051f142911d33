"""How well a policy navigates: success, path efficiency, wall hits and steps over random pairs."""

from dataclasses import dataclass
from math import sqrt
from typing import Literal

import numpy as np

from mrnav_server.autonomy.geodesic_policy import GeodesicPolicy
from mrnav_server.autonomy.policy import Policy, Sampler
from mrnav_server.core.arrays import BoolArray, FloatArray, IntArray
from mrnav_server.core.navigation import ARRIVAL_PX, MAX_STEPS, STEP_PX, observation, step
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.batch import draw_pairs, free_points

Mode = Literal["greedy", "sample"]


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Figures of one policy on one vessel model, in simulation.

    Attributes:
        policy: The policy's name.
        vessel: The vessel model's name.
        mode: ``"greedy"`` (best action with direction memory) or ``"sample"`` (drawn, as published).
        pairs: Number of random start-target pairs.
        seed: Of the pairs and of the draws.
        success: Share of the pairs that arrived.
        success_low: Lower end of its 95 % Wilson interval.
        success_high: Upper end of that interval.
        spl: Success weighted by path length: mean over the pairs of success times
            ``(geodesic - 10) / max(path, geodesic - 10)``.
        wall_hits: Mean number of moves per pair that would have entered the wall.
        steps: Mean number of steps of the pairs that arrived; NaN if none did.
        simulated: Always True: the grid world, not the rig.
    """

    policy: str
    vessel: str
    mode: Mode
    pairs: int
    seed: int
    success: float
    success_low: float
    success_high: float
    spl: float
    wall_hits: float
    steps: float
    simulated: bool = True

    def summary(self) -> str:
        """Return one line for people."""
        return (
            f"{self.policy} on {self.vessel}, {self.mode}, {self.pairs} pairs (simulated):"
            f" success {self.success:.1%} (95 % CI {self.success_low:.1%} to {self.success_high:.1%}),"
            f" SPL {self.spl:.3f}, wall hits {self.wall_hits:.2f} and steps {self.steps:.0f} a pair"
        )


def evaluate(
    policy: Policy,
    vessel: VesselMap,
    pairs: int = 500,
    mode: Mode = "greedy",
    seed: int = 0,
    max_steps: int = MAX_STEPS,
) -> Evaluation:
    """Run a policy from random starts to random targets under the published rules.

    Args:
        policy: Any policy.
        vessel: The vessel model.
        pairs: Number of pairs, at least 1.
        mode: Greedy with direction memory, or sampled.
        seed: Of the pairs and of the draws.
        max_steps: Steps until a pair counts as failed.
    """
    start, target = draw_pairs(free_points(vessel), pairs, np.random.default_rng(seed))
    runs = _run(
        policy, vessel, start, target, Sampler(greedy=mode == "greedy", seed=seed, agents=pairs), max_steps
    )
    shortest_px = np.maximum(GeodesicPolicy(vessel).path_length_px(start, target) - ARRIVAL_PX, 1.0)
    efficiency = runs.arrived * shortest_px / np.maximum(runs.path_px, shortest_px)
    low, high = wilson_interval(int(runs.arrived.sum()), pairs)
    return Evaluation(
        policy=policy.name,
        vessel=vessel.name,
        mode=mode,
        pairs=pairs,
        seed=seed,
        success=float(runs.arrived.mean()),
        success_low=low,
        success_high=high,
        spl=float(efficiency.mean()),
        wall_hits=float(runs.hits.mean()),
        steps=float(runs.steps[runs.arrived].mean()) if runs.arrived.any() else float("nan"),
    )


def wilson_interval(successes: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Return the Wilson score interval of a proportion.

    Raises:
        ValueError: If there are no trials.

    Source: Wilson 1927.
    """
    if trials < 1:
        raise ValueError("an interval needs at least one trial")
    share = successes / trials
    middle = (share + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z * sqrt(share * (1 - share) / trials + (z / (2 * trials)) ** 2) / (1 + z * z / trials)
    return max(0.0, middle - half), min(1.0, middle + half)


@dataclass(frozen=True, slots=True)
class _Runs:
    arrived: BoolArray
    path_px: FloatArray
    hits: IntArray
    steps: IntArray


def _run(
    policy: Policy,
    vessel: VesselMap,
    start: FloatArray,
    target: FloatArray,
    sampler: Sampler,
    max_steps: int,
) -> _Runs:
    count = len(start)
    runs = _Runs(np.zeros(count, bool), np.zeros(count), np.zeros(count, np.int64), np.zeros(count, np.int64))
    going = np.arange(count)
    position = start.copy()
    for _ in range(max_steps):
        actions = sampler.choose(policy.logits(observation(position, start[going], target[going])))
        moved = step(vessel.free, position, target[going], actions)
        runs.path_px[going] += np.where(moved.hit, 0.0, STEP_PX[actions])
        runs.hits[going] += moved.hit
        runs.steps[going] += 1
        runs.arrived[going] = moved.arrived
        on = ~moved.arrived
        going, position = going[on], moved.position_px[on]
        sampler.keep(on)
        if not going.size:
            break
    return runs
