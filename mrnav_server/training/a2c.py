"""Advantage actor-critic: one gradient step per roll-out, along the plain policy gradient.

Source: Mnih et al. 2016, algorithm S3, with all actors in step.
"""

import torch
from torch import Tensor, nn

from mrnav_server.training.experience import Samples
from mrnav_server.training.network import Critic, PolicyNetwork
from mrnav_server.training.presets import A2cSettings


class A2c:
    """Improves a policy and its critic in place.

    Args:
        policy: The policy network.
        critic: The critic.
        settings: All hyper-parameters.
    """

    def __init__(self, policy: PolicyNetwork, critic: Critic, settings: A2cSettings) -> None:
        self._policy, self._critic, self._settings = policy, critic, settings
        self._parameters = [*policy.head.parameters(), *critic.parameters()]
        self.optimizer: torch.optim.Optimizer = torch.optim.RMSprop(
            self._parameters, lr=settings.learning_rate, alpha=settings.rms_decay, eps=1e-5
        )

    def update(self, samples: Samples, *, critic_only: bool) -> float:
        """Learn from one roll-out; return the loss."""
        s = self._settings
        error = self._critic(samples.features) - samples.value_target
        loss = s.value * 0.5 * error.square().mean()
        if not critic_only:
            loss = loss + self._policy_loss(samples)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self._parameters, s.gradient_norm)
        self.optimizer.step()
        return float(loss.item())

    def _policy_loss(self, samples: Samples) -> Tensor:
        """Return the policy-gradient loss with its entropy bonus."""
        s = self._settings
        logits = self._policy.head(samples.features)
        if self._policy.masked:
            logits = torch.where(samples.allowed, logits, self._policy.forbidden)
        log_probabilities: Tensor = logits.log_softmax(1)
        taken = log_probabilities.gather(1, samples.actions.unsqueeze(1)).squeeze(1)
        advantage = samples.advantage
        if s.normalise:
            advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        entropy: Tensor = -(log_probabilities.exp() * log_probabilities.clamp(min=-50)).sum(1).mean()
        return -(taken * advantage).mean() - s.entropy * entropy
