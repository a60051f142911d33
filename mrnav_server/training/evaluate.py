"""How well a policy navigates: success, path efficiency, wall hits and steps over random pairs."""

from dataclasses import asdict, dataclass, field
from math import isnan, sqrt
from typing import Any, Literal

import numpy as np

from mrnav_server.autonomy.policy import Policy, Sampler
from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.navigation import ARRIVAL_PX, MAX_STEPS
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.batch import draw_pairs, free_points
from mrnav_server.training.rollout import Disturbance, Runs, Trace, roll_out
from mrnav_server.training.shortest import shortest_ways

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
        steps_ratio: Mean of steps over the fewest along the geodesic, of the pairs that arrived; NaN if none.
        disturbance: How the world differed from the published one.
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
    steps_ratio: float
    disturbance: Disturbance = field(default_factory=Disturbance)
    simulated: bool = True

    def summary(self) -> str:
        """Return one line for people."""
        world = "" if self.disturbance.none else f", {self.disturbance}"
        return (
            f"{self.policy} on {self.vessel}, {self.mode}{world}, {self.pairs} pairs (simulated):"
            f" success {self.success:.2%} (95 % CI {self.success_low:.2%} to {self.success_high:.2%}),"
            f" SPL {self.spl:.3f}, wall hits {self.wall_hits:.2f} and steps {self.steps:.0f} a pair,"
            f" {self.steps_ratio:.2f} times the fewest"
        )

    def record(self) -> dict[str, Any]:
        """Return the figures for JSON, the ones that programs rely on first; NaN becomes None."""
        row = {
            "model": self.vessel,
            "policy": self.policy,
            "mode": self.mode,
            "n": self.pairs,
            "success": self.success,
            "success_low": self.success_low,
            "spl": self.spl,
            "wall_hits": self.wall_hits,
            "steps_ratio": self.steps_ratio,
            "success_high": self.success_high,
            "steps": self.steps,
            "seed": self.seed,
            **asdict(self.disturbance),
            "simulated": self.simulated,
        }
        unearned = {key for key, value in row.items() if isinstance(value, float) and isnan(value)}
        return row | dict.fromkeys(unearned)


@dataclass(frozen=True, slots=True)
class Task:
    """Fixed pairs on one vessel and the shortest ways between them, for any number of evaluations.

    Attributes:
        vessel: The vessel model.
        seed: Of the pairs.
        start_px: Shape (n, 2).
        target_px: Shape (n, 2).
        shortest_px: Geodesic lengths, shape (n,).
        least_steps: Fewest steps along the geodesics, shape (n,).
    """

    vessel: VesselMap
    seed: int
    start_px: FloatArray
    target_px: FloatArray
    shortest_px: FloatArray
    least_steps: FloatArray

    @classmethod
    def draw(cls, vessel: VesselMap, pairs: int, seed: int) -> "Task":
        """Draw pairs from the free space; the same seed gives the same pairs."""
        start_px, target_px = draw_pairs(free_points(vessel), pairs, np.random.default_rng(seed))
        return cls(vessel, seed, start_px, target_px, *shortest_ways(vessel, start_px, target_px))

    def run(
        self,
        policy: Policy,
        mode: Mode = "greedy",
        disturbance: Disturbance | None = None,
        max_steps: int = MAX_STEPS,
        trace: Trace | None = None,
    ) -> tuple[Evaluation, Runs]:
        """Run a policy on every pair.

        Args:
            policy: Any policy.
            mode: Greedy with direction memory, or sampled.
            disturbance: How the world differs from the published one.
            max_steps: Steps until a pair counts as failed.
            trace: Takes the positions, where they are wanted.

        Returns:
            The figures, and what every pair came to.
        """
        disturbance = disturbance or Disturbance()
        pairs = len(self.start_px)
        runs = roll_out(
            policy,
            self.vessel,
            self.start_px,
            self.target_px,
            Sampler(greedy=mode == "greedy", seed=self.seed, agents=pairs),
            disturbance,
            seed=self.seed,
            max_steps=max_steps,
            trace=trace,
        )
        shortest_px = np.maximum(self.shortest_px - ARRIVAL_PX, 1.0)
        efficiency = runs.arrived * shortest_px / np.maximum(runs.path_px, shortest_px)
        low, high = wilson_interval(int(runs.arrived.sum()), pairs)
        evaluation = Evaluation(
            policy=policy.name,
            vessel=self.vessel.name,
            mode=mode,
            pairs=pairs,
            seed=self.seed,
            success=float(runs.arrived.mean()),
            success_low=low,
            success_high=high,
            spl=float(efficiency.mean()),
            wall_hits=float(runs.hits.mean()),
            steps=_mean(runs.steps[runs.arrived].astype(np.float64)),
            steps_ratio=_mean(runs.steps[runs.arrived] / self.least_steps[runs.arrived]),
            disturbance=disturbance,
        )
        return evaluation, runs


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
    return Task.draw(vessel, pairs, seed).run(policy, mode, max_steps=max_steps)[0]


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


def _mean(values: FloatArray) -> float:
    return float(values.mean()) if values.size else float("nan")
