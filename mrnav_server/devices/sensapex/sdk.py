"""A Sensapex manipulator through the vendor's C library (Linux x86_64, extra ``sensapex``)."""

import asyncio
import contextlib
import math
from collections.abc import Callable

from mrnav_server.core.errors import DeviceError, DeviceTimeoutError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.records import MotionCommand, TipReading
from mrnav_server.devices.sensapex.config import SensapexConfig
from mrnav_server.devices.sensapex.discovery import find
from mrnav_server.devices.sensapex.goto import goto
from mrnav_server.devices.sensapex.loss import LossRate
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


class SdkManipulator:
    """The manipulator; use it from the event loop's thread. ``stop_path.send`` may be called from any.

    One thread calls the library: the newest move, and the position in between. STOP does not pass through it.

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
        self.stop_path: RawStop | None = None
        """The way of STOP, once the manipulator was opened."""
        self._config = config
        self._clock = clock
        self._load = load
        self._session: _Session | None = None

    async def open(self) -> None:
        """Find the manipulator, check its axes and take a first reading; nothing moves.

        Raises:
            DeviceError: If the library is missing, or the manipulator does not answer, has other axes or lost
                its calibration, with the remedy.
        """
        await self.close()
        library = self._load()
        found = await find(self._config, self._clock)
        self.stop_path = RawStop(found.address, found.port, self._config.wire_id)
        session = _Session(self._config, self._clock, library, found.address, self.stop_path)
        try:
            await session.start()
        except BaseException:
            await session.close()
            self.stop_path.close()
            self.stop_path = None
            raise
        self._session = session

    async def close(self) -> None:
        """Stop the manipulator and give library and sockets back."""
        self.stop()
        if self._session is not None:
            await self._session.close()
            self._session = None
        if self.stop_path is not None:
            self.stop_path.close()
            self.stop_path = None

    def tip(self) -> TipReading:
        """Return the newest reading. Never waits.

        Raises:
            DeviceError: If the manipulator is silent, does not acknowledge moves, reports an error or lost
                its calibration, or the library's thread has ended.
        """
        return self._require_open().tip(self._clock())

    def move_to(self, target: StagePoint, speed_um_per_s: float, now_s: float) -> MotionCommand:
        """Have an absolute target sent; it replaces the one that waits. Never waits.

        Returns:
            What goes out: the target as the library rounds it, the speed in whole µm/s; sent when the thread
            got it.

        Raises:
            DeviceError: As ``tip``; or if target or speed are not finite or out of range.
        """
        return self._require_open().move_to(target, speed_um_per_s, self._clock())

    def stop(self) -> None:
        """Stop all axes now; nothing moves from then on until the next ``move_to``."""
        # First, and without a lock: a move that the thread begins after the STOP must know that it is void.
        if self._session is not None:
            self._session.drop_moves()
        if self.stop_path is not None:
            self.stop_path.send()

    def warnings(self) -> list[str]:
        """Return what the operator should know, in plain sentences."""
        return self._session.warnings(self._clock()) if self._session else []

    def _require_open(self) -> "_Session":
        if self._session is None:
            raise DeviceError(f"manipulator {self._config.device_id} is not open: open it first")
        return self._session


class _Session:
    """One handle of the library, from opening to closing. All but the worker's calls happens in the loop."""

    def __init__(
        self,
        config: SensapexConfig,
        clock: Callable[[], float],
        library: Library,
        address: str,
        stop_path: RawStop,
    ) -> None:
        self._config = config
        self._clock = clock
        self._name = f"manipulator {config.device_id}"
        self._record = TipRecord(config.axes, self._name, config.silent_s)
        self._loss = LossRate()
        self._loop = asyncio.get_running_loop()
        self._first: asyncio.Future[None] = self._loop.create_future()
        self._worker = SdkWorker(config, address, clock, library, stop_path, self._publish)
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
