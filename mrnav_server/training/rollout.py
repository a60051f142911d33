"""Runs a policy from many starts to many targets at once, under the published rules or worse ones."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from mrnav_server.autonomy.policy import Policy, Sampler
from mrnav_server.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from mrnav_server.core.navigation import (
    ACTIONS,
    ARRIVAL_PX,
    MAX_STEPS,
    STEP_PX,
    is_free,
    observation,
)
from mrnav_server.core.vessel import VesselMap


@dataclass(frozen=True, slots=True)
class Disturbance:
    """How the world differs from the one that the policy was trained in.

    Attributes:
        noise_px: Standard deviation of the seen position, x and y, new at every step, in grid pixels.
        delay_steps: The policy sees the position of so many steps ago.
        scale: A move is so many times as long as it should be.
    """

    noise_px: float = 0.0
    delay_steps: int = 0
    scale: float = 1.0

    @property
    def none(self) -> bool:
        """Whether this is the published world."""
        return self == Disturbance()

    def __str__(self) -> str:
        """Return it in words."""
        words = [
            f"noise {self.noise_px:g} px" if self.noise_px else "",
            f"delay {self.delay_steps} steps" if self.delay_steps else "",
            f"scale {self.scale:g}" if self.scale != 1.0 else "",
        ]
        return ", ".join(filter(None, words)) or "plain"


@dataclass(frozen=True, slots=True)
class Runs:
    """What every pair came to, shape (n,) each.

    Attributes:
        arrived: Whether the target was reached.
        path_px: Length of the way driven.
        hits: Moves that would have entered the wall.
        steps: Steps taken.
        end_px: Where the agent was last, shape (n, 2).
    """

    arrived: BoolArray
    path_px: FloatArray
    hits: IntArray
    steps: IntArray
    end_px: FloatArray


class Trace:
    """Positions of every agent at every so many steps, for pictures.

    Args:
        every: How many.
    """

    def __init__(self, every: int = 8) -> None:
        self.every = every
        self._kept: list[tuple[IntArray, Float32Array]] = []

    def add(self, agents: IntArray, position_px: FloatArray) -> None:
        """Keep the positions, shape (m, 2), of the agents with these numbers, shape (m,)."""
        self._kept.append((agents, position_px.astype(np.float32)))

    def of(self, agent: int) -> Float32Array:
        """Return one agent's positions in the order of time, shape (k, 2)."""
        rows: list[Float32Array] = []
        for agents, position_px in self._kept:
            at = int(np.searchsorted(agents, agent))
            if at == len(agents) or agents[at] != agent:
                break
            rows.append(position_px[at])
        return np.array(rows, dtype=np.float32).reshape(-1, 2)


def roll_out(
    policy: Policy,
    vessel: VesselMap,
    start_px: FloatArray,
    target_px: FloatArray,
    sampler: Sampler,
    disturbance: Disturbance,
    *,
    seed: int = 0,
    max_steps: int = MAX_STEPS,
    trace: Trace | None = None,
) -> Runs:
    """Drive every pair until it arrives or its steps run out.

    Agents that arrived leave the batch. An undisturbed greedy agent that comes back to a position with the
    same memory repeats itself for ever: it leaves the batch too, and what it would go on to do
    is counted.

    Args:
        policy: Any policy.
        vessel: The vessel model.
        start_px: Shape (n, 2).
        target_px: Shape (n, 2).
        sampler: For n agents.
        disturbance: How the world differs.
        seed: Of the noise.
        max_steps: Steps until a pair counts as failed.
        trace: Takes the positions, where they are wanted.
    """
    count = len(start_px)
    path_px, end_px = np.zeros(count), start_px.copy()
    hits, steps = np.zeros(count, np.int64), np.zeros(count, np.int64)
    arrived = np.zeros(count, bool)
    random = np.random.default_rng([seed, 1])
    going, position = np.arange(count), start_px.copy()
    past = deque([position], maxlen=disturbance.delay_steps + 1)
    loops = _Loops(sampler, count) if sampler.greedy and disturbance.none else None
    for number in range(max_steps):
        if trace is not None and number % trace.every == 0:
            trace.add(going, position)
        seen = past[0]
        if disturbance.noise_px:
            seen = seen + random.normal(0.0, disturbance.noise_px, seen.shape)
        actions = sampler.choose(policy.logits(observation(seen, start_px[going], target_px[going])))
        wanted = position + disturbance.scale * ACTIONS[actions]
        hit = ~is_free(vessel.free, wanted)
        position = np.where(hit[:, None], position, wanted)
        past.append(position)
        path_px[going] += np.where(hit, 0.0, disturbance.scale * STEP_PX[actions])
        hits[going] += hit
        steps[going] += 1
        there = ((position - target_px[going]) ** 2).sum(axis=1) < ARRIVAL_PX**2
        arrived[going] = there
        on = ~there
        if loops is not None:
            looping, more_hits = loops.find(number + 1, position, hits[going], max_steps)
            on &= ~looping
            lost = going[looping & ~there]
            hits[lost] += more_hits[looping & ~there]
            steps[lost] = max_steps
        if not on.all():
            end_px[going] = position
            going, position = going[on], position[on]
            past = deque((each[on] for each in past), maxlen=past.maxlen)
            sampler.keep(on)
            if loops is not None:
                loops.keep(on)
        if not going.size:
            break
    end_px[going] = position
    return Runs(arrived, path_px, hits, steps, end_px)


class _Loops:
    """Finds agents that repeat themselves (Brent: a checkpoint at every power of two)."""

    def __init__(self, sampler: Sampler, count: int) -> None:
        self._sampler = sampler
        self._position = np.full((count, 2), np.nan)
        self._memory = np.full((count, 5), np.nan)
        self._hits: IntArray = np.zeros(count, np.int64)
        self._at = 0

    def find(
        self, number: int, position: FloatArray, hits: IntArray, max_steps: int
    ) -> tuple[BoolArray, IntArray]:
        """Return who is back at the checkpoint's state, and the hits still to come, shape (m,) each."""
        memory = self._sampler.memory
        back = (position == self._position).all(axis=1) & (memory == self._memory).all(axis=1)
        to_come = (hits - self._hits) * (max_steps - number) // max(number - self._at, 1)
        if number >= 2 * self._at:
            self._position, self._memory, self._hits, self._at = position, memory, hits, number
        return back, to_come

    def keep(self, agents: BoolArray) -> None:
        """Drop the agents for which the mask, shape (m,), is False."""
        self._position, self._memory = self._position[agents], self._memory[agents]
        self._hits = self._hits[agents]
