"""The rig's side of the hand link: who may be the hand, and what its samples do."""

from collections import Counter
from collections.abc import Callable, Mapping

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.hand import HandControl
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.lease import Lease
from mrnav_server.core.wire_hand import Hello
from mrnav_server.loops.trial_fields import hand_fields

Announce = Callable[[str, Mapping[str, object]], None]
Tell = Callable[[bool, str, str], None]
"""Tells a hand over its own connection whether it has the seat, with a code and plain words."""


class HandSeat:
    """Admits one hand link as the rig's hand and passes its samples on.

    Args:
        lease: Has one seat for a hand.
        hand: Takes the samples.
        step: Runs the control loop at once, given when the sample's line arrived, in seconds, if one did.
        hold: Asks for HOLD if the rig is armed.
        on_message: Told every sample of the holder, for the measured rates.
        announce: Tells everybody what happened, and records it.
        record: Notes a payload under a topic in the running trial's log.
        clock: Monotonic time in seconds.
        transform: How the rig maps the hand's motion, for hands to know.
    """

    def __init__(
        self,
        lease: Lease,
        hand: HandControl,
        step: Callable[[float | None], None],
        hold: Callable[[], None],
        on_message: Callable[[HandSample], None],
        announce: Announce,
        record: Callable[[str, Mapping[str, object]], None],
        clock: Callable[[], float],
        transform: Mapping[str, object],
    ) -> None:
        self.transform = transform
        self.counters: Counter[str] = Counter()
        self._lease = lease
        self._hand = hand
        self._step = step
        self._hold = hold
        self._announce = announce
        self._record = record
        self._clock = clock
        self._on_message = on_message
        self._last: tuple[str, str] | None = None
        self._tell: dict[str, Tell] = {}
        lease.on_hand_lost = self._on_lost
        self._trouble = ""

    def now_s(self) -> float:
        """Return the rig's time, in seconds."""
        return self._clock()

    def acquire(self, session: str, hello: Hello, tell: Tell) -> None:
        """Make a session the hand.

        Args:
            session: Unique; a session that was displaced does not come back.
            hello: Who it is.
            tell: Told when the seat is lost later, or regained.

        Raises:
            RefusedError: While another hand has the seat.
        """
        self._sit(session, hello.client or "hand")
        self._tell[session] = tell

    def take(self, sample: HandSample) -> None:
        """Let an accepted sample of the holder move the rig; anybody else's moves nothing."""
        if not self._lease.is_hand(sample.session) and not self._returns(sample.session):
            return
        self._lease.hear(sample.session, self._clock())
        self._on_message(sample)
        self._hand.on_sample(sample)
        self._record("hand", hand_fields(sample))
        self._tell_trouble(sample.received_s)
        self._step(sample.received_s)

    def choose_scale(self, session: str, scale: str) -> None:
        """Choose the scale for the holder.

        Raises:
            RefusedError: For anybody else, another scale, or a closed clutch.
        """
        if not self._lease.is_hand(session):
            raise RefusedError("not_the_hand", "another hand controls the rig: it chooses the scale")
        self._hand.choose_scale(scale)
        self._announce("hand", {"scale": self._hand.scale, "gain": self._hand.gain})

    def on_bad_numbers(self, session: str) -> None:
        """Hold: the holder keeps sending numbers that measure nothing."""
        if self._lease.is_hand(session):
            self._hold()
            self._announce("fault", {"reason": "the hand sends numbers that are not finite: holding"})

    def leave(self, session: str) -> None:
        """Free the seat: the link has ended."""
        self._tell.pop(session, None)
        if self._last is not None and self._last[0] == session:
            self._last = None
        if self._lease.is_hand(session):
            self._hand.lose()
            self._record("hand_left", {})
            self._lease.give_back(session)
            # The rig holds before anybody else may sit down.
            self._step(None)
            self._tell_lease()

    def _sit(self, session: str, client: str) -> None:
        self._lease.take_hand(session, client, self._clock())
        self._last = (session, client)
        self._tell_lease()

    def _returns(self, session: str) -> bool:
        """Let a link whose seat was freed by its silence sit down again, unless somebody else did."""
        if self._last is None or self._last[0] != session:
            return False
        try:
            self._sit(*self._last)
        except RefusedError:
            return False
        if session in self._tell:
            self._tell[session](True, "ok", "")
        return True

    def _on_lost(self, session: str, code: str, reason: str) -> None:
        if session in self._tell:
            self._tell[session](False, code, reason)

    def _tell_trouble(self, now_s: float) -> None:
        """Tell once what is wrong with the hand, and hold if it keeps jumping."""
        if self._hand.take_jumping():
            self._hold()
        trouble = self._hand.trouble(now_s)
        if trouble and trouble != self._trouble:
            self._announce("fault", {"reason": trouble})
        self._trouble = trouble

    def _tell_lease(self) -> None:
        self._announce("lease", {"epoch": self._lease.epoch, "client": self._lease.state().client})
