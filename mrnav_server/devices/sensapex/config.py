"""Which Sensapex manipulator, and how it is spoken to."""

import ipaddress
from dataclasses import dataclass

from mrnav_server.devices.sensapex.smcp1 import ALL_DEVICES, BASE_PORT

_LINK_LOCAL = "169.254.255.255"
"""Broadcast address of the network that controllers live in."""
_LOOPBACK = "127.0.0.1"
"""Where an emulated controller is."""
_FIRST_DIRECT = 0x1000
_FIRST_PREFIX = 114
_IDS_PER_PREFIX = 0x2000
_NUMBERS_PER_PREFIX = 100_000


@dataclass(frozen=True, slots=True)
class SensapexConfig:
    """The manipulator on the lab's network.

    Attributes:
        address: The controller's IPv4 address; "" asks the link-local network, then this computer.
        group: Group on the controller's touch screen as a number, A = 0 .. K = 10; chooses the UDP port.
        device_id: Number on the touch screen, 1..254, or the full serial number of a newer device.
        axes: How many axes the manipulator has, 3 or 4.
        timeout_ms: How long each of three tries waits for an answer, 5..50 ms.
        poll_hz: How often the position is asked for, 30..200 Hz.
        silent_ms: A manipulator that answers nothing for this long has failed, 100..500 ms.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    address: str = ""
    group: int = 0
    device_id: int = 1
    axes: int = 4
    timeout_ms: int = 20
    poll_hz: float = 50.0
    silent_ms: int = 100

    def __post_init__(self) -> None:
        if self.address:
            try:
                ipaddress.IPv4Address(self.address)
            except ValueError:
                raise ValueError('address must be a dotted IPv4 address, for example "169.254.1.7"') from None
        if not 0 <= self.group <= 10:
            raise ValueError("group must lie between 0 (A on the touch screen) and 10 (K)")
        if not (1 <= self.device_id <= 254 or _is_serial(self.device_id)):
            raise ValueError("device_id must be the number on the touch screen, 1..254, or a serial number")
        if self.axes not in (3, 4):
            raise ValueError("axes must be 3 or 4")
        if not 5 <= self.timeout_ms <= 50:
            raise ValueError("timeout_ms must lie between 5 and 50 ms")
        if not 30.0 <= self.poll_hz <= 200.0:
            raise ValueError("poll_hz must lie between 30 and 200 Hz")
        if not 100 <= self.silent_ms <= 500:
            raise ValueError("silent_ms must lie between 100 and 500 ms")

    @property
    def addresses(self) -> tuple[str, ...]:
        """Where the controller is looked for, in this order; broadcast addresses too."""
        return (self.address,) if self.address else (_LINK_LOCAL, _LOOPBACK)

    @property
    def port(self) -> int:
        """The UDP port that the group's devices listen on."""
        return BASE_PORT + self.group

    @property
    def timeout_s(self) -> float:
        """How long one try waits, in seconds."""
        return 1e-3 * self.timeout_ms

    @property
    def silent_s(self) -> float:
        """How long a silence means that it has failed, in seconds."""
        return 1e-3 * self.silent_ms

    @property
    def wire_id(self) -> int:
        """The device's id in SMCP1 messages."""
        return wire_id(self.device_id)


def wire_id(device_id: int) -> int:
    """Return the id in messages of a device that a person knows by its number or its serial number."""
    if device_id < _FIRST_PREFIX * _NUMBERS_PER_PREFIX:
        return device_id
    prefix, number = divmod(device_id, _NUMBERS_PER_PREFIX)
    return _FIRST_DIRECT + _IDS_PER_PREFIX * (prefix - _FIRST_PREFIX) + number


def device_id_of(wire_id: int) -> int:
    """Return the number or serial number of a device with this id in messages."""
    if wire_id < _FIRST_DIRECT:
        return wire_id
    prefix, number = divmod(wire_id - _FIRST_DIRECT, _IDS_PER_PREFIX)
    return (_FIRST_PREFIX + prefix) * _NUMBERS_PER_PREFIX + number


def is_device(wire_id: int) -> bool:
    """Tell whether an id in messages is that of a device, not of a touch screen, a PC or a group of them."""
    return 0 < wire_id < ALL_DEVICES or wire_id >= _FIRST_DIRECT


def _is_serial(device_id: int) -> bool:
    prefix, number = divmod(device_id, _NUMBERS_PER_PREFIX)
    return prefix >= _FIRST_PREFIX and number < _IDS_PER_PREFIX and wire_id(device_id) <= 0xFFFF
