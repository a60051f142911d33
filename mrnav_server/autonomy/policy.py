"""What a policy is, how an action is drawn from it, and the shield before the wall."""

from typing import Protocol

import numpy as np

from mrnav_server.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.navigation import DIRECTIONS, free_actions
from mrnav_server.core.vessel import VesselMap

FORBIDDEN_LOGIT = np.float32(-1e9)
"""Finite stand-in for a probability of zero."""


class PolicyError(ConfigError):
    """A policy is missing, altered, or made for another vessel. Reaction: autonomy is refused, saying why."""


class Policy(Protocol):
    """Anything that scores the 40 actions."""

    @property
    def name(self) -> str:
        """Return the policy's name, for people and logs."""

    @property
    def kind(self) -> str:
        """Return ``"torchscript"`` or ``"geodesic"``."""

    def logits(self, observations: Float32Array) -> Float32Array:
        """Score the actions.

        Args:
            observations: As `core.navigation.observation`, shape (n, 6), float32, in grid pixels.

        Returns:
            Unnormalised log-probabilities, shape (n, 40), float32.
        """


class Sampler:
    """Turns logits into actions for n agents that act in step.

    Greedy takes the best action that does not turn back against a running average of past directions:
    without that memory, two equally good routes make a deterministic agent dither for ever. An agent that
    sees itself late may circle its target for ever, too; one that has turned round and round therefore
    wanders for a while, over all allowed actions alike. The other mode always draws from the
    categorical distribution, as the published system does.

    Args:
        greedy: Best action with direction memory, or a draw.
        seed: Of what is drawn.
        agents: How many agents act in step.
    """

    memory_share = 0.7
    turn_back_cos = -0.1
    turned_share = 0.99
    circling_rad = 4.0 * np.pi
    """An agent circles that has turned by this much lately, with what is long ago forgotten."""
    wander_steps = 24

    def __init__(self, *, greedy: bool, seed: int = 0, agents: int = 1) -> None:
        self.greedy = greedy
        self._random = np.random.default_rng(seed)
        self._heading: FloatArray = np.zeros((agents, 2))
        self._before: IntArray = np.full(agents, -1)
        self._turned_rad: FloatArray = np.zeros(agents)
        self._wanders: IntArray = np.zeros(agents, np.int64)

    def choose(self, logits: Float32Array) -> IntArray:
        """Return an action index for every agent: shape (n, 40) to shape (n,), int64."""
        if not self.greedy:
            return self._drawn(logits)
        actions = np.asarray(np.where(self._ahead(logits), logits, -np.inf).argmax(axis=1))
        wandering = self._wanders > 0
        if wandering.any():
            allowed = np.where(logits[wandering] > FORBIDDEN_LOGIT / 2, np.float32(0.0), FORBIDDEN_LOGIT)
            actions[wandering] = self._drawn(allowed)
        self._remember(actions)
        return actions

    @property
    def memory(self) -> FloatArray:
        """What greedy choices depend on beside the logits, shape (n, 5).

        The average of the past directions, the last action, how far the agent has turned lately, in rad, and
        for how many steps it still wanders.
        """
        return np.column_stack([self._heading, self._before, self._turned_rad, self._wanders])

    def keep(self, agents: BoolArray) -> None:
        """Drop the agents for which the mask, shape (n,), is False."""
        self._heading = self._heading[agents]
        self._before, self._turned_rad = self._before[agents], self._turned_rad[agents]
        self._wanders = self._wanders[agents]

    def _drawn(self, logits: Float32Array) -> IntArray:
        return np.asarray((logits + self._random.gumbel(size=logits.shape)).argmax(axis=1))

    def _remember(self, actions: IntArray) -> None:
        now, before = DIRECTIONS[actions], DIRECTIONS[self._before]
        cross = before[:, 0] * now[:, 1] - before[:, 1] * now[:, 0]
        turn_rad = np.where(self._before < 0, 0.0, np.arctan2(cross, (before * now).sum(axis=1)))
        self._turned_rad = self.turned_share * self._turned_rad + turn_rad
        self._wanders = np.maximum(self._wanders - 1, 0)
        circling = np.abs(self._turned_rad) > self.circling_rad
        self._wanders[circling], self._turned_rad[circling] = self.wander_steps, 0.0
        self._before = actions
        self._heading = self.memory_share * self._heading + (1 - self.memory_share) * now

    def _ahead(self, logits: Float32Array) -> BoolArray:
        """Return the allowed actions that do not turn back; all allowed ones where there is none."""
        length = np.hypot(self._heading[:, 0], self._heading[:, 1])[:, None]
        allowed = logits > FORBIDDEN_LOGIT / 2
        ahead = allowed & (self._heading @ DIRECTIONS.T >= self.turn_back_cos * length)
        return np.where(
            ahead.any(axis=1, keepdims=True), ahead, allowed | ~allowed.any(axis=1, keepdims=True)
        )


def shield(vessel: VesselMap, positions_px: FloatArray, logits: Float32Array) -> Float32Array:
    """Forbid the actions that would enter the wall.

    Args:
        vessel: The vessel model.
        positions_px: Shape (n, 2).
        logits: Shape (n, 40).

    Returns:
        The logits with `FORBIDDEN_LOGIT` at blocked actions, shape (n, 40). Where the policy itself forbids
        every free action, all free ones are allowed; an agent without any keeps the policy's answer.
    """
    free = free_actions(vessel.free, positions_px)
    allowed = free & (logits > FORBIDDEN_LOGIT / 2)
    allowed = np.where(allowed.any(axis=1, keepdims=True), allowed, free)
    allowed |= ~free.any(axis=1, keepdims=True)
    return np.where(allowed, np.maximum(logits, FORBIDDEN_LOGIT / 4), FORBIDDEN_LOGIT).astype(np.float32)
