"""What an emulated manipulator is, and its parameters and features."""

from dataclasses import dataclass

from mrnav_server.core.errors import ConfigError
from mrnav_server.devices.sensapex.emulated_motion import TRAVEL_UM
from mrnav_server.devices.sensapex.smcp1 import BASE_PORT, Feature, Parameter

DEFAULT_SPEED_UM_PER_S = 1000
"""The memory speed that a new device has."""
_FIRST_SERIAL = 11_400_000
_HIGHEST = 0x7FFFFFFF
_SETTABLE = {
    Parameter.MEMORY_SPEED: range(1, _HIGHEST),
    Parameter.DEVICE_ID: range(1, 255),
    Parameter.VIRTUAL_X_ANGLE: range(900),
    Parameter.UDP_PORT: range(BASE_PORT, BASE_PORT + 11),
    Parameter.SOFT_START: range(_HIGHEST),
    Parameter.AXIS_HEAD: range(16),
}


@dataclass(frozen=True, slots=True)
class DeviceModel:
    """What kind of device it is.

    Attributes:
        id: Number on the network: 1..254, or a serial number from 11400000 for a device addressed by it.
        axes: 3 or 4.
        start_um: Where its axes stand at the start, 0..20000 µm; the middle for what is left out.
        acceleration_um_per_s2: What it accelerates and stops with.
        fastest_um_per_s: What it does not exceed, whatever is asked.
        report_s: Time between two "position changed" while it moves.
        port: The UDP port that it says it listens on.
        seed: Seed of the noise.
    """

    id: int = 1
    axes: int = 4
    start_um: tuple[float, ...] = ()
    acceleration_um_per_s2: float = 50_000.0
    fastest_um_per_s: float = 5000.0
    report_s: float = 0.01
    port: int = BASE_PORT
    seed: int = 0

    @property
    def serial(self) -> int:
        """Its serial number."""
        return self.id if self.id >= _FIRST_SERIAL else _FIRST_SERIAL + 100 + self.id

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            ConfigError: If one of them is out of range.
        """
        if self.axes not in (3, 4):
            raise ConfigError(f"axes is 3 or 4, not {self.axes}")
        if not (1 <= self.id <= 254 or _FIRST_SERIAL <= self.id < _FIRST_SERIAL + 100_000):
            raise ConfigError(
                f"id is 1..254 or a serial number {_FIRST_SERIAL}..{_FIRST_SERIAL + 99_999}, not {self.id}"
            )
        if len(self.start_um) > 4 or not all(0 <= at_um <= TRAVEL_UM for at_um in self.start_um):
            raise ConfigError(f"at is up to 4 positions of 0..{TRAVEL_UM:g} µm, not {self.start_um}")


class Registers:
    """What the device remembers by number.

    Args:
        model: What kind it is.
    """

    def __init__(self, model: DeviceModel) -> None:
        self._parameters: dict[int, int] = {
            Parameter.MEMORY_SPEED: DEFAULT_SPEED_UM_PER_S,
            Parameter.DEVICE_ID: min(model.id, 254),
            Parameter.VIRTUAL_X_ANGLE: 0,
            Parameter.UDP_PORT: model.port,
            Parameter.SOFT_START: 0,
            Parameter.AXIS_HEAD: 0,
            Parameter.HARDWARE_ID: model.axes,
            Parameter.SERIAL: model.serial,
            Parameter.EOW: -1,
            Parameter.DETECTED_ANGLE: 0,
            Parameter.AXIS_COUNT: model.axes,
        }
        self._features: dict[int, int] = dict.fromkeys((Feature.LEDS_OFF, Feature.PREVENT_MOVEMENT), 0)
        self._extended: dict[int, int] = dict.fromkeys((Feature.LOW_SPEED, Feature.SOFT_START), 0)

    def parameter(self, number: int) -> int:
        """Return a parameter.

        Raises:
            LookupError: If there is none of that number.
        """
        return self._parameters[number]

    def set_parameter(self, number: int, value: int) -> None:
        """Set a parameter.

        Raises:
            LookupError: If there is none of that number that can be set.
            ValueError: If it cannot be this.
        """
        if value not in _SETTABLE[Parameter(number)]:
            raise ValueError(f"parameter {number} cannot be {value}")
        self._parameters[number] = value

    def feature(self, number: int, extended: bool = False) -> int:
        """Return whether a feature is on, 0 or 1.

        Raises:
            LookupError: If there is none of that number.
        """
        return (self._extended if extended else self._features)[number]

    def set_feature(self, number: int, value: int, extended: bool = False) -> None:
        """Turn a feature on or off.

        Raises:
            LookupError: If there is none of that number.
            ValueError: If ``value`` is neither 0 nor 1.
        """
        features = self._extended if extended else self._features
        if number not in features:
            raise LookupError(number)
        if value not in (0, 1):
            raise ValueError(f"feature {number} cannot be {value}")
        features[number] = value

    def feature_mask(self) -> int:
        """Return the features that are on, as bits."""
        return sum(value << number for number, value in (self._features | self._extended).items())
