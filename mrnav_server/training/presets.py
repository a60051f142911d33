"""The training recipes that can be chosen by name, and how any of their numbers is changed."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, TypeVar, get_args, get_type_hints

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.navigation import MAX_STEPS
from mrnav_server.training.network import Encoding

Algorithm = Literal["ppo", "a2c"]
Settings = TypeVar("Settings", bound=Any)


def _require(settings: Any, name: str, low: float, high: float = float("inf")) -> None:  # noqa: ANN401
    value = getattr(settings, name)
    if not low <= value <= high or value == float("inf"):
        upper = f" and at most {high:g}" if high < float("inf") else ""
        raise ConfigError(f"{name} must be at least {low:g}{upper}, not {value:g}")


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
    updates: int = 10_000
    batch: int = 1024
    learning_rate: float = 2e-3

    def __post_init__(self) -> None:
        _require(self, "labels", 0)
        for name in ("updates", "batch"):
            _require(self, name, 1)
        _require(self, "learning_rate", 0.0)


@dataclass(frozen=True)
class LearnerSettings:
    """What PPO and A2C have in common.

    Attributes:
        steps: Environment steps in all; 0 skips reinforcement learning.
        environments: Environments that run at once.
        horizon: Steps of each between updates.
        learning_rate: Falls to zero.
        discount: γ per step. At 0.99 standing still is the optimum on long ways; it takes 0.998 or more.
        trace_decay: λ of the advantage estimate; 1 gives n-step returns.
        entropy: Weight of the entropy bonus.
        value: Weight of the critic's loss.
        reward_scale: Multiplies the reward before learning.
        gradient_norm: Gradients are clipped to this.
        normalise: Whether advantages are brought to mean 0 and deviation 1 before each gradient step.
        critic_updates: First iterations in which the critic alone learns.
        max_steps: Steps until an episode is truncated, in training.
    """

    steps: int = 1_500_000
    environments: int = 512
    horizon: int = 64
    learning_rate: float = 1e-4
    discount: float = 0.999
    trace_decay: float = 0.95
    entropy: float = 0.001
    value: float = 0.5
    reward_scale: float = 0.002
    gradient_norm: float = 0.5
    normalise: bool = True
    critic_updates: int = 12
    max_steps: int = MAX_STEPS

    def __post_init__(self) -> None:
        for name in ("steps", "critic_updates"):
            _require(self, name, 0)
        for name in ("environments", "horizon", "max_steps"):
            _require(self, name, 1)
        for name in ("learning_rate", "entropy", "value", "reward_scale", "gradient_norm"):
            _require(self, name, 0.0)
        for name in ("discount", "trace_decay"):
            _require(self, name, 0.0, 1.0)


@dataclass(frozen=True)
class PpoSettings(LearnerSettings):
    """Proximal policy optimisation.

    Attributes:
        minibatch: Samples per gradient step.
        epochs: Passes over the samples.
        clip: Bound on the change of an action's probability ratio.
    """

    minibatch: int = 4096
    epochs: int = 3
    clip: float = 0.2

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("minibatch", "epochs"):
            _require(self, name, 1)
        _require(self, "clip", 0.0)


@dataclass(frozen=True)
class A2cSettings(LearnerSettings):
    """Advantage actor-critic: one gradient step of RMSprop per roll-out.

    Attributes:
        rms_decay: How slowly RMSprop's average of squared gradients forgets.
    """

    horizon: int = 8
    trace_decay: float = 1.0
    critic_updates: int = 150
    rms_decay: float = 0.99

    def __post_init__(self) -> None:
        super().__post_init__()
        _require(self, "rms_decay", 0.0, 1.0)


@dataclass(frozen=True)
class Preset:
    """A recipe; each runs with either algorithm.

    Attributes:
        name: As given to ``mrnav train --preset``.
        what: What the result is, in one sentence, for the model card; ``{algorithm}`` is filled in.
        encoding: See `training.network.Features`.
        hidden: Width of the two hidden layers.
        masked: Whether the wall is inside the policy.
        margin_px: Gap to the wall that the policy keeps where it can; keep it under 10.
        cloning: Cloning before reinforcement learning.
        ppo: Reinforcement learning by PPO.
        a2c: Reinforcement learning by A2C.
    """

    name: str
    what: str
    encoding: Encoding = "fourier"
    hidden: int = 128
    masked: bool = True
    margin_px: float = 5.0
    cloning: CloningSettings = field(default_factory=CloningSettings)
    ppo: PpoSettings = field(default_factory=PpoSettings)
    a2c: A2cSettings = field(default_factory=A2cSettings)

    def __post_init__(self) -> None:
        _require(self, "hidden", 1)
        _require(self, "margin_px", 0.0)

    def learner(self, algorithm: Algorithm) -> PpoSettings | A2cSettings:
        """Return the settings of one algorithm."""
        return self.ppo if algorithm == "ppo" else self.a2c


_NO_CLONING = CloningSettings(labels=0)

PRESETS = {
    preset.name: preset
    for preset in (
        Preset("best", "a distilled shortest-path planner, refined by {algorithm} on the published reward"),
        Preset(
            "paper+",
            "pure {algorithm} on the published reward, with Fourier features, the wall inside and"
            " discount 0.999",
            cloning=_NO_CLONING,
            ppo=PpoSettings(
                steps=4_000_000, learning_rate=5e-4, entropy=0.005, critic_updates=0, max_steps=2000
            ),
            a2c=A2cSettings(
                steps=4_000_000,
                learning_rate=1e-3,
                trace_decay=0.95,
                entropy=0.005,
                critic_updates=0,
                max_steps=2000,
            ),
        ),
        Preset(
            "paper",
            "{algorithm} as published: six raw numbers, 64 x 64 tanh, discount 0.99",
            encoding="raw",
            hidden=64,
            masked=False,
            cloning=_NO_CLONING,
            # Minibatches of 8192 and a rate of 3e-4 leave it close to a random walk after as many steps.
            ppo=PpoSettings(
                steps=10_000_000,
                environments=1024,
                minibatch=1024,
                epochs=4,
                learning_rate=1e-3,
                discount=0.99,
                entropy=0.01,
                reward_scale=0.01,
                critic_updates=0,
            ),
            a2c=A2cSettings(
                steps=10_000_000,
                environments=256,
                learning_rate=7e-4,
                discount=0.99,
                entropy=0.01,
                reward_scale=0.01,
                critic_updates=0,
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


def adjust(preset: Preset, algorithm: Algorithm, assignments: Sequence[str]) -> Preset:
    """Change hyper-parameters.

    Args:
        preset: The recipe.
        algorithm: The one whose settings are meant.
        assignments: Each ``name=value``. The algorithm's and the network's settings go by their own names,
            those of cloning as ``cloning.NAME``.

    Raises:
        ConfigError: If a name is unknown (the message lists all), or a value is of the wrong kind or range.
    """
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        if not equals:
            raise ConfigError(f"--set {assignment!r}: write name=value")
        group, short = ("cloning", name[8:]) if name.startswith("cloning.") else (algorithm, name)
        settings = getattr(preset, group)
        if group == algorithm and short in _NETWORK:
            preset = _with(preset, short, text)
        elif short in _names(settings):
            preset = replace(preset, **{group: _with(settings, short, text)})
        else:
            known = [*_NETWORK, *_names(preset.learner(algorithm))]
            known += [f"cloning.{label}" for label in _names(preset.cloning)]
            raise ConfigError(f"--set {name}: no such setting of {algorithm}; there are {', '.join(known)}")
    return preset


def preset_from(record: dict[str, Any]) -> Preset:
    """Return the preset that ``dataclasses.asdict`` turned into a record."""
    parts = {"cloning": CloningSettings, "ppo": PpoSettings, "a2c": A2cSettings}
    return Preset(**{key: parts[key](**value) if key in parts else value for key, value in record.items()})


_NETWORK = ("encoding", "hidden", "masked", "margin_px")


def _names(settings: Any) -> list[str]:  # noqa: ANN401 (any dataclass)
    return [entry.name for entry in fields(settings)]


def _with(settings: Settings, name: str, text: str) -> Settings:
    """Return the settings with one field read from text."""
    kind = get_type_hints(type(settings))[name]
    choices = get_args(kind) or (("true", "false") if kind is bool else ())
    if choices and text not in choices:
        raise ConfigError(f"--set {name}: {text!r} is not one of {', '.join(choices)}")
    value: Any = text == "true" if kind is bool else text
    if not choices:
        try:
            value = kind(text.replace("_", "") if kind is int else text)
        except ValueError:
            wanted = "a whole number" if kind is int else "a number"
            raise ConfigError(f"--set {name}: {text!r} is not {wanted}") from None
    changed: Settings = replace(settings, **{name: value})
    return changed
