"""Both drivers on an emulated controller that runs as a process."""

import asyncio
import importlib.util
import platform
import socket
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, closing, contextmanager, suppress
from typing import Any

import pytest

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.frames import StagePoint
from mrnav_server.devices.sensapex.config import SensapexConfig
from mrnav_server.devices.sensapex.emulator_faults import Faults
from mrnav_server.devices.sensapex.sdk import SdkManipulator
from mrnav_server.devices.sensapex.smcp1 import COMMAND, Block, Kind, Message, encode
from mrnav_server.devices.sensapex.udp import UdpManipulator
from tests.devices.emulator_process import EmulatorProcess

Driver = UdpManipulator | SdkManipulator
HAS_SDK = (
    sys.platform == "linux"
    and platform.machine() == "x86_64"
    and importlib.util.find_spec("sensapex") is not None
)
NEEDS_SDK = pytest.mark.skipif(
    not HAS_SDK, reason="needs the vendor's library: pip install 'mrnav-server[sensapex]' on Linux x86_64"
)
DRIVERS = [
    pytest.param(UdpManipulator, id="udp"),
    pytest.param(SdkManipulator, id="sdk", marks=NEEDS_SDK),
]
NOISE_UM = 0.5
CEILING_S = 5.0
"""For what takes milliseconds on a machine that is not busy."""


@contextmanager
def held_port() -> Iterator[None]:
    """Hold the port that every handle of the library wants on loopback, so that each takes one of its own."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as holder:
        with suppress(OSError):
            holder.bind(("0.0.0.0", 55553))
        yield


def sound(emulator: EmulatorProcess, device: int = 1) -> EmulatorProcess:
    """Turn all knobs back, wait until a reboot is over, and let moves through."""
    emulator.turn(device=device, **Faults().as_json())
    while emulator.turn(device=device)["rebooting"]:
        time.sleep(0.01)
    lock(emulator, locked=False, device=device)
    return emulator


def lock(emulator: EmulatorProcess, *, locked: bool, device: int = 1) -> None:
    """Lock movement as on the touch screen: moves are not acknowledged any more."""
    number = time.monotonic_ns() % 0xFFFF
    command = Message(device, 0x2C8, number, COMMAND, Kind.SET_FEATURE, (Block((17, locked)),))
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as screen:
        screen.settimeout(CEILING_S)
        screen.sendto(encode(command), (emulator.host, emulator.port))
        screen.recv(2048)


def config_of(emulator: EmulatorProcess, *, device_id: int = 1, axes: int = 4) -> SensapexConfig:
    # On a busy machine a short silence is no failure.
    return SensapexConfig(address=emulator.host, device_id=device_id, axes=axes, silent_ms=400)


@asynccontextmanager
async def opened(
    driver: type[Driver], emulator: EmulatorProcess, *, device_id: int = 1, axes: int = 4
) -> AsyncIterator[Driver]:
    """Open a driver, and give it back."""
    with held_port():
        manipulator = driver(config_of(emulator, device_id=device_id, axes=axes), time.monotonic)
        await manipulator.open()
        try:
            yield manipulator
        finally:
            await manipulator.close()


async def until(condition: Callable[[], bool], what: str) -> float:
    """Wait until something holds; return how long it took, in s."""
    began_s = time.monotonic()
    while not condition():
        assert time.monotonic() - began_s < CEILING_S, f"never: {what}"
        await asyncio.sleep(0.002)
    return time.monotonic() - began_s


def move_by(manipulator: Driver, x_um: float, speed_um_per_s: float = 2000.0) -> StagePoint:
    """Move along x from where the tip is; return the target."""
    at = manipulator.tip().position
    target = StagePoint(at.x_um + x_um, at.y_um, at.z_um)
    return manipulator.move_to(target, speed_um_per_s, time.monotonic()).target


def fault(manipulator: Driver) -> str:
    """Return why the manipulator has failed, or ""."""
    try:
        manipulator.tip()
    except DeviceError as error:
        return str(error)
    return ""


def kinds(emulator: EmulatorProcess, *wanted: str) -> list[dict[str, Any]]:
    """Return the datagrams of some kinds that the controller received."""
    return [row for row in emulator.trace() if row["dir"] == "rx" and row["kind"] in wanted]
