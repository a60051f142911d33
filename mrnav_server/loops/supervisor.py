"""The server's end of the supervisor: starts it, beats, and hears what it did.

The other end is a process of its own, ``supervisor_process``, because whatever lives in the server dies and
hangs with it.
"""

import asyncio
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from mrnav_server.loops.supervisor_process import IDLE, MOVES, QUIT

REPORT_NAME = "supervisor.jsonl"
"""Where the supervisor writes what it did, beside the trials."""

_START_S = 2.0
_SILENT_S = 0.5
_STUCK_S = 2.0
_END_S = 3.0
_BACK_OFF_S, _LONGEST_BACK_OFF_S = 0.1, 5.0


@dataclass(frozen=True, slots=True)
class SupervisorConfig:
    """The process that stops the manipulator when the server is killed or hangs.

    Attributes:
        enabled: Whether it runs; without it, a move that was ordered before a crash runs to its end.
        hang_s: A server that may move the tip and does not tick for longer hangs, 0.03 to 0.2 s.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    enabled: bool = True
    hang_s: float = 0.05

    def __post_init__(self) -> None:
        if not 0.03 <= self.hang_s <= 0.2:
            raise ValueError("hang_s must lie between 0.03 and 0.2 s")


class StopTarget(NamedTuple):
    """Where a raw STOP goes.

    Attributes:
        address: The controller's IPv4 address.
        port: The controller's UDP port.
        device_id: The device's id in messages.
    """

    address: str
    port: int
    device_id: int


@dataclass(frozen=True, slots=True)
class StopReport:
    """What the supervisor did.

    Attributes:
        at: Local time, a label.
        reason: ``killed`` or ``hung``.
        silent_ms: From the server's last beat to the first STOP; None if it never beat.
        stops: How many STOPs were sent.
        answered: Whether the controller answered when asked for its position.
        rested: Whether the tip came to rest.
        position_um: Where the tip was last; None without an answer.
    """

    at: str
    reason: str
    silent_ms: float | None
    stops: int
    answered: bool
    rested: bool
    position_um: tuple[float, ...] | None

    @property
    def sentence(self) -> str:
        """What happened, for the operator."""
        cause = "the server was killed" if self.reason == "killed" else _hung(self.silent_ms)
        if not self.answered:
            outcome = "the manipulator did not answer: check where the magnet is"
        elif not self.rested:
            outcome = "the manipulator had not come to rest: check where the magnet is"
        else:
            outcome = "it rests at " + ", ".join(f"{at_um:.0f}" for at_um in self.position_um or ()) + " µm"
        return f"{self.at}: the supervisor stopped the manipulator ({self.stops} STOPs): {cause}; {outcome}"


class Supervisor:
    """Runs the supervisor process while it is entered.

    Args:
        config: When a server hangs.
        target: Where the STOP goes.
        report_file: Where the process writes what it did.
        clock: Monotonic time in seconds.
        on_stop: Called in the event loop, with a sentence, when the manipulator was stopped although this
            process lives; more than once for one stop.
        on_report: Called in the event loop once the stop is over.
    """

    def __init__(
        self,
        config: SupervisorConfig,
        target: StopTarget,
        report_file: Path,
        clock: Callable[[], float],
        on_stop: Callable[[str], None],
        on_report: Callable[[StopReport], None] = lambda report: None,
    ) -> None:
        self._config = config
        self._report_file = report_file
        self._clock = clock
        self._on_stop = on_stop
        self._on_report = on_report
        module = "mrnav_server.loops.supervisor_process"
        arguments = [*map(str, target), str(config.hang_s), str(report_file.absolute())]
        self._command = [sys.executable, "-m", module, *arguments]
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread = threading.Thread(target=self._run, name="supervisor", daemon=True)
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe_lock = threading.Lock()
        """Held while the pipe is closed, so that a beat never goes to a descriptor that was given anew."""
        self._ready = threading.Event()
        self._ending = threading.Event()
        self._beat_s: float | None = None
        self._moves = False
        self._unanswered_s: float | None = None

    @property
    def refusal(self) -> str:
        """Why nothing may be armed and nothing may drive, or ""."""
        waiting_s = 0.0 if self._unanswered_s is None else self._clock() - self._unanswered_s
        if self._ready.is_set() and waiting_s <= _SILENT_S:
            return ""
        return "the supervisor does not answer: it is being started again"

    async def __aenter__(self) -> Self:
        """Start the process and wait until it watches; after 2 s without it, go on and refuse."""
        self._loop = asyncio.get_running_loop()
        self._report_file.parent.mkdir(parents=True, exist_ok=True)
        self._thread.start()
        try:
            await asyncio.to_thread(self._ready.wait, _START_S)
        except asyncio.CancelledError:
            await self._end()
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the process: the manipulator must rest by now."""
        await self._end()

    def beat(self, moves: bool) -> None:
        """Tell the supervisor that this process lives. Never waits, never raises.

        A beat that comes too late finds that the supervisor stopped the manipulator, before it says so.

        Args:
            moves: Whether the tip may be in motion.
        """
        now_s, before_s = self._clock(), self._beat_s
        if before_s is not None and now_s - before_s > self._config.hang_s:
            # What the supervisor answered meanwhile may not have been read yet.
            self._unanswered_s = None
            if self._moves and self._ready.is_set():
                self._on_stop(_stopped(1000.0 * (now_s - before_s)))
        self._beat_s, self._moves = now_s, moves
        if not self._ready.is_set():
            return
        if self._unanswered_s is None:
            self._unanswered_s = now_s
        if now_s - self._unanswered_s > _STUCK_S:
            self._kill()
        self._write(MOVES if moves else IDLE)

    async def _end(self) -> None:
        self._ending.set()
        self._write(QUIT)
        await asyncio.to_thread(self._thread.join, _END_S)

    def _write(self, beat: bytes) -> None:
        if not self._pipe_lock.acquire(blocking=False):
            return
        try:
            process = self._process
            if process is not None and process.stdin is not None:
                # A full pipe and a process that died show by the answers that do not come.
                with suppress(OSError, ValueError):
                    process.stdin.write(beat)
        finally:
            self._pipe_lock.release()

    def _kill(self) -> None:
        process = self._process
        if process is not None:
            self._ready.clear()
            process.kill()

    # -- in a thread, because it waits ------------------------------------------------------------------

    def _run(self) -> None:
        back_off_s = _BACK_OFF_S
        while not self._ending.is_set():
            began_s = self._clock()
            # One that could not be started is tried again like one that died.
            with suppress(OSError):
                self._attend()
            lasted = self._clock() - began_s > _LONGEST_BACK_OFF_S
            back_off_s = _BACK_OFF_S if lasted else min(2.0 * back_off_s, _LONGEST_BACK_OFF_S)
            self._ending.wait(back_off_s)

    def _attend(self) -> None:
        """Start the process and hear it until it ends."""
        process = subprocess.Popen(
            self._command,
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        assert process.stdin is not None
        assert process.stdout is not None
        if os.name == "posix":
            os.set_blocking(process.stdin.fileno(), False)
        self._process = process
        try:
            with process.stdout as lines:
                for line in lines:
                    self._hear(line)
        finally:
            self._ready.clear()
            with self._pipe_lock:
                process.stdin.close()
                self._process = None
            try:
                process.wait(_START_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _hear(self, line: bytes) -> None:
        message = json.loads(line)
        self._unanswered_s = None
        if message["event"] == "ready":
            self._ready.set()
            if self._ending.is_set():
                self._write(QUIT)
        elif message["event"] == "stopping":
            self._tell(lambda: self._on_stop(_stopped(message["silent_ms"])))
        elif message["event"] == "stopped":
            report = _report(message)
            self._tell(lambda: self._on_report(report))

    def _tell(self, what: Callable[[], None]) -> None:
        if self._loop is not None:
            self._loop.call_soon_threadsafe(what)


def earlier_reports(report_file: Path) -> list[StopReport]:
    """Return what a supervisor wrote and nobody was told yet; how far one was told stands beside it.

    Raises:
        OSError: If the files cannot be read or written.
    """
    if not report_file.exists():
        return []
    mark = report_file.with_suffix(".told")
    told = int(mark.read_text()) if mark.exists() else 0
    lines = report_file.read_bytes()[told:]
    whole = lines[: lines.rfind(b"\n") + 1]
    mark.write_text(str(told + len(whole)))
    reports = []
    for line in whole.splitlines():
        # A line that a power failure damaged says nothing.
        with suppress(ValueError, KeyError, TypeError):
            reports.append(_report(json.loads(line)))
    return reports


def _report(message: dict[str, object]) -> StopReport:
    fields = {name: value for name, value in message.items() if name != "event"}
    position = fields.pop("position_um")
    return StopReport(**fields, position_um=None if position is None else tuple(position))  # type: ignore[arg-type]


def _stopped(silent_ms: float | None) -> str:
    return f"the supervisor stopped the manipulator: {_hung(silent_ms)}"


def _hung(silent_ms: float | None) -> str:
    return "the server did not tick" + ("" if silent_ms is None else f" for {silent_ms:.0f} ms")
