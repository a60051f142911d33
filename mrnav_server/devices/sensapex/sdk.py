"""A Sensapex manipulator through the vendor's C library (Linux x86_64, extra ``sensapex``)."""

import asyncio
import contextlib
import math
from collections.abc import Callable
from functools import partial

from mrnav_server.core.errors import DeviceError, DeviceTimeoutError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.records import MotionCommand, TipReading
from mrnav_server.devices.sensapex.config import SensapexConfig
from mrnav_server.devices.sensapex.discovery import FoundController
from mrnav_server.devices.sensapex.goto import goto
from mrnav_server.devices.sensapex.loss import LossRate
from mrnav_server.devices.sensapex.manipulator import Connect, SensapexManipulator
from mrnav_server.devices.sensapex.raw_stop import RawStop
from mrnav_server.devices.sensapex.sdk_library import SdkLibrary, as_sent
from mrnav_server.devices.sensapex.sdk_worker import (
    UNDER_WAY,
    Failed,
    Library,
    Moved,
    Position,
    Ready,
    Report,
    SdkWorker,
)
from mrnav_server.devices.sensapex.smcp1 import Status
from mrnav_server.devices.sensapex.tip_record import TipRecord

_FIRST_READING_S = 2.0
_CLOSE_S = 0.5


class SdkManipulator(SensapexManipulator["_Session"]):
    """The manipulator, through the vendor's library.

    One thread calls the library: the newest move, and the position in between. STOP does not pass through it.
    A move counts as sent when the thread got it.

    Args:
        config: Which manipulator.
        clock: Monotonic time in seconds.
        load: Makes the library.
    """

    def __init__(
        self,
        config: SensapexConfig,
        clock: Callable[[], float],
        load: Callable[[], Library] = SdkLibrary,
    ) -> None:
        super().__init__(config, clock)
        self._load = load

    def _connect(self) -> "Connect[_Session]":
        return partial(_Session, self._config, self._clock, self._load())


class _Session:
    """One handle of the library, from opening to closing. All but the worker's calls happens in the loop."""

    def __init__(
        self,
        config: SensapexConfig,
        clock: Callable[[], float],
        library: Library,
        found: FoundController,
        stop_path: RawStop,
    ) -> None:
        self._config = config
        self._clock = clock
        self._name = f"manipulator {config.device_id}"
        self._record = TipRecord(config.axes, self._name, config.silent_s)
        self._loss = LossRate()
        self._loop = asyncio.get_running_loop()
        self._first: asyncio.Future[None] = self._loop.create_future()
        self._worker = SdkWorker(config, found.address, clock, library, stop_path, self._publish)
        self._unacknowledged_s: float | None = None
        self._stopped_s = -math.inf
        self._status = Status(0)
        self._reason = ""

    async def start(self) -> None:
        """Begin to ask for the position; return at the first reading."""
        self._worker.start()
        try:
            async with asyncio.timeout(_FIRST_READING_S):
                await self._first
        except TimeoutError:
            raise DeviceTimeoutError(
                f"{self._name} tells the vendor's library no position: {self._reason or 'no answer'}"
            ) from None
        self._record.reading(self._clock())

    async def close(self) -> None:
        """End the thread; one that hangs in the library is left to end by itself."""
        await asyncio.to_thread(self._worker.end, _CLOSE_S)

    def tip(self, now_s: float) -> TipReading:
        self._check(now_s)
        return self._record.reading(now_s)

    def move_to(self, target: StagePoint, speed_um_per_s: float, now_s: float) -> MotionCommand:
        self._check(now_s)
        move = goto(target, speed_um_per_s, self._record.newest, self._record.slack_um(now_s))
        self._worker.move(move)
        return MotionCommand(self._clock(), as_sent(move).target, move.speed_um_per_s)

    def drop_moves(self) -> None:
        self._worker.drop_moves()
        self._record.on_stop()
        self._unacknowledged_s = None
        self._stopped_s = self._clock()

    def warnings(self, now_s: float) -> list[str]:
        return self._record.warnings(now_s) + self._loss.warnings(now_s)

    def _check(self, now_s: float) -> None:
        if not self._worker.alive:
            raise DeviceError(f"{self._name}: the thread of the vendor's library has ended: {self._reason}")
        self._record.check(now_s)
        if self._unacknowledged_s is not None:
            self._record.require_acknowledged(now_s - self._unacknowledged_s)

    def _publish(self, report: Report) -> None:
        """Pass a report from the worker's thread to the loop, unless that is closed."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._on_report, report)

    def _on_report(self, report: Report) -> None:
        self._loss.on_request(report.began_s)
        # The library repeats by itself; a call that took longer than one try was repeated.
        if report.ended_s - report.began_s >= self._config.timeout_s:
            self._loss.on_loss(report.ended_s)
        match report.outcome:
            case Ready(axes) if axes != self._config.axes:
                self._fail(f"{self._name} tells the vendor's library of {axes} axes, not {self._config.axes}")
            case Position() as position:
                self._on_position(position, report)
            case Moved(move) if report.began_s > self._stopped_s:
                self._unacknowledged_s = None
                self._record.on_goto(move.target)
            case Failed("a move", reason) if report.began_s > self._stopped_s:
                self._reason = reason
                if self._unacknowledged_s is None:
                    self._unacknowledged_s = report.began_s
            case Failed(call, reason):
                self._reason = reason
                if call != "its position":
                    self._fail(f"{self._name}: {reason}")

    def _on_position(self, position: Position, report: Report) -> None:
        if self._record.on_position(position.position_um, report.began_s):
            self._record.on_answer(report.ended_s)
            if not self._first.done():
                self._first.set_result(None)
        status = Status(position.status & 0xFF)
        # The library repeats the last status for ever; only a new one is news.
        if status != self._status:
            self._status = status
            self._record.on_status(status, report.ended_s)
        if position.drive != UNDER_WAY:
            self._record.on_completed(position.drive, report.ended_s)

    def _fail(self, reason: str) -> None:
        if not self._first.done():
            self._first.set_exception(DeviceError(reason))
