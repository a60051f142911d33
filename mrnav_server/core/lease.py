"""Who controls the rig: one hand and one console at most, everybody else watches.

The console (a dashboard page) and the hand (a headset) may sit down in either order; each keeps its seat by
being heard. Time is passed in.
"""

from collections.abc import Callable
from dataclasses import dataclass

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.records import LeaseState


@dataclass(slots=True)
class _Seat:
    session: str
    client: str
    heard_s: float


class Lease:
    """The two seats of the rig's lease.

    Args:
        ttl_s: A seat not heard for this long is free again.
    """

    def __init__(self, ttl_s: float = 2.0) -> None:
        self._ttl_s = ttl_s
        self._console: _Seat | None = None
        self._hand: _Seat | None = None
        self._epoch = 0
        self._claimed = False
        self._displaced: set[str] = set()
        self.on_silent: Callable[[str], None] = lambda _: None
        """Told whose seat was freed by silence, by the name that people know."""
        self.on_hand_lost: Callable[[str, str, str], None] = lambda *_: None
        """Told the hand's session, a code and plain words, when its seat went to another or to silence."""

    @property
    def epoch(self) -> int:
        """Rises at every change of a seat."""
        return self._epoch

    @property
    def held(self) -> bool:
        """Whether anybody controls the rig; nobody does while somebody claims it."""
        return not self._claimed and (self._console is not None or self._hand is not None)

    def holds(self, session: str) -> bool:
        """Tell whether a session has a seat."""
        return any(seat is not None and seat.session == session for seat in (self._console, self._hand))

    def is_hand(self, session: str) -> bool:
        """Tell whether a session is the one hand that may move the magnet."""
        return self._hand is not None and self._hand.session == session

    def take_console(self, session: str, client: str, now_s: float) -> None:
        """Sit down at the console, or keep the seat.

        Raises:
            RefusedError: If another session sits there.
        """
        self._console = self._taken(self._console, session, client, now_s)

    def take_hand(self, session: str, client: str, now_s: float) -> None:
        """Become the rig's hand, or keep the seat.

        Raises:
            RefusedError: If another hand has it, or somebody took it from this one.
        """
        if session in self._displaced:
            raise RefusedError("displaced", "control was taken over: connect anew")
        self._hand = self._taken(self._hand, session, client, now_s)

    def hear(self, session: str, now_s: float) -> None:
        """Note that a session is alive."""
        for seat in (self._console, self._hand):
            if seat is not None and seat.session == session:
                seat.heard_s = now_s

    def console_heard_within(self, span_s: float, now_s: float) -> bool:
        """Tell whether the console was heard in the last ``span_s`` seconds."""
        return self._console is not None and now_s - self._console.heard_s <= span_s

    def give_back(self, session: str) -> None:
        """Free the seats of a session."""
        if self._console is not None and self._console.session == session:
            self._console = None
            self._epoch += 1
        if self._hand is not None and self._hand.session == session:
            self._hand = None
            self._epoch += 1

    def claim(self) -> None:
        """Suspend control: the rig holds, and the seats stay as they are until it rests.

        Raises:
            RefusedError: If somebody claims it already.
        """
        if self._claimed:
            raise RefusedError("busy", "somebody takes control over already: wait")
        self._claimed = True

    def withdraw(self) -> None:
        """Give up a claim: whoever has the seats is in control again."""
        self._claimed = False

    def displace(self, session: str, client: str, now_s: float) -> None:
        """Make good a claim: both seats are freed, and the claimant sits down at the console.

        A hand that loses its seat so does not sit down again before it says hello anew.
        """
        self._claimed = False
        hand = self._hand
        for seat in (self._console, hand):
            if seat is not None and seat.session != session:
                self._displaced.add(seat.session)
                self.give_back(seat.session)
        self.take_console(session, client, now_s)
        if hand is not None and hand is not self._hand:
            self.on_hand_lost(hand.session, "displaced", f"{client} took control over: connect anew")

    def expire(self, now_s: float) -> list[str]:
        """Free the seats that were silent too long; return their sessions."""
        seats, hand = (self._console, self._hand), self._hand
        silent = [seat for seat in seats if seat is not None and now_s - seat.heard_s > self._ttl_s]
        for seat in silent:
            self.give_back(seat.session)
            self.on_silent(seat.client)
            if seat is hand:
                reason = f"the hand was silent for {self._ttl_s:g} s: its seat is free for others"
                self.on_hand_lost(seat.session, "silent", reason)
        return [seat.session for seat in silent]

    def state(self) -> LeaseState:
        """Return the lease for clients."""
        seats = [seat for seat in (self._hand, self._console) if seat is not None]
        return LeaseState(
            epoch=self._epoch,
            holder=seats[0].session if seats else None,
            console=self._console.session if self._console else None,
            client=" and ".join(seat.client for seat in seats),
            hand=self._hand is not None,
        )

    def _taken(self, seat: _Seat | None, session: str, client: str, now_s: float) -> _Seat:
        if seat is None:
            self._epoch += 1
            return _Seat(session, client, now_s)
        if seat.session != session:
            raise RefusedError("lease_held", f"{seat.client} has control; it must give the lease back first")
        seat.heard_s = now_s
        return seat
