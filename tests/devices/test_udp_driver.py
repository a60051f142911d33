"""The driver without a library: what goes out at once, and what strangers send."""

import asyncio
import socket
import time
from collections.abc import Iterator
from contextlib import closing

import pytest

from mrnav_server.core.frames import StagePoint
from mrnav_server.devices.sensapex.smcp1 import Block, Kind, Message, Option, encode
from mrnav_server.devices.sensapex.udp import UdpManipulator
from tests.devices.emulator_process import EmulatorProcess
from tests.devices.sensapex_rig import CEILING_S, fault, kinds, move_by, opened, sound, until


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatorProcess]:
    with EmulatorProcess(tmp_path_factory.mktemp("udp")) as running:
        yield running


@pytest.fixture
def emulator(process: EmulatorProcess) -> EmulatorProcess:
    return sound(process)


def port_of(emulator: EmulatorProcess) -> int:
    """Return the driver's port, as the controller sees it."""
    return int(kinds(emulator, "GET_POSITIONS")[-1]["peer"].rpartition(":")[2])


async def test_a_move_is_on_the_wire_before_the_call_returns(emulator: EmulatorProcess) -> None:
    async with opened(UdpManipulator, emulator) as manipulator:
        before = len(kinds(emulator, "GOTO"))
        move_by(manipulator, 20.0)
        # The event loop does not run from here on.
        deadline_s = time.monotonic() + CEILING_S
        while len(kinds(emulator, "GOTO")) == before:
            assert time.monotonic() < deadline_s


async def test_a_lost_move_is_not_repeated_after_a_stop(emulator: EmulatorProcess) -> None:
    async with opened(UdpManipulator, emulator) as manipulator:
        at_um = emulator.turn()["true_um"]
        moves = len(kinds(emulator, "GOTO"))
        emulator.turn(drop_requests=1)
        move_by(manipulator, 300.0)
        manipulator.stop()
        await until(lambda: len(kinds(emulator, "STOP")) > 0, "the STOP arrives")
        await asyncio.sleep(0.1)
        assert len(kinds(emulator, "GOTO")) == moves + 1
        assert emulator.turn()["true_um"] == at_um


async def test_a_restart_of_the_controller_is_a_fault_and_then_a_warning(emulator: EmulatorProcess) -> None:
    async with opened(UdpManipulator, emulator) as manipulator:
        emulator.turn(silence_s=0.8, reboot=True)
        await until(lambda: "has started anew" in fault(manipulator), "the restart is noticed")
        await until(lambda: not emulator.turn()["rebooting"], "the controller is back")
        await until(lambda: fault(manipulator) == "", "the end of the fault")
        assert any("started anew" in text for text in manipulator.warnings())


async def test_strangers_are_counted_and_ignored(emulator: EmulatorProcess) -> None:
    async with opened(UdpManipulator, emulator) as manipulator:
        assert isinstance(manipulator, UdpManipulator)
        await until(lambda: bool(kinds(emulator, "GET_POSITIONS")), "the driver asks")
        to = ("127.0.0.1", port_of(emulator))
        lie = Message(0x2FF, 1, 1, Option.NOTIFY | Option.REQ, Kind.POSITION, (Block((1, 2, 3, 4)),))
        other = Message(0x2FF, 2, 1, Option.NOTIFY | Option.REQ, Kind.POSITION, (Block((1, 2, 3, 4)),))
        at = manipulator.tip().position
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as stranger:
            stranger.sendto(encode(lie), to)
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as same_host:
            same_host.bind((emulator.host, 0))
            same_host.sendto(encode(other), to)
            same_host.sendto(b"no SMCP1", to)
        await until(lambda: manipulator.counters.get("foreign", 0) >= 2, "both are counted")
        await until(lambda: manipulator.counters.get("garbage", 0) == 1, "it is counted")
        assert manipulator.tip().position.x_um == pytest.approx(at.x_um, abs=1.0)


async def test_a_refused_move_is_a_fault_until_a_stop(emulator: EmulatorProcess) -> None:
    async with opened(UdpManipulator, emulator) as manipulator:
        emulator.turn(drop_acks=1)
        move_by(manipulator, 1.0)
        await until(lambda: emulator.turn()["knobs"]["drop_acks"] == 0, "the answer is lost")
        row = kinds(emulator, "GOTO")[-1]
        request = bytes.fromhex(row["hex"])
        number = int.from_bytes(request[6:8], "big")
        sender = int.from_bytes(request[4:6], "big")
        refusal = Message(sender, 1, number, Option.ACK | Option.ERROR, Kind.GOTO)
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as device:
            device.bind((emulator.host, 0))
            device.sendto(encode(refusal), ("127.0.0.1", port_of(emulator)))
        await until(lambda: "refused a move" in fault(manipulator), "the refusal is noticed")
        manipulator.stop()
        assert fault(manipulator) == ""


async def test_what_a_caller_gets_back_is_what_was_sent(emulator: EmulatorProcess) -> None:
    async with opened(UdpManipulator, emulator) as manipulator:
        at = manipulator.tip().position
        target = StagePoint(at.x_um + 0.12345678, at.y_um, at.z_um)
        moves = len(kinds(emulator, "GOTO"))
        sent = manipulator.move_to(target, 99.7, time.monotonic())
        await until(lambda: len(kinds(emulator, "GOTO")) > moves, "it arrives")
        arguments = bytes.fromhex(kinds(emulator, "GOTO")[-1]["hex"])[20:]
    assert int.from_bytes(arguments[:4], "big", signed=True) == round(sent.target.x_um * 1000)
    assert sent.speed_um_per_s == 100.0
    assert abs(sent.target.x_um - target.x_um) <= 0.0005
