"""Proximal policy optimisation: several passes over the samples, with a clipped change of the policy.

Source: Schulman et al. 2017, equation 7.
"""

import torch
from torch import Tensor, nn

from mrnav_server.training.experience import Samples
from mrnav_server.training.network import Critic, PolicyNetwork
from mrnav_server.training.presets import PpoSettings


class Ppo:
    """Improves a policy and its critic in place.

    Args:
        policy: The policy network.
        critic: The critic.
        settings: All hyper-parameters.
    """

    def __init__(self, policy: PolicyNetwork, critic: Critic, settings: PpoSettings) -> None:
        self._policy, self._critic, self._settings = policy, critic, settings
        self._parameters = [*policy.head.parameters(), *critic.parameters()]
        self.optimizer: torch.optim.Optimizer = torch.optim.Adam(
            self._parameters, lr=settings.learning_rate, eps=1e-5, fused=True
        )

    def update(self, samples: Samples, *, critic_only: bool) -> float:
        """Learn from one roll-out; return the last loss."""
        s = self._settings
        loss = torch.zeros(())
        for _ in range(s.epochs):
            for chosen in torch.split(torch.randperm(len(samples.actions)), s.minibatch):
                features = samples.features.index_select(0, chosen)
                error = self._critic(features) - samples.value_target[chosen]
                loss = s.value * 0.5 * error.square().mean()
                if not critic_only:
                    loss = loss + self._policy_loss(samples, features, chosen)
                self.optimizer.zero_grad(set_to_none=True)
                loss.backward()
                nn.utils.clip_grad_norm_(self._parameters, s.gradient_norm)
                self.optimizer.step()
        return float(loss.item())

    def _policy_loss(self, samples: Samples, features: Tensor, chosen: Tensor) -> Tensor:
        """Return the clipped surrogate loss with its entropy bonus."""
        s = self._settings
        logits = self._policy.head(features)
        if self._policy.masked:
            allowed = samples.allowed.index_select(0, chosen)
            logits = torch.where(allowed, logits, self._policy.forbidden)
        log_probabilities: Tensor = logits.log_softmax(1)
        now = log_probabilities.gather(1, samples.actions[chosen].unsqueeze(1)).squeeze(1)
        ratio = (now - samples.log_probability[chosen]).exp()
        advantage = samples.advantage[chosen]
        if s.normalise:
            advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        bounded = ratio.clamp(1 - s.clip, 1 + s.clip)
        surrogate: Tensor = torch.min(ratio * advantage, bounded * advantage).mean()
        entropy: Tensor = -(log_probabilities.exp() * log_probabilities.clamp(min=-50)).sum(1).mean()
        return -surrogate - s.entropy * entropy
