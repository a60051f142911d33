"""What a policy lives through between two updates, and the advantages that follow from it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from mrnav_server.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from mrnav_server.core.navigation import ACTIONS
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.batch import BatchEnvironment, BatchStep
from mrnav_server.training.network import Critic, PolicyNetwork
from mrnav_server.training.presets import LearnerSettings


def advantages(
    rewards: Float32Array,
    values: Float32Array,
    terminated: BoolArray,
    truncated: BoolArray,
    next_values: Float32Array,
    discount: float,
    trace_decay: float,
) -> Float32Array:
    """Return generalised advantage estimates; with ``trace_decay`` 1, n-step returns less the values.

    Args:
        rewards: Shape (t, n).
        values: Of the states before each step, shape (t, n).
        terminated: Whether the episode ended for good, shape (t, n).
        truncated: Whether it was cut off, shape (t, n).
        next_values: Of the states after each step and before any reset, shape (t, n); a truncated episode is
            bootstrapped from it, a terminated one is not.
        discount: γ.
        trace_decay: λ.

    Returns:
        Shape (t, n).

    Source: Schulman et al. 2016, equation 16.
    """
    ended = terminated | truncated
    surprise = rewards + discount * next_values * ~terminated - values
    estimate = np.zeros_like(rewards)
    carried = np.zeros_like(rewards[0])
    for t in reversed(range(len(rewards))):
        carried = surprise[t] + discount * trace_decay * carried * ~ended[t]
        estimate[t] = carried
    return estimate


@dataclass(frozen=True, slots=True)
class Episodes:
    """Episodes that ended, in order.

    Attributes:
        rewards: Sum of the published rewards of each, shape (n,).
        steps: Length of each, shape (n,).
        arrived: Whether each reached its target, shape (n,).
        ended_after: Steps of all environments together from the iteration's begin to its end, shape (n,).
    """

    rewards: FloatArray
    steps: IntArray
    arrived: BoolArray
    ended_after: IntArray

    @property
    def success(self) -> float | None:
        """Share that arrived; None without any episode."""
        return float(self.arrived.mean()) if len(self.arrived) else None


@dataclass(frozen=True, slots=True)
class Samples:
    """Samples of one iteration, flattened to (t * n, ...), and what happened meanwhile."""

    features: Tensor
    allowed: Tensor
    actions: Tensor
    log_probability: Tensor
    advantage: Tensor
    value_target: Tensor
    episodes: Episodes
    reward: float


class Collector:
    """Runs a policy in many environments at once and keeps what learning needs.

    Args:
        policy: The policy network.
        critic: The critic.
        vessel: The vessel model.
        settings: Of the learner.
        seed: Of the environments; the draws of PyTorch are seeded by the caller.
    """

    def __init__(
        self, policy: PolicyNetwork, critic: Critic, vessel: VesselMap, settings: LearnerSettings, seed: int
    ) -> None:
        self._policy, self._critic, self._settings = policy, critic, settings
        self.environment = BatchEnvironment(vessel, settings.environments, seed, settings.max_steps)
        self._returns = np.zeros(settings.environments)
        self._lengths: IntArray = np.zeros(settings.environments, dtype=np.int64)
        t, n = settings.horizon, settings.environments
        self._features = torch.empty(t, n, policy.features.width)
        self._allowed = torch.ones(t, n, len(ACTIONS), dtype=torch.bool)
        self._actions = torch.empty(t, n, dtype=torch.long)
        self._log_probability = torch.empty(t, n)
        self._reward, self._value, self._after = (np.zeros((t, n), np.float32) for _ in range(3))
        self._terminated, self._truncated = np.zeros((t, n), bool), np.zeros((t, n), bool)

    @torch.no_grad()
    def collect(self) -> Samples:
        """Run every environment for the horizon; the samples are overwritten by the next call."""
        s = self._settings
        ended: list[Episodes] = []
        for t in range(s.horizon):
            seen = torch.from_numpy(self.environment.observations())
            self._choose(t, seen)
            outcome = self.environment.step(self._actions[t].numpy())
            self._reward[t] = outcome.reward
            self._terminated[t], self._truncated[t] = outcome.terminated, outcome.truncated
            self._after[t] = self._values(outcome.final) if outcome.truncated.any() else 0.0
            ended.append(self._count(outcome, (t + 1) * s.environments))
        follows = np.concatenate([self._value[1:], self._values(self.environment.observations())[None]])
        advantage = advantages(
            self._reward * np.float32(s.reward_scale),
            self._value,
            self._terminated,
            self._truncated,
            np.where(self._truncated, self._after, follows),
            s.discount,
            s.trace_decay,
        )
        episodes = Episodes(
            np.concatenate([one.rewards for one in ended]),
            np.concatenate([one.steps for one in ended]),
            np.concatenate([one.arrived for one in ended]),
            np.concatenate([one.ended_after for one in ended]),
        )
        return Samples(
            self._features.flatten(0, 1),
            self._allowed.flatten(0, 1),
            self._actions.flatten(),
            self._log_probability.flatten(),
            torch.from_numpy(advantage).flatten(),
            torch.from_numpy(advantage + self._value).flatten(),
            episodes,
            float(self._reward.mean()),
        )

    def state(self) -> dict[str, Any]:
        """Return all that `restore` needs to go on as if never interrupted."""
        counted = {"returns": self._returns.copy(), "lengths": self._lengths.copy()}
        return {"environment": self.environment.state(), **counted}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state."""
        self.environment.restore(state["environment"])
        self._returns[:], self._lengths[:] = state["returns"], state["lengths"]

    def _choose(self, t: int, seen: Tensor) -> None:
        """Draw the actions of a step and keep what the policy and the critic said."""
        features = self._features[t]
        features.copy_(self._policy.features(seen))
        logits = self._policy.head(features)
        if self._policy.masked:
            self._allowed[t] = self._policy.allowed(seen)
            logits = torch.where(self._allowed[t], logits, self._policy.forbidden)
        log_probabilities = logits.log_softmax(1)
        # The largest of logits plus Gumbel noise is a draw from their distribution.
        noise = torch.empty_like(logits).exponential_().log_()
        self._actions[t] = (log_probabilities - noise).argmax(1)
        chosen = log_probabilities.gather(1, self._actions[t].unsqueeze(1))
        self._log_probability[t] = chosen.squeeze(1)
        self._value[t] = self._critic(features).numpy()

    def _count(self, outcome: BatchStep, after: int) -> Episodes:
        """Add a step to the running episodes; return those that it ended."""
        self._returns += outcome.reward
        self._lengths += 1
        ended = outcome.terminated | outcome.truncated
        when = np.full(int(ended.sum()), after)
        episodes = Episodes(self._returns[ended], self._lengths[ended], outcome.terminated[ended], when)
        self._returns[ended], self._lengths[ended] = 0.0, 0
        return episodes

    def _values(self, observations: Float32Array) -> Float32Array:
        values: Float32Array = self._critic(self._policy.features(torch.from_numpy(observations))).numpy()
        return values
