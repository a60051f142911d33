"""What can be made to go wrong with an emulated manipulator, at its start and while it runs."""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields, replace

from mrnav_server.core.errors import ConfigError

AXES = "xyzw"
_LONGEST_MS = 10_000.0


@dataclass(frozen=True, slots=True)
class Faults:
    """The knobs of one device. Without any, it is sound.

    Attributes:
        drop_acks: How many of the next requests are carried out but not answered; counts down.
        drop_requests: How many of the next requests get lost on their way; counts down.
        lose_completion: Whether "goto completed" is never sent.
        no_status: Whether "status changed" is never sent.
        mute: Whether nothing at all is sent; requests are still carried out.
        latency_ms: How long everything that it sends is on its way, 0..10000 ms.
        jitter_ms: Up to how much longer, drawn anew for each datagram; order is kept, 0..10000 ms.
        stall: Letters of the axes that are stuck: "x", "yz", ...; "" for none.
        offset_um: What each reading is off by, up to four values in µm.
        freeze_reading: Whether readings stay what they were while the axes move on.
        calibration_lost: Whether the zero is lost: readings and targets are a metre off.
        noise_um: Standard deviation of a reading in µm, 0..1000.
        silence_s: How long a reboot takes, 0..60 s.
    """

    drop_acks: int = 0
    drop_requests: int = 0
    lose_completion: bool = False
    no_status: bool = False
    mute: bool = False
    latency_ms: float = 0.0
    jitter_ms: float = 0.0
    stall: str = ""
    offset_um: tuple[float, ...] = ()
    freeze_reading: bool = False
    calibration_lost: bool = False
    noise_um: float = 0.05
    silence_s: float = 2.0

    def changed(self, knobs: Mapping[str, object]) -> "Faults":
        """Return the same with some knobs set anew.

        Args:
            knobs: Their values as they come from JSON.

        Raises:
            ConfigError: If a knob is unknown or its value does not fit.
        """
        unknown = sorted(set(knobs) - set(_CHECKS))
        if unknown:
            raise ConfigError(f"no knob {', '.join(unknown)}; there are {', '.join(_CHECKS)}")
        return replace(self, **{name: _CHECKS[name](name, value) for name, value in knobs.items()})  # type: ignore[arg-type]

    def as_json(self) -> dict[str, object]:
        """Return the knobs by name."""
        return asdict(self)


def _switch(name: str, value: object) -> bool:
    if not isinstance(value, bool):
        raise ConfigError(f"{name} is true or false, not {value!r}")
    return value


def _count(name: str, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ConfigError(f"{name} is a whole number from 0, not {value!r}")
    return value


def _number(highest: float) -> Callable[[str, object], float]:
    def check(name: str, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= highest:
            raise ConfigError(f"{name} is a number from 0 to {highest:g}, not {value!r}")
        return float(value)

    return check


def _letters(name: str, value: object) -> str:
    if not isinstance(value, str) or not set(value.lower()) <= set(AXES):
        raise ConfigError(f"{name} is letters of axes out of {AXES}, or empty, not {value!r}")
    return value.lower()


def _offsets(name: str, value: object) -> tuple[float, ...]:
    if isinstance(value, list | tuple) and len(value) <= len(AXES) and all(map(_is_finite, value)):
        return tuple(float(part) for part in value)
    raise ConfigError(f"{name} is up to {len(AXES)} finite numbers, not {value!r}")


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


_CHECKS: dict[str, Callable[[str, object], object]] = {
    "drop_acks": _count,
    "drop_requests": _count,
    "lose_completion": _switch,
    "no_status": _switch,
    "mute": _switch,
    "latency_ms": _number(_LONGEST_MS),
    "jitter_ms": _number(_LONGEST_MS),
    "stall": _letters,
    "offset_um": _offsets,
    "freeze_reading": _switch,
    "calibration_lost": _switch,
    "noise_um": _number(1000.0),
    "silence_s": _number(60.0),
}
assert set(_CHECKS) == {field.name for field in fields(Faults)}
