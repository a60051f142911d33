"""The supervisor as the process that it is, against a controller that is scripted here."""

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.devices.sensapex.smcp1 import Block, Kind, Message, Option, decode, encode
from mrnav_server.loops.supervisor import (
    StopTarget,
    Supervisor,
    SupervisorConfig,
    earlier_reports,
)
from mrnav_server.loops.supervisor_process import IDLE, MOVES, Beats, death_watch
from tests.rig_process import wait_for

CEILING_S = 5.0
SERVER = Path(__file__).with_name("supervised_server.py")
HEAVY = {
    "numpy",
    "cv2",
    "torch",
    "scipy",
    "asyncio",
    "pydantic",
    "fastapi",
    "uvicorn",
    "orjson",
    "subprocess",
}


class Controller:
    """A scripted controller: its tip runs on until it has heard a number of STOPs."""

    def __init__(self, stops_needed: int = 1) -> None:
        self.stops_s: list[float] = []
        self.mute = False
        self.x_nm = 5_000_000
        self._stops_needed = stops_needed
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self.port: int = self._socket.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
            end.sendto(b"", ("127.0.0.1", self.port))
        self._thread.join(CEILING_S)
        self._socket.close()

    def _serve(self) -> None:
        seen = set()
        while True:
            data, peer = self._socket.recvfrom(2048)
            if not data:
                return
            ask = decode(data)
            if ask.kind == Kind.STOP:
                assert ask.receiver == 1
                assert (ask.sender, ask.id) not in seen, "a controller executes a repeated request only once"
                seen.add((ask.sender, ask.id))
                self.stops_s.append(time.monotonic())
            elif ask.kind == Kind.GET_POSITIONS and not self.mute:
                if len(self.stops_s) < self._stops_needed:
                    self.x_nm += 20_000
                at = Block((self.x_nm, 7_000_000, 13_000_000, 0))
                ack = Message(ask.sender, 1, ask.id, Option.ACK, ask.kind)
                self._socket.sendto(encode(ack), peer)
                answer = Message(ask.sender, 1, ask.id, Option.REPLY, ask.kind, (at,))
                self._socket.sendto(encode(answer), peer)


class Server:
    """The miniature server as a process."""

    def __init__(self, controller: Controller, report_file: Path, kind: str = "m") -> None:
        self.report_file = report_file
        self.said: list[str] = []
        self.process = subprocess.Popen(
            [sys.executable, SERVER, str(controller.port), report_file, kind],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        wait_for(lambda: bool(self.said), 2 * CEILING_S, "the server")
        self.supervisor = psutil.Process(int(self.said[0].split()[1]))

    def _read(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            self.said.extend(line.strip() for line in lines)

    def send(self, what: signal.Signals) -> None:
        self.process.send_signal(what)

    def heard(self, start: str) -> bool:
        return any(line.startswith(start) for line in self.said)

    def supervisor_ends(self) -> None:
        self.supervisor.wait(CEILING_S)

    def reports(self) -> list[dict[str, object]]:
        return [json.loads(line) for line in self.report_file.read_text().splitlines()]

    def end(self) -> None:
        if self.process.poll() is None:
            self.send(signal.SIGCONT)
            self.process.kill()
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait(CEILING_S)
        self._reader.join(CEILING_S)


@pytest.fixture
def report_file(tmp_path: Path) -> Path:
    return tmp_path / "trials" / "supervisor.jsonl"


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller(stops_needed=3) as controller:
        yield controller


@pytest.fixture
def start(controller: Controller, report_file: Path) -> Iterator[Callable[[str], Server]]:
    servers: list[Server] = []

    def started(kind: str) -> Server:
        servers.append(Server(controller, report_file, kind))
        return servers[-1]

    yield started
    for server in servers:
        server.end()


@pytest.mark.parametrize("kind", ["m", "i"])
def test_a_killed_server_stops_the_manipulator_until_it_rests(
    start: Callable[[str], Server], controller: Controller, kind: str
) -> None:
    server = start(kind)
    assert controller.stops_s == []
    killed_s = time.monotonic()
    server.send(signal.SIGKILL)
    server.supervisor_ends()
    assert controller.stops_s[0] - killed_s < 1.0
    assert 3 <= len(controller.stops_s) < 50
    (report,) = server.reports()
    assert report["reason"] == "killed"
    assert report["stops"] == len(controller.stops_s)
    assert report["answered"]
    assert report["rested"]
    assert report["position_um"] == [controller.x_nm / 1000, 7000.0, 13_000.0, 0.0]


def test_a_server_that_hangs_stops_the_manipulator_and_hears_of_it(
    start: Callable[[str], Server], controller: Controller
) -> None:
    server = start("m")
    server.send(signal.SIGSTOP)
    wait_for(lambda: bool(controller.stops_s), CEILING_S, "a STOP")
    wait_for(server.report_file.exists, CEILING_S, "the report")
    stops = len(controller.stops_s)
    time.sleep(0.1)
    assert len(controller.stops_s) == stops, "one hang is stopped once"
    server.send(signal.SIGCONT)
    wait_for(lambda: server.heard("report hung"), CEILING_S, "the report")
    assert server.heard("the supervisor stopped the manipulator: the server did not tick for ")
    (report,) = server.reports()
    assert report["reason"] == "hung"
    assert isinstance(report["silent_ms"], float)
    assert 200.0 <= report["silent_ms"] < 1000.0
    # It went on watching.
    time.sleep(0.3)
    server.send(signal.SIGSTOP)
    wait_for(lambda: len(controller.stops_s) > stops, CEILING_S, "another STOP")


def test_a_server_that_hangs_while_nothing_moves_is_left_alone(
    start: Callable[[str], Server], controller: Controller
) -> None:
    server = start("i")
    server.send(signal.SIGSTOP)
    time.sleep(0.5)
    server.send(signal.SIGCONT)
    time.sleep(0.1)
    assert server.supervisor.is_running()
    assert controller.stops_s == []
    assert len(server.said) == 1


def test_a_server_that_ends_takes_its_supervisor_along(
    start: Callable[[str], Server], controller: Controller
) -> None:
    server = start("m")
    assert server.process.stdin is not None
    server.process.stdin.close()
    assert server.process.wait(CEILING_S) == 0
    server.supervisor_ends()
    assert controller.stops_s == []
    assert not server.report_file.exists()


def test_signals_that_end_a_server_do_not_end_its_supervisor(
    start: Callable[[str], Server], controller: Controller
) -> None:
    server = start("m")
    assert os.getsid(server.supervisor.pid) == server.supervisor.pid
    for what in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        server.supervisor.send_signal(what)
    server.send(signal.SIGKILL)
    server.supervisor_ends()
    assert controller.stops_s


def test_a_controller_that_does_not_answer_is_told_for_two_seconds(
    start: Callable[[str], Server], controller: Controller, report_file: Path
) -> None:
    server = start("m")
    controller.mute = True
    server.send(signal.SIGKILL)
    server.supervisor_ends()
    assert 20 < len(controller.stops_s) <= 201
    (report,) = earlier_reports(report_file)
    assert not report.answered
    assert report.position_um is None
    assert "check where the magnet is" in report.sentence


def test_a_report_is_told_once(start: Callable[[str], Server], report_file: Path) -> None:
    assert earlier_reports(report_file) == []
    server = start("m")
    server.send(signal.SIGKILL)
    server.supervisor_ends()
    with report_file.open("ab") as file:
        file.write(b'{"half a line')
    (report,) = earlier_reports(report_file)
    assert "the server was killed; it rests at 50" in report.sentence
    assert earlier_reports(report_file) == []
    with report_file.open("ab") as file:
        file.write(b"}\n" + report_file.read_bytes().splitlines()[0] + b"\n")
    assert earlier_reports(report_file) == [report]


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux shows that a process is dying")
def test_a_process_that_was_killed_dies_before_it_is_gone() -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        dies = death_watch(process.pid)
        assert not dies()
        process.kill()
        wait_for(lambda: psutil.Process(process.pid).status() == psutil.STATUS_ZOMBIE, CEILING_S, "its end")
        assert dies()
        process.wait()
        assert dies()
    assert not death_watch(2**22 + 1)()


def test_the_process_imports_nothing_heavy() -> None:
    code = "import sys, mrnav_server.loops.supervisor_process; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = done.stdout.split()
    assert "mrnav_server.devices.sensapex.raw_stop" in loaded
    assert not HEAVY & {name.partition(".")[0] for name in loaded}


# -- the server's end


def supervise(controller: Controller, report_file: Path, clock: Callable[[], float]) -> Supervisor:
    target = StopTarget("127.0.0.1", controller.port, 1)
    return Supervisor(SupervisorConfig(), target, report_file, clock, lambda _: None)


async def beat_until(supervisor: Supervisor, condition: Callable[[], bool], what: str) -> None:
    async with asyncio.timeout(2 * CEILING_S):
        while not condition():
            supervisor.beat(True)
            await asyncio.sleep(0.01)
    assert condition(), what


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
async def test_a_supervisor_that_dies_or_freezes_is_a_refusal_and_is_started_again(
    controller: Controller, report_file: Path, how: signal.Signals
) -> None:
    supervisor = supervise(controller, report_file, time.monotonic)
    assert "does not answer" in supervisor.refusal
    supervisor.beat(True)
    async with supervisor:
        assert supervisor.refusal == ""
        assert supervisor._process is not None
        first = psutil.Process(supervisor._process.pid)
        await beat_until(supervisor, lambda: supervisor._unanswered_s is None, "an answer")
        first.send_signal(how)
        await beat_until(supervisor, lambda: "does not answer" in supervisor.refusal, "a refusal")
        await beat_until(supervisor, lambda: not supervisor.refusal, "another supervisor")
        assert supervisor._process.pid != first.pid
        assert not first.is_running(), "no zombie stays"
        supervisor.beat(False)
    assert controller.stops_s == []


async def test_a_beat_never_waits_for_a_supervisor_that_does_not_read(
    controller: Controller, report_file: Path
) -> None:
    now_s = 100.0
    supervisor = supervise(controller, report_file, lambda: now_s)
    async with supervisor:
        assert supervisor._process is not None
        child = psutil.Process(supervisor._process.pid)
        child.suspend()
        for _ in range(70_000):
            supervisor.beat(False)
        now_s += 0.6
        supervisor.beat(False)
        assert supervisor.refusal == "", "after a pause its answer may lie unread"
        for _ in range(26):
            now_s += 0.02
            supervisor.beat(False)
        assert "does not answer" in supervisor.refusal
        child.resume()


async def test_a_beat_that_comes_too_late_knows_what_happened(
    controller: Controller, report_file: Path
) -> None:
    now_s = 100.0
    told: list[str] = []
    target = StopTarget("127.0.0.1", controller.port, 1)
    supervisor = Supervisor(SupervisorConfig(hang_s=0.2), target, report_file, lambda: now_s, told.append)
    async with supervisor:
        supervisor.beat(True)
        now_s += 0.19
        supervisor.beat(False)
        now_s += 0.5
        supervisor.beat(True)
        assert told == []
        now_s += 0.261
        supervisor.beat(False)
        assert told == ["the supervisor stopped the manipulator: the server did not tick for 261 ms"]


@pytest.mark.parametrize("hang_s", [0.02, 0.3, float("nan")])
def test_a_hang_outside_the_bounds_is_refused(hang_s: float) -> None:
    with pytest.raises(ValueError, match="hang_s"):
        SupervisorConfig(hang_s=hang_s)


@given(
    st.lists(
        st.tuples(st.floats(0.0, 0.3), st.sampled_from([MOVES, IDLE])),
        min_size=1,
        max_size=30,
    ),
    st.floats(0.0, 0.5),
)
def test_silence_counts_from_the_last_beat_while_the_tip_may_move(
    beats: list[tuple[float, bytes]], silence_s: float
) -> None:
    heard, now_s = Beats(0.05), 100.0
    assert not heard.hangs(now_s)
    for pause_s, kind in beats:
        now_s += pause_s
        heard.heard(kind, now_s)
        assert not heard.hangs(now_s)
    moves, silent_s = beats[-1][1] == MOVES, (now_s + silence_s) - now_s
    assert heard.hangs(now_s + silence_s) == (moves and silent_s >= 0.05)
    # Whoever looks again after the pauses that it asks for sees a hang within 3 ms of it.
    look_s = now_s
    while look_s < now_s + 0.05:
        look_s += heard.pause_s(look_s)
    assert not moves or look_s <= now_s + 0.053 + 1e-9
    heard.disarm()
    assert not heard.hangs(now_s + silence_s)
