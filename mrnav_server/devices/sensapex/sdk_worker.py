"""The one thread that calls the vendor's library: the newest move, and the position in between."""

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from mrnav_server.core.errors import DeviceError
from mrnav_server.devices.sensapex.config import SensapexConfig
from mrnav_server.devices.sensapex.goto import Goto
from mrnav_server.devices.sensapex.raw_stop import RawStop

_FIRST_SERIAL = 0x1000
UNDER_WAY = 1
"""What ``Library.drives`` says of a move that has not ended."""


class Library(Protocol):
    """What the worker calls; see ``SdkLibrary``."""

    def open(self, address: str, group: int, timeout_ms: int) -> None:
        """Make a handle."""

    def close(self) -> None:
        """Give the handle back."""

    def list_devices(self) -> list[int]:
        """Look for devices."""

    def axis_count(self, device_id: int) -> int:
        """Ask for the number of axes."""

    def position_um(self, device_id: int, axes: int) -> tuple[float, ...]:
        """Ask for the position."""

    def status(self, device_id: int) -> int:
        """Return the status that was heard last."""

    def drives(self, device_id: int) -> int:
        """Return 1 while a move is under way, 0 after its end, −1 if it failed."""

    def goto(self, device_id: int, move: Goto) -> None:
        """Send a move and wait for its acknowledgement."""


@dataclass(frozen=True, slots=True)
class Ready:
    """The library talks to the device.

    Attributes:
        axes: How many axes it reports.
    """

    axes: int


@dataclass(frozen=True, slots=True)
class Position:
    """The device answered a question for its position.

    Attributes:
        position_um: One value for each axis.
        status: The status that was heard last.
        drive: What the library takes the newest move to be: 1 under way, 0 ended, −1 failed.
    """

    position_um: tuple[float, ...]
    status: int
    drive: int


@dataclass(frozen=True, slots=True)
class Moved:
    """The device acknowledged a move."""

    move: Goto


@dataclass(frozen=True, slots=True)
class Failed:
    """A call failed.

    Attributes:
        call: What was asked.
        reason: The library's words.
    """

    call: str
    reason: str


@dataclass(frozen=True, slots=True)
class Report:
    """The outcome of one call.

    Attributes:
        began_s: When the call began, monotonic, in seconds.
        ended_s: When it returned.
        outcome: What came of it.
    """

    began_s: float
    ended_s: float
    outcome: Ready | Position | Moved | Failed


class SdkWorker:
    """Calls the library until it is told to end.

    A STOP makes the move that waits void. A call that is on its way when the STOP goes out may still put its
    move on the wire after it; the worker then sends a second STOP as soon as the call returns.

    Args:
        config: Which manipulator.
        address: Its IPv4 address.
        clock: Monotonic time in seconds.
        library: The vendor's library.
        stop_path: The way of STOP.
        publish: Called with every report, from the worker's thread.
    """

    def __init__(
        self,
        config: SensapexConfig,
        address: str,
        clock: Callable[[], float],
        library: Library,
        stop_path: RawStop,
        publish: Callable[[Report], None],
    ) -> None:
        self._config = config
        self._address = address
        self._clock = clock
        self._library = library
        self._stop_path = stop_path
        self._publish = publish
        self._slot: deque[tuple[Goto, object]] = deque(maxlen=1)
        self._wake = threading.Event()
        self._era = object()
        """Changes with every STOP; a move belongs to the era in which it was asked for."""
        self._ending = False
        # A daemon: a library that never returns must not keep the process alive either.
        self._thread = threading.Thread(target=self._run, name="sensapex", daemon=True)

    @property
    def alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def move(self, move: Goto) -> None:
        """Have a move sent, in place of the one that waits. Never waits."""
        self._slot.append((move, self._era))
        self._wake.set()

    def drop_moves(self) -> None:
        """Make every move void that was asked for before. Never waits, takes no lock."""
        self._era = object()

    def end(self, timeout_s: float) -> None:
        """Have the handle given back; wait for it, but not for longer than told."""
        self._ending = True
        self._wake.set()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        if self._call("the vendor's library", self._open):
            try:
                self._serve()
            finally:
                self._library.close()

    def _open(self) -> Ready:
        config = self._config
        self._library.open(self._address, config.group, config.timeout_ms)
        if config.device_id >= _FIRST_SERIAL:
            # The library knows no address of such a device before it has looked for devices.
            self._library.list_devices()
        return Ready(self._library.axis_count(config.device_id))

    def _serve(self) -> None:
        next_read_s = self._clock()
        while not self._ending:
            self._wake.clear()
            if self._clock() >= next_read_s:
                next_read_s = max(next_read_s + 1.0 / self._config.poll_hz, self._clock())
                self._call("its position", self._read)
            if self._slot:
                self._send_newest()
            else:
                self._wake.wait(max(next_read_s - self._clock(), 0.0))

    def _read(self) -> Position:
        device_id = self._config.device_id
        position_um = self._library.position_um(device_id, self._config.axes)
        return Position(position_um, self._library.status(device_id), self._library.drives(device_id))

    def _send_newest(self) -> None:
        move, era = self._slot.popleft()
        if era is not self._era:
            return
        try:
            self._call("a move", lambda: self._goto(move))
        finally:
            if era is not self._era:
                self._stop_path.send()

    def _goto(self, move: Goto) -> Moved:
        self._library.goto(self._config.device_id, move)
        return Moved(move)

    def _call(self, name: str, call: Callable[[], Ready | Position | Moved]) -> bool:
        began_s = self._clock()
        outcome: Ready | Position | Moved | Failed
        try:
            outcome = call()
        except DeviceError as error:
            outcome = Failed(name, str(error))
        self._publish(Report(began_s, self._clock(), outcome))
        return not isinstance(outcome, Failed)
