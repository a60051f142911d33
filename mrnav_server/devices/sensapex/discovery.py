"""Which controllers are there: who answers, what it is, and where it stands. Nothing moves."""

import asyncio
import contextlib
import ipaddress
import secrets
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from mrnav_server.core.errors import DeviceError, WireError
from mrnav_server.devices.sensapex.config import SensapexConfig, device_id_of, is_device, wire_id
from mrnav_server.devices.sensapex.endpoint import Endpoint
from mrnav_server.devices.sensapex.link import TRIES, Link
from mrnav_server.devices.sensapex.smcp1 import (
    ALL_DEVICES,
    COMMAND,
    Kind,
    Message,
    Option,
    Parameter,
    decode,
    encode,
)

_FIRST_OWN_ID, _OWN_IDS = 0x2A0, 0x30
"""Among the ids of PCs, apart from those of the vendor's library (up to 0x29B) and of ``RawStop``."""
_VERSION_NUMBERS = 5


@dataclass(frozen=True, slots=True)
class FoundController:
    """One device that answered.

    Attributes:
        device_id: Its number on the touch screen, or its serial number.
        address: Its IPv4 address.
        port: Its UDP port.
        firmware: Numbers of its firmware; empty if it does not tell.
        axes: How many axes it has; 0 if it does not tell.
        position_um: Position of each axis; empty if it does not tell.
    """

    device_id: int
    address: str
    port: int
    firmware: tuple[int, ...]
    axes: int
    position_um: tuple[float, ...]

    @property
    def version(self) -> str:
        """The firmware's version as text."""
        return ".".join(map(str, self.firmware)) or "unknown"


def is_emulated(address: str) -> bool:
    """Tell whether a controller at this IPv4 address is an emulated one: it is on this computer."""
    return ipaddress.IPv4Address(address).is_loopback


def own_id() -> int:
    """Return an id for this side, drawn anew for each connection."""
    return _FIRST_OWN_ID + secrets.randbelow(_OWN_IDS)


def new_link(device_id: int, timeout_s: float) -> Link:
    """Return a link to a device under an id and numbers that no earlier run has used."""
    return Link(device_id, own_id(), secrets.randbelow(0xFFFF), timeout_s)


async def discover(
    addresses: Iterable[str],
    port: int,
    clock: Callable[[], float],
    timeout_s: float = 0.2,
    wanted_id: int | None = None,
) -> list[FoundController]:
    """Return the controllers that answer at the first address where any does.

    Args:
        addresses: Where to ask, in this order; broadcast addresses too.
        port: UDP port of the group.
        clock: Monotonic time in seconds.
        timeout_s: How long to wait for answers at each address.
        wanted_id: Wait no longer once this device has answered.
    """
    for address in addresses:
        search = _Search((address, port), clock, wanted_id)
        try:
            found = await search.run(timeout_s)
        finally:
            search.close()
        if found:
            return found
    return []


async def find(settings: SensapexConfig, clock: Callable[[], float]) -> FoundController:
    """Return the controller that the settings name.

    Raises:
        DeviceError: If it does not answer, or has another number of axes, with the remedy.
    """
    found = await discover(settings.addresses, settings.port, clock, wanted_id=settings.device_id)
    for controller in found:
        if controller.device_id == settings.device_id:
            _check(controller, settings)
            return controller
    where = " or ".join(settings.addresses)
    if found:
        there = ", ".join(str(controller.device_id) for controller in found)
        raise DeviceError(
            f"no manipulator with id {settings.device_id} answers at {where}; there is {there}: "
            "set sensapex.device_id to its number"
        )
    raise DeviceError(
        f"no manipulator answers at {where}, UDP port {settings.port}: check its power and network cable; "
        f"sensapex.group = {settings.group} must be the group on its touch screen (A = 0); this computer "
        "needs an address 169.254.x.x with netmask 255.255.0.0 on that network; let UDP through its firewall"
    )


def _check(controller: FoundController, settings: SensapexConfig) -> None:
    if not controller.axes or not controller.position_um:
        raise DeviceError(
            f"manipulator {controller.device_id} at {controller.address} answers, but does not tell its axes "
            "and position: restart it, and see its touch screen for an error"
        )
    if controller.axes != settings.axes:
        seen = f"manipulator {controller.device_id} reports {controller.axes} axes, not {settings.axes}"
        if settings.axes == 4:
            raise DeviceError(
                f"{seen}: a uMp-4 whose fourth axis is not seen needs its cable or its configuration on the "
                "touch screen put right; for a uMp-3 set sensapex.axes = 3"
            )
        raise DeviceError(f"{seen}: set sensapex.axes = {controller.axes}")


class _Search:
    """Asks at one address."""

    def __init__(self, target: tuple[str, int], clock: Callable[[], float], wanted_id: int | None) -> None:
        self._target = target
        self._wanted_id = None if wanted_id is None else wire_id(wanted_id)
        self._enough = asyncio.Event()
        self._clock = clock
        self._own_id = own_id()
        self._endpoint = Endpoint(self._on_datagram)
        self._found: dict[int, str] = {}
        self._links: dict[int, Link] = {}
        self._answers: dict[int, dict[Kind, tuple[int, ...]]] = {}

    async def run(self, timeout_s: float) -> list[FoundController]:
        await self._endpoint.open()
        first_id = secrets.randbelow(0x8000)
        for number in range(first_id, first_id + TRIES):
            ping = Message(ALL_DEVICES, self._own_id, number, COMMAND, Kind.PING)
            if not self._endpoint.send(encode(ping), self._target):
                return []
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(timeout_s / TRIES):
                    await self._enough.wait()
            if self._enough.is_set():
                break
        return [await self._describe(number, timeout_s) for number in sorted(self._found)]

    def close(self) -> None:
        self._endpoint.close()

    async def _describe(self, number: int, timeout_s: float) -> FoundController:
        link = self._links[number] = new_link(number, timeout_s / 4)
        to = (self._found[number], self._target[1])
        answers = self._answers[number] = {}
        for kind, values in (
            (Kind.GET_VERSION, ()),
            (Kind.GET_PARAMETER, (int(Parameter.AXIS_COUNT),)),
            (Kind.GET_POSITIONS, ()),
        ):
            self._endpoint.send(link.ask(kind, values, self._clock()), to)
            while link.waiting:
                await asyncio.sleep(0.002)
                for again in link.due(self._clock()):
                    self._endpoint.send(again, to)
        parameter = answers.get(Kind.GET_PARAMETER, ())
        return FoundController(
            device_id_of(number),
            *to,
            answers.get(Kind.GET_VERSION, ())[:_VERSION_NUMBERS],
            parameter[1] if len(parameter) == 2 and parameter[0] == Parameter.AXIS_COUNT else 0,
            tuple(value_nm / 1000 for value_nm in answers.get(Kind.GET_POSITIONS, ())),
        )

    def _on_datagram(self, data: bytes, sender: str) -> None:
        try:
            message = decode(data)
        except WireError:
            return
        if link := self._links.get(message.sender):
            heard = link.receive(data, self._clock())
            if heard and heard.request and not message.options & Option.ERROR:
                self._answers[message.sender][Kind(message.kind)] = message.values
        elif message.receiver == self._own_id and message.kind == Kind.PING and is_device(message.sender):
            self._found[message.sender] = sender
            if message.sender == self._wanted_id:
                self._enough.set()
