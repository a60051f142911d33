"""A Sensapex manipulator, whoever speaks to it: a session with its controller, and STOP beside that."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.records import MotionCommand, TipReading
from mrnav_server.devices.sensapex.config import SensapexConfig
from mrnav_server.devices.sensapex.discovery import FoundController, find
from mrnav_server.devices.sensapex.raw_stop import RawStop


class Session(Protocol):
    """One connection with a controller, from opening to closing."""

    async def start(self) -> None:
        """Begin to ask for the position; return at the first reading.

        Raises:
            DeviceError: If there is none, with the remedy.
        """

    async def close(self) -> None:
        """End the exchange."""

    def tip(self, now_s: float) -> TipReading:
        """Return the newest reading. Never waits.

        Raises:
            DeviceError: If the manipulator has failed.
        """

    def move_to(self, target: StagePoint, speed_um_per_s: float, now_s: float) -> MotionCommand:
        """Send an absolute target, or have it sent. Never waits.

        Raises:
            DeviceError: As ``tip``; or if target or speed are not finite or out of range.
        """

    def drop_moves(self) -> None:
        """Send no move again that was asked for so far. Never raises."""

    def warnings(self, now_s: float) -> list[str]:
        """Return what the operator should know, in plain sentences."""


SessionT = TypeVar("SessionT", bound=Session)
Connect = Callable[[FoundController, RawStop], SessionT]


class SensapexManipulator(ABC, Generic[SessionT]):
    """The manipulator; use it from the event loop's thread. ``stop_path.send`` may be called from any.

    Args:
        config: Which manipulator.
        clock: Monotonic time in seconds.
    """

    def __init__(self, config: SensapexConfig, clock: Callable[[], float]) -> None:
        self.stop_path: RawStop | None = None
        """The way of STOP, once the manipulator was opened."""
        self._config = config
        self._clock = clock
        self._session: SessionT | None = None

    @abstractmethod
    def _connect(self) -> Connect[SessionT]:
        """Return what makes a session.

        Raises:
            DeviceError: If this computer lacks what a session needs, with the remedy.
        """

    async def open(self) -> None:
        """Find the manipulator, check its axes and take a first reading; nothing moves.

        Raises:
            DeviceError: If this computer cannot speak to it, or it does not answer, has other axes or lost
                its calibration, with the remedy.
        """
        await self.close()
        connect = self._connect()
        found = await find(self._config, self._clock)
        stop_path = RawStop(found.address, found.port, self._config.wire_id)
        session = connect(found, stop_path)
        try:
            await session.start()
        except BaseException:
            await session.close()
            stop_path.close()
            raise
        self.stop_path, self._session = stop_path, session

    async def close(self) -> None:
        """Stop the manipulator and give back what it was reached by."""
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
            DeviceError: If the manipulator is silent, refuses or does not acknowledge moves, has started
                anew, reports an error or lost its calibration.
        """
        return self._require_open().tip(self._clock())

    def move_to(self, target: StagePoint, speed_um_per_s: float, now_s: float) -> MotionCommand:
        """Have an absolute target sent; it replaces the one before. Never waits.

        Returns:
            What goes out: the target rounded to nm, the speed in whole µm/s.

        Raises:
            DeviceError: As ``tip``; or if target or speed are not finite or out of range.
        """
        return self._require_open().move_to(target, speed_um_per_s, self._clock())

    def stop(self) -> None:
        """Stop all axes now; nothing moves from then on until the next ``move_to``."""
        # Dropped first, and without a lock: a move that a thread begins after the STOP must know it is void.
        if self._session is not None:
            self._session.drop_moves()
        if self.stop_path is not None:
            self.stop_path.send()

    def warnings(self) -> list[str]:
        """Return what the operator should know, in plain sentences."""
        return self._session.warnings(self._clock()) if self._session else []

    def _require_open(self) -> SessionT:
        if self._session is None:
            raise DeviceError(f"manipulator {self._config.device_id} is not open: open it first")
        return self._session
