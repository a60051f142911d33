"""A page as the rig's hand: pointer, gamepad, keyboard or headset, over the page's own ``/ws/twin``.

It has the same seat, the same messages and the same checks as a headset on the hand link.
"""

import secrets
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Protocol

from mrnav_server.app.schemas import GiveHand, TakeHand
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.hand_stream import HandSample, HandStream
from mrnav_server.core.peer_limits import Strikes
from mrnav_server.core.wire import NumberError
from mrnav_server.core.wire_hand import ClientFrame, HandMessage, Hello, parse_message

_TWIN_HZ = 60.0

Tell = Callable[[bool, str, str], None]
"""Told whether the page has the hand's seat, with a code and plain words."""


class Seat(Protocol):
    """The rig's side of a hand: who may be it, and what its samples do."""

    @property
    def transform(self) -> Mapping[str, object]:
        """How the rig maps the hand's motion."""

    @property
    def counters(self) -> Counter[str]:
        """Counts of messages by what became of them."""

    def now_s(self) -> float:
        """Return the rig's time, in seconds."""

    def acquire(self, session: str, hello: Hello, tell: Tell) -> None:
        """Make a session the hand, or raise RefusedError."""

    def take(self, sample: HandSample) -> None:
        """Take an accepted sample."""

    def on_bad_numbers(self, session: str) -> None:
        """Told that the numbers of a session measure nothing."""

    def leave(self, session: str) -> None:
        """Free the seat of a session."""


class PageHand:
    """The hand of one page's connection.

    Args:
        seat: The rig's side.
        tell: Told when the seat is lost later, or regained.
    """

    def __init__(self, seat: Seat, tell: Tell) -> None:
        self._seat = seat
        self._tell = tell
        self._session = ""
        self._frame = ClientFrame.STAGE
        self._seated = False
        self._stream = HandStream("", seat.counters)
        self._bad_numbers = Strikes()

    @property
    def session(self) -> str:
        """The hand's session; "" while this page is not the rig's hand."""
        return self._session if self._seated else ""

    def answer(self, message: TakeHand | GiveHand) -> dict[str, object]:
        """Sit down or get up, and return the answer for the page."""
        self.leave()
        if isinstance(message, GiveHand):
            return lease_fields(False, "given_back", "")
        try:
            self._sit_down(message)
        except RefusedError as refused:
            return lease_fields(False, refused.code, str(refused))
        return {**lease_fields(True, "ok", ""), "transform": dict(self._seat.transform)}

    def leave(self) -> None:
        """Give the seat back, if it is this page's."""
        if self._session:
            self._seat.leave(self._session)
        self._session, self._seated = "", False

    def take(self, line: bytes) -> None:
        """Take a ``hand`` message, in the call that received it.

        Raises:
            WireError: If it breaks the protocol.
        """
        if not self._session:
            self._seat.counters["hand_without_seat"] += 1
            return
        now_s = self._seat.now_s()
        try:
            message = parse_message(line, self._frame)
        except NumberError:
            self._seat.counters["non_finite"] += 1
            if self._bad_numbers.strike(now_s):
                self._seat.on_bad_numbers(self._session)
            return
        sample = self._stream.take(message, now_s) if isinstance(message, HandMessage) else None
        if sample is not None:
            self._seat.take(sample)

    def _sit_down(self, wish: TakeHand) -> None:
        """Become the rig's hand under a new session: one that was displaced may come back so."""
        session, self._frame = f"hand-{secrets.token_hex(6)}", ClientFrame(wish.frame)
        hello = Hello("operator", "", wish.client, self._frame, _TWIN_HZ, simulated=False)
        self._seat.acquire(session, hello, self._told)
        self._session, self._seated = session, True
        self._stream = HandStream(session, self._seat.counters)

    def _told(self, lease: bool, code: str, message: str) -> None:
        self._seated = lease
        self._tell(lease, code, message)


def lease_fields(lease: bool, code: str, message: str) -> dict[str, object]:
    """Return what tells a page whether it is the rig's hand."""
    return {"type": "lease", "lease": lease, "code": code, "message": message}
