"""Reinforcement learning from first to last iteration, with either algorithm."""

from collections.abc import Callable
from typing import Any

from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.a2c import A2c
from mrnav_server.training.experience import Collector, Episodes
from mrnav_server.training.network import Critic, PolicyNetwork
from mrnav_server.training.ppo import Ppo
from mrnav_server.training.presets import A2cSettings, PpoSettings
from mrnav_server.training.progress import Report

RECENT_EPISODES = 100
"""The success rate that is reported is over at least so many of the newest episodes."""


class Learner:
    """Improves a policy network in place.

    Args:
        policy: The network.
        vessel: The vessel model.
        settings: All hyper-parameters; their kind decides the algorithm.
        hidden: Width of the critic's hidden layers.
        seed: Of the environments; the draws of PyTorch are seeded by the caller.

    Attributes:
        iteration: How many are done.
        iterations: How many there are.
        per_iteration: Environment steps in each.
    """

    def __init__(
        self,
        policy: PolicyNetwork,
        vessel: VesselMap,
        settings: PpoSettings | A2cSettings,
        hidden: int,
        seed: int,
    ) -> None:
        self.critic = Critic(policy.features.width, hidden, tanh=policy.features.raw)
        self.collector = Collector(policy, self.critic, vessel, settings, seed)
        self.algorithm = (
            Ppo(policy, self.critic, settings)
            if isinstance(settings, PpoSettings)
            else A2c(policy, self.critic, settings)
        )
        self.iteration = 0
        self._settings = settings
        self.per_iteration = settings.environments * settings.horizon
        self.iterations = max(1, round(settings.steps / self.per_iteration)) if settings.steps else 0
        self._recent: list[tuple[int, int]] = []

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return self.iteration * self.per_iteration

    def learn(self, tell: Callable[[Report, Episodes], None]) -> None:
        """Run the iterations that are left, telling after each how it went."""
        while self.iteration < self.iterations:
            s = self._settings
            for group in self.algorithm.optimizer.param_groups:
                group["lr"] = s.learning_rate * (1 - self.iteration / self.iterations)
            samples = self.collector.collect()
            loss = self.algorithm.update(samples, critic_only=self.iteration < s.critic_updates)
            self.iteration += 1
            done = self.iteration / self.iterations
            success = self._success(samples.episodes)
            tell(Report("reinforce", done, self.steps, success, samples.reward, loss), samples.episodes)

    def state(self) -> dict[str, Any]:
        """Return all that `restore` needs to go on as if never interrupted."""
        return {
            "iteration": self.iteration,
            "recent": self._recent,
            "critic": self.critic.state_dict(),
            "optimizer": self.algorithm.optimizer.state_dict(),
            "collector": self.collector.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state."""
        self.iteration = state["iteration"]
        self._recent = [(int(ended), int(arrived)) for ended, arrived in state["recent"]]
        self.critic.load_state_dict(state["critic"])
        self.algorithm.optimizer.load_state_dict(state["optimizer"])
        self.collector.restore(state["collector"])

    def _success(self, episodes: Episodes) -> float | None:
        """Return the share of the newest episodes that arrived; None before any ended."""
        if len(episodes.arrived):
            self._recent.append((len(episodes.arrived), int(episodes.arrived.sum())))
        while sum(ended for ended, _ in self._recent[1:]) >= RECENT_EPISODES:
            del self._recent[0]
        ended = sum(ended for ended, _ in self._recent)
        return sum(arrived for _, arrived in self._recent) / ended if ended else None
