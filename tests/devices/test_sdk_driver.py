"""The driver on the vendor's library: its thread, its STOP, and what it says where the library is missing."""

import importlib.util
import itertools
import platform
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.frames import StagePoint
from mrnav_server.devices.sensapex.config import SensapexConfig
from mrnav_server.devices.sensapex.goto import Goto, goto
from mrnav_server.devices.sensapex.raw_stop import RawStop
from mrnav_server.devices.sensapex.sdk import SdkManipulator
from mrnav_server.devices.sensapex.sdk_library import SdkLibrary, library_path
from mrnav_server.devices.sensapex.sdk_worker import Failed, Moved, Position, Report, SdkWorker
from mrnav_server.devices.sensapex.smcp1 import Kind, decode
from mrnav_server.devices.sensapex.udp import UdpManipulator
from tests.devices.emulator_process import EmulatorProcess
from tests.devices.sensapex_rig import (
    CEILING_S,
    NEEDS_SDK,
    Driver,
    config_of,
    fault,
    kinds,
    opened,
    sound,
    until,
)

HOME = StagePoint(10_000.0, 10_000.0, 10_000.0)


def move(x_um: float) -> Goto:
    return goto(StagePoint(x_um, 0.0, 0.0), 1000.0, HOME)


class FakeLibrary:
    """A library whose moves return when the test lets them."""

    def __init__(self, axes: int = 4) -> None:
        self.moves: list[Goto] = []
        self.entered = threading.Semaphore(0)
        self.gate = threading.Semaphore(0)
        self.before_return: Callable[[], None] = lambda: None
        self.reads = 0
        self.closed = False
        self._axes = axes

    def open(self, address: str, group: int, timeout_ms: int) -> None: ...

    def close(self) -> None:
        self.closed = True

    def list_devices(self) -> list[int]:
        return [1]

    def axis_count(self, device_id: int) -> int:
        return self._axes

    def position_um(self, device_id: int, axes: int) -> tuple[float, ...]:
        self.reads += 1
        return (10_000.0,) * axes

    def status(self, device_id: int) -> int:
        return 0

    def drives(self, device_id: int) -> int:
        return 0

    def goto(self, device_id: int, move: Goto) -> None:
        self.moves.append(move)
        self.entered.release()
        assert self.gate.acquire(timeout=CEILING_S)
        self.before_return()


class Wire:
    """A worker with a fake library, and the socket on which its STOPs arrive."""

    def __init__(self, library: FakeLibrary, clock: Callable[[], float] = time.monotonic) -> None:
        self.library = library
        self.reports: list[Report] = []
        self.controller = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.controller.bind(("127.0.0.1", 0))
        self.controller.settimeout(CEILING_S)
        host, port = self.controller.getsockname()
        self.stop_path = RawStop(host, port, 1)
        self.worker = SdkWorker(SensapexConfig(), host, clock, library, self.stop_path, self.reports.append)

    def stop(self) -> None:
        self.stop_path.send()
        self.worker.drop_moves()

    def take_stop(self) -> None:
        assert decode(self.controller.recv(2048)).kind == Kind.STOP

    def assert_no_more_stops(self) -> None:
        self.controller.settimeout(0.05)
        with pytest.raises(TimeoutError):
            self.controller.recv(2048)

    def end(self) -> None:
        self.library.gate.release(100)
        self.worker.end(CEILING_S)
        assert not self.worker.alive
        self.stop_path.close()
        self.controller.close()


@pytest.fixture
def wire() -> Iterator[Wire]:
    wire = Wire(FakeLibrary())
    wire.worker.start()
    yield wire
    wire.end()
    assert wire.library.closed


def entered(wire: Wire) -> None:
    assert wire.library.entered.acquire(timeout=CEILING_S)


class TestWorker:
    def test_the_newest_move_replaces_the_one_that_waits(self, wire: Wire) -> None:
        wire.worker.move(move(1.0))
        entered(wire)
        for x_um in (2.0, 3.0, 4.0):
            wire.worker.move(move(x_um))
        wire.library.gate.release(2)
        entered(wire)
        assert [sent.positions_nm[0] for sent in wire.library.moves] == [1000, 4000]

    def test_a_stop_in_the_middle_of_a_move_is_repeated_when_the_move_returns(self, wire: Wire) -> None:
        """The library may put the move on the wire after the first STOP; nothing that waits follows."""
        wire.worker.move(move(1.0))
        entered(wire)
        wire.worker.move(move(2.0))
        wire.stop()
        wire.take_stop()
        wire.library.gate.release()
        wire.take_stop()
        wire.assert_no_more_stops()
        assert len(wire.library.moves) == 1

    def test_the_second_stop_comes_before_any_new_move(self, wire: Wire) -> None:
        wire.worker.move(move(1.0))
        entered(wire)
        wire.stop()
        wire.take_stop()
        wire.worker.move(move(2.0))
        wire.library.gate.release()
        entered(wire)
        wire.controller.setblocking(False)
        assert decode(wire.controller.recv(2048)).kind == Kind.STOP
        assert [sent.positions_nm[0] for sent in wire.library.moves] == [1000, 2000]
        wire.library.gate.release()

    def test_a_stop_between_moves_is_one_stop(self, wire: Wire) -> None:
        wire.worker.move(move(1.0))
        entered(wire)
        wire.library.gate.release()
        wait(lambda: any(isinstance(report.outcome, Moved) for report in wire.reports))
        wire.stop()
        wire.take_stop()
        wire.assert_no_more_stops()

    def test_a_move_that_fails_still_gets_the_second_stop(self, wire: Wire) -> None:
        def fail() -> None:
            raise DeviceError("Timeout (-3)")

        wire.library.before_return = fail
        wire.worker.move(move(1.0))
        entered(wire)
        wire.stop()
        wire.take_stop()
        wire.library.gate.release()
        wire.take_stop()
        wait(lambda: any(isinstance(report.outcome, Failed) for report in wire.reports))

    def test_positions_are_read_between_moves_that_never_cease(self) -> None:
        """In simulated time: each move takes 8 ms, and the next one waits already."""
        library = FakeLibrary()
        now_s = itertools.count()
        time_s = [0.0]
        wire = Wire(library, lambda: time_s[0])
        done = threading.Event()

        def busy() -> None:
            time_s[0] += 0.008
            if next(now_s) == 250:
                done.set()
            elif not done.is_set():
                wire.worker.move(move(1.0))

        library.before_return = busy
        library.gate.release(1000)
        wire.worker.move(move(1.0))
        wire.worker.start()
        assert done.wait(CEILING_S)
        wire.end()
        reads = [report.began_s for report in wire.reports if isinstance(report.outcome, Position)]
        assert all(b - a <= 1 / 30 for a, b in itertools.pairwise(reads))
        assert len(reads) >= 60

    def test_a_library_that_hangs_does_not_hold_up_the_end(self) -> None:
        wire = Wire(FakeLibrary())
        wire.worker.start()
        wire.worker.move(move(1.0))
        entered(wire)
        wire.worker.end(0.01)
        assert wire.worker.alive
        wire.end()


def wait(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + CEILING_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.001)


class TestWithoutTheLibrary:
    async def test_a_missing_wheel_names_both_ways_out(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(sys, "platform", "linux")
        monkeypatch.setattr(platform, "machine", lambda: "x86_64")
        monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
        with pytest.raises(DeviceError, match=r"pip install 'mrnav-server\[sensapex\]'.*\"sensapex-udp\""):
            await SdkManipulator(SensapexConfig(), time.monotonic).open()

    @pytest.mark.parametrize(
        ("system", "machine"), [("win32", "AMD64"), ("darwin", "arm64"), ("linux", "aarch64")]
    )
    async def test_another_computer_is_told_so(
        self, monkeypatch: pytest.MonkeyPatch, system: str, machine: str
    ) -> None:
        monkeypatch.setattr(sys, "platform", system)
        monkeypatch.setattr(platform, "machine", lambda: machine)
        with pytest.raises(DeviceError, match=rf"Linux x86_64, not on {system} {machine}.*\"sensapex-udp\""):
            await SdkManipulator(SensapexConfig(), time.monotonic).open()

    def test_a_wheel_without_the_library_counts_as_missing(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.setattr(sys, "platform", "linux")
        monkeypatch.setattr(platform, "machine", lambda: "x86_64")
        (tmp_path / "__init__.py").touch()
        spec = importlib.util.spec_from_file_location("sensapex", tmp_path / "__init__.py")
        monkeypatch.setattr(importlib.util, "find_spec", lambda _: spec)
        with pytest.raises(DeviceError, match="not installed"):
            library_path()


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatorProcess]:
    with EmulatorProcess(tmp_path_factory.mktemp("sdk")) as running:
        yield running


@pytest.fixture
def emulator(process: EmulatorProcess) -> EmulatorProcess:
    return sound(process)


async def test_the_library_s_own_count_of_axes_is_checked(emulator: EmulatorProcess) -> None:
    manipulator = SdkManipulator(config_of(emulator), time.monotonic, lambda: FakeLibrary(axes=3))
    with pytest.raises(DeviceError, match="3 axes, not 4"):
        await manipulator.open()
    assert "not open" in fault(manipulator)


async def test_a_library_without_an_answer_opens_nothing(emulator: EmulatorProcess) -> None:
    class Deaf(FakeLibrary):
        def axis_count(self, device_id: int) -> int:
            raise DeviceError("Timeout (-3)")

    manipulator = SdkManipulator(config_of(emulator), time.monotonic, Deaf)
    with pytest.raises(DeviceError, match=r"Timeout \(-3\)"):
        await manipulator.open()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
async def test_a_thread_that_has_ended_is_a_fault(emulator: EmulatorProcess) -> None:
    class Short(FakeLibrary):
        ended = threading.Event()

        def position_um(self, device_id: int, axes: int) -> tuple[float, ...]:
            if self.ended.is_set():
                raise RuntimeError("a bug")
            return super().position_um(device_id, axes)

    manipulator = SdkManipulator(config_of(emulator), time.monotonic, Short)
    await manipulator.open()
    Short.ended.set()
    await until(lambda: "thread of the vendor's library has ended" in fault(manipulator), "it is noticed")
    await manipulator.close()


def at_rest(manipulator: Driver, at: StagePoint) -> bool:
    tip = manipulator.tip()
    return tip.position == at and not tip.moving


def sent_more(emulator: EmulatorProcess, moves: int) -> bool:
    return len(kinds(emulator, "GOTO")) > moves


@NEEDS_SDK
def test_the_library_tells_its_version() -> None:
    assert SdkLibrary().version.startswith("v1.")


@NEEDS_SDK
async def test_both_drivers_put_the_same_bytes_on_the_wire(emulator: EmulatorProcess) -> None:
    emulator.turn(noise_um=0.0)
    arguments, told = [], []
    drivers: tuple[type[Driver], ...] = (UdpManipulator, SdkManipulator)
    for driver in drivers:
        async with opened(driver, emulator) as manipulator:
            for target in (HOME, StagePoint(10_100.0, 9_950.5, 10_010.25)):
                told.append(manipulator.move_to(target, 3000.0, time.monotonic()).target)
                await until(partial(at_rest, manipulator, target), "the tip arrives")
        arguments.append(bytes.fromhex(kinds(emulator, "GOTO")[-1]["hex"])[8:])
    assert arguments[0] == arguments[1]
    assert told[:2] == told[2:]


@NEEDS_SDK
async def test_the_target_that_is_returned_is_the_one_on_the_wire(emulator: EmulatorProcess) -> None:
    async with opened(SdkManipulator, emulator) as manipulator:
        for x_um in (10_000.3, 10_000.599, 9_999.9994):
            before = len(kinds(emulator, "GOTO"))
            sent = manipulator.move_to(StagePoint(x_um, 10_000.0, 10_000.0), 100.0, time.monotonic())
            await until(partial(sent_more, emulator, before), "it is sent")
            arguments = bytes.fromhex(kinds(emulator, "GOTO")[-1]["hex"])[20:]
            x_nm = int.from_bytes(arguments[:4], "big", signed=True)
            assert x_nm == round(sent.target.x_um * 1000)
            assert abs(sent.target.x_um - x_um) < 0.003
