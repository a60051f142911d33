"""Proximal policy optimisation on the published reward, in one readable file.

With one epoch over one minibatch the ratio is 1 everywhere and the clip idle: then this is A2C.

Source: Schulman et al. 2017 (PPO), Schulman et al. 2016 (generalised advantage estimation), Huang et al. 2022
(A2C as a special case of PPO).
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from mrnav_server.core.arrays import BoolArray, Float32Array
from mrnav_server.core.navigation import ACTIONS
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.batch import BatchEnvironment
from mrnav_server.training.network import Critic, PolicyNetwork
from mrnav_server.training.presets import PpoSettings
from mrnav_server.training.progress import Progress, Report


def advantages(
    rewards: Float32Array,
    values: Float32Array,
    terminated: BoolArray,
    truncated: BoolArray,
    next_values: Float32Array,
    discount: float,
    trace_decay: float,
) -> Float32Array:
    """Return generalised advantage estimates.

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
class Rollout:
    """Samples of one iteration, flattened to (t * n, ...), and its statistics."""

    features: Tensor
    forbidden: Tensor
    actions: Tensor
    log_probability: Tensor
    advantage: Tensor
    value_target: Tensor
    episodes: int
    arrivals: int
    reward: float


class PpoLearner:
    """Improves a policy network in place.

    Args:
        policy: The network.
        vessel: The vessel model.
        settings: All hyper-parameters.
        hidden: Width of the critic's hidden layers.
        seed: Of the environments; the draws of PyTorch are seeded by the caller.
    """

    def __init__(
        self, policy: PolicyNetwork, vessel: VesselMap, settings: PpoSettings, hidden: int, seed: int
    ) -> None:
        self.settings = settings
        self.policy = policy
        self.critic = Critic(policy.features.width, hidden, tanh=policy.features.raw)
        self.environment = BatchEnvironment(vessel, settings.environments, seed, settings.max_steps)
        self._parameters = [*policy.head.parameters(), *self.critic.parameters()]
        self._optimizer: torch.optim.Optimizer
        if settings.optimizer == "adam":
            self._optimizer = torch.optim.Adam(
                self._parameters, lr=settings.learning_rate, eps=1e-5, fused=True
            )
        else:
            self._optimizer = torch.optim.RMSprop(self._parameters, lr=settings.learning_rate, eps=1e-5)

    def learn(self, progress: Progress) -> int:
        """Run all steps, reporting after every iteration; return how many there were."""
        s = self.settings
        per_iteration = s.environments * s.horizon
        iterations = max(1, round(s.steps / per_iteration))
        for iteration in range(iterations):
            for group in self._optimizer.param_groups:
                group["lr"] = s.learning_rate * (1 - iteration / iterations)
            samples = self.collect()
            loss = self.update(samples, critic_only=iteration < s.critic_updates)
            success = samples.arrivals / samples.episodes if samples.episodes else None
            steps = (iteration + 1) * per_iteration
            done = (iteration + 1) / iterations
            progress(Report("reinforce", done, steps, success, samples.reward, loss))
        return iterations * per_iteration

    @torch.no_grad()
    def collect(self) -> Rollout:
        """Run every environment for the horizon with the present policy."""
        s = self.settings
        shape = (s.horizon, s.environments)
        features = torch.empty(*shape, self.policy.features.width)
        forbidden = torch.zeros(*shape, len(ACTIONS), dtype=torch.bool)
        actions = torch.empty(shape, dtype=torch.long)
        log_probability = torch.empty(shape)
        reward = np.empty(shape, np.float32)
        values, next_values = np.empty(shape, np.float32), np.empty(shape, np.float32)
        terminated, truncated = np.zeros(shape, bool), np.zeros(shape, bool)
        seen = torch.from_numpy(self.environment.observations())
        for t in range(s.horizon):
            features[t] = self.policy.features(seen)
            logits = self.policy.head(features[t])
            if self.policy.masked:
                forbidden[t] = ~self.policy.allowed(seen)
                logits = logits.masked_fill(forbidden[t], self.policy.forbidden)
            log_probabilities = logits.log_softmax(1)
            actions[t] = torch.multinomial(log_probabilities.exp(), 1).squeeze(1)
            log_probability[t] = log_probabilities.gather(1, actions[t].unsqueeze(1)).squeeze(1)
            values[t] = self.critic(features[t]).numpy()
            outcome = self.environment.step(actions[t].numpy())
            reward[t], terminated[t], truncated[t] = outcome.reward, outcome.terminated, outcome.truncated
            next_values[t] = self._value(outcome.final) if truncated[t].any() else 0.0
            seen = torch.from_numpy(self.environment.observations())
        follows = np.concatenate([values[1:], self._value(seen.numpy())[None]])
        next_values = np.where(truncated, next_values, follows)
        advantage = advantages(
            reward * s.reward_scale,
            values,
            terminated,
            truncated,
            next_values,
            s.discount,
            s.trace_decay,
        )
        return Rollout(
            features.flatten(0, 1),
            forbidden.flatten(0, 1),
            actions.flatten(),
            log_probability.flatten(),
            torch.from_numpy(advantage).flatten(),
            torch.from_numpy(advantage + values).flatten(),
            int((terminated | truncated).sum()),
            int(terminated.sum()),
            float(reward.mean()),
        )

    def update(self, samples: Rollout, *, critic_only: bool) -> float:
        """Improve policy and critic on one roll-out; return the last loss."""
        s = self.settings
        count = len(samples.actions)
        loss = torch.zeros(())
        for _ in range(s.epochs):
            for chosen in torch.split(torch.randperm(count), s.minibatch):
                value_error = self.critic(samples.features[chosen]) - samples.value_target[chosen]
                loss = s.value * 0.5 * value_error.square().mean()
                if not critic_only:
                    loss = loss + self._policy_loss(samples, chosen)
                self._optimizer.zero_grad(set_to_none=True)
                loss.backward()
                nn.utils.clip_grad_norm_(self._parameters, s.gradient_norm)
                self._optimizer.step()
        return float(loss.item())

    def _policy_loss(self, samples: Rollout, chosen: Tensor) -> Tensor:
        """Return the clipped surrogate loss with its entropy bonus."""
        s = self.settings
        logits = self.policy.head(samples.features[chosen])
        logits = logits.masked_fill(samples.forbidden[chosen], self.policy.forbidden)
        log_probabilities: Tensor = logits.log_softmax(1)
        now = log_probabilities.gather(1, samples.actions[chosen].unsqueeze(1)).squeeze(1)
        ratio = (now - samples.log_probability[chosen]).exp()
        advantage = samples.advantage[chosen]
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        surrogate: Tensor = torch.min(
            ratio * advantage, ratio.clamp(1 - s.clip, 1 + s.clip) * advantage
        ).mean()
        entropy: Tensor = -(log_probabilities.exp() * log_probabilities.clamp(min=-50)).sum(1).mean()
        return -surrogate - s.entropy * entropy

    def _value(self, observations: Float32Array) -> Float32Array:
        value: Float32Array = self.critic(self.policy.features(torch.from_numpy(observations))).numpy()
        return value
