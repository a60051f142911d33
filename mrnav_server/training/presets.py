"""The training recipes that can be chosen by name."""

from dataclasses import dataclass, field, replace
from typing import Literal

from mrnav_server.core.errors import ConfigError
from mrnav_server.training.network import Encoding


@dataclass(frozen=True)
class CloningSettings:
    """How the planner is distilled into the network.

    Attributes:
        labels: Labelled states; 0 skips cloning.
        updates: Gradient steps.
        batch: States per step.
        learning_rate: Of Adam; falls to zero.
    """

    labels: int = 400_000
    updates: int = 12_000
    batch: int = 1024
    learning_rate: float = 2e-3


@dataclass(frozen=True)
class PpoSettings:
    """Proximal policy optimisation; with one epoch over one minibatch and RMSprop it is A2C.

    Attributes:
        steps: Environment steps in all.
        environments: Environments that run at once.
        horizon: Steps of each between updates.
        minibatch: Samples per gradient step.
        epochs: Passes over the samples.
        learning_rate: Falls to zero.
        discount: γ per step. At 0.99 standing still is the optimum on long ways; it takes 0.998 or more.
        trace_decay: λ of the advantage estimate.
        clip: Bound on the change of an action's probability ratio.
        entropy: Weight of the entropy bonus.
        value: Weight of the critic's loss.
        reward_scale: Multiplies the reward before learning.
        gradient_norm: Gradients are clipped to this.
        critic_updates: First iterations in which the critic alone learns.
        max_steps: Steps until an episode is truncated, in training.
        optimizer: ``adam`` or ``rmsprop``.
    """

    steps: int = 1_500_000
    environments: int = 512
    horizon: int = 64
    minibatch: int = 4096
    epochs: int = 3
    learning_rate: float = 1e-4
    discount: float = 0.999
    trace_decay: float = 0.95
    clip: float = 0.2
    entropy: float = 0.001
    value: float = 0.5
    reward_scale: float = 0.002
    gradient_norm: float = 0.5
    critic_updates: int = 12
    max_steps: int = 20_000
    optimizer: Literal["adam", "rmsprop"] = "adam"


@dataclass(frozen=True)
class Preset:
    """A recipe.

    Attributes:
        name: As given to ``mrnav train --preset``.
        what: What the result is, in one sentence, for the model card.
        encoding: See `training.network.Features`.
        hidden: Width of the two hidden layers.
        masked: Whether the wall is inside the policy.
        margin_px: Gap to the wall that the policy keeps where it can.
        cloning: Cloning before reinforcement learning.
        ppo: Reinforcement learning.
    """

    name: str
    what: str
    encoding: Encoding = "fourier"
    hidden: int = 128
    masked: bool = True
    margin_px: float = 5.0
    cloning: CloningSettings = field(default_factory=CloningSettings)
    ppo: PpoSettings = field(default_factory=PpoSettings)


_NO_CLONING = CloningSettings(labels=0)
_FROM_SCRATCH = PpoSettings(
    steps=4_000_000, learning_rate=5e-4, entropy=0.005, critic_updates=0, max_steps=2000
)

PRESETS = {
    preset.name: preset
    for preset in (
        Preset("best", "a distilled shortest-path planner, refined by PPO on the published reward"),
        Preset(
            "paper+",
            "pure PPO on the published reward, with Fourier features, the wall inside and discount 0.999",
            cloning=_NO_CLONING,
            ppo=_FROM_SCRATCH,
        ),
        Preset(
            "paper",
            "PPO as published: six raw numbers, 64 x 64 tanh, discount 0.99",
            encoding="raw",
            hidden=64,
            masked=False,
            cloning=_NO_CLONING,
            ppo=PpoSettings(
                steps=10_000_000,
                environments=1024,
                minibatch=8192,
                epochs=4,
                learning_rate=3e-4,
                discount=0.99,
                entropy=0.01,
                reward_scale=0.01,
                critic_updates=0,
            ),
        ),
        Preset(
            "a2c",
            "pure A2C on the published reward, otherwise as paper+",
            cloning=_NO_CLONING,
            ppo=replace(
                _FROM_SCRATCH,
                horizon=8,
                minibatch=512 * 8,
                epochs=1,
                learning_rate=1e-3,
                optimizer="rmsprop",
            ),
        ),
    )
}


def find_preset(name: str) -> Preset:
    """Return a preset by name.

    Raises:
        ConfigError: If there is no such preset; the message lists those that there are.
    """
    if name not in PRESETS:
        raise ConfigError(f"no preset {name!r}; there are {', '.join(PRESETS)}")
    return PRESETS[name]
