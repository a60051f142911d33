"""A Sensapex manipulator over UDP, spoken to by the event loop itself: no library, any operating system."""

import asyncio
from collections import deque
from collections.abc import Callable

from mrnav_server.core.errors import DeviceError, DeviceTimeoutError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.records import MotionCommand, TipReading
from mrnav_server.devices.sensapex.config import SensapexConfig
from mrnav_server.devices.sensapex.discovery import FoundController, new_link
from mrnav_server.devices.sensapex.endpoint import Endpoint
from mrnav_server.devices.sensapex.goto import goto
from mrnav_server.devices.sensapex.link import Heard
from mrnav_server.devices.sensapex.manipulator import Connect, SensapexManipulator
from mrnav_server.devices.sensapex.smcp1 import Kind, Option, Status
from mrnav_server.devices.sensapex.tip_record import TipRecord

_POLLS_UNDER_WAY = 2
_FIRST_READING_S = 0.5
_ROUND_TRIPS = 16


class UdpManipulator(SensapexManipulator["_Session"]):
    """The manipulator, over UDP.

    A move is on the wire before ``move_to`` returns. The position is asked for all the time; the reading in
    an answer is as old as its question, one that comes unasked as old as the longest round trip of late.
    """

    @property
    def counters(self) -> dict[str, int]:
        """What was exchanged since the manipulator was opened, by name (see ``Link``)."""
        return dict(self._session.link.counters) if self._session else {}

    def _connect(self) -> "Connect[_Session]":
        return lambda found, stop_path: _Session(self._config, self._clock, found)


class _Session:
    """One connection, from opening to closing."""

    def __init__(self, config: SensapexConfig, clock: Callable[[], float], found: FoundController) -> None:
        self.link = new_link(config.wire_id, config.timeout_s)
        self._name = f"manipulator {config.device_id}"
        self._to = (found.address, found.port)
        self._clock = clock
        self._poll_s = 1.0 / config.poll_hz
        self._beat_s = min(self._poll_s, config.timeout_s / 2)
        self._record = TipRecord(config.axes, self._name, config.silent_s)
        self._endpoint = Endpoint(self._on_datagram)
        self._timer: asyncio.TimerHandle | None = None
        self._first = asyncio.Event()
        self._next_poll_s = clock()
        self._round_trips_s: deque[float] = deque(maxlen=_ROUND_TRIPS)
        self._refused = False

    async def start(self) -> None:
        """Begin to ask for the position; return at the first reading."""
        await self._endpoint.open()
        self._beat()
        try:
            async with asyncio.timeout(_FIRST_READING_S):
                await self._first.wait()
        except TimeoutError:
            raise DeviceTimeoutError(
                f"{self._name} answered, but tells no position of the right number of axes: restart it"
            ) from None
        self._record.reading(self._clock())

    async def close(self) -> None:
        """End the exchange."""
        if self._timer is not None:
            self._timer.cancel()
        self._endpoint.close()

    def tip(self, now_s: float) -> TipReading:
        self._check(now_s)
        return self._record.reading(now_s)

    def move_to(self, target: StagePoint, speed_um_per_s: float, now_s: float) -> MotionCommand:
        self._check(now_s)
        move = goto(target, speed_um_per_s, self._record.newest, self._record.slack_um(now_s))
        self._endpoint.send(self.link.goto(move, now_s), self._to)
        self._record.on_goto(move.target)
        return MotionCommand(self._clock(), move.target, move.speed_um_per_s)

    def drop_moves(self) -> None:
        self.link.drop_moves()
        self._record.on_stop()
        self._refused = False

    def warnings(self, now_s: float) -> list[str]:
        return self._record.warnings(now_s) + self.link.loss.warnings(now_s)

    def _check(self, now_s: float) -> None:
        self._record.check(now_s)
        self._record.require_acknowledged(self.link.unacknowledged_s(now_s))
        if self._refused:
            raise DeviceError(f"{self._name} refused a move: see its touch screen")

    def _beat(self) -> None:
        """Ask for the position when it is time, and repeat what got no answer."""
        now_s = self._clock()
        for again in self.link.due(now_s):
            self._endpoint.send(again, self._to)
        if now_s >= self._next_poll_s - self._beat_s / 2 and self.link.waiting < _POLLS_UNDER_WAY:
            self._next_poll_s = max(self._next_poll_s + self._poll_s, now_s)
            self._endpoint.send(self.link.poll(now_s), self._to)
        self._timer = asyncio.get_running_loop().call_later(self._beat_s, self._beat)

    def _on_datagram(self, data: bytes, sender: str) -> None:
        if sender != self._to[0]:
            self.link.counters["foreign"] += 1
            return
        now_s = self._clock()
        heard = self.link.receive(data, now_s)
        if heard is None:
            return
        if heard.reply:
            self._endpoint.send(heard.reply, self._to)
        if heard.request is None:
            self._on_notification(heard, now_s)
        elif heard.message.options & Option.ERROR:
            self._refused |= heard.request.message.kind == Kind.GOTO
        elif heard.message.kind == Kind.GET_POSITIONS:
            asked_s = heard.request.first_s
            self._round_trips_s.append(now_s - asked_s)
            if self._take_position(heard, asked_s):
                self._record.on_answer(now_s)
                self._first.set()

    def _on_notification(self, heard: Heard, now_s: float) -> None:
        values = heard.message.values
        match heard.message.kind:
            case Kind.HELLO:
                self._record.on_hello(now_s)
            case Kind.POSITION if self._round_trips_s:
                late_s = max(*self._round_trips_s, self.link.waited_s(now_s))
                self._take_position(heard, now_s - late_s)
            case Kind.STATUS if values:
                self._record.on_status(Status(values[0]), now_s)
            case Kind.GOTO_DONE if values:
                self._record.on_completed(values[0], now_s)

    def _take_position(self, heard: Heard, taken_s: float) -> bool:
        return self._record.on_position([value_nm / 1000 for value_nm in heard.message.values], taken_s)
