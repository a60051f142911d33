"""The rig's side of the hand link: who may be the hand, and what its samples do."""

from collections.abc import Callable, Mapping

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.hand import HandControl
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.lease import Lease
from mrnav_server.core.wire_hand import Hello

Announce = Callable[[str, Mapping[str, object]], None]


class HandSeat:
    """Admits one hand link as the rig's hand and passes its samples on.

    Args:
        lease: Has one seat for a hand.
        hand: Takes the samples.
        step: Runs the control loop at once, given the arrival of the sample's line in seconds.
        hold: Asks for HOLD if the rig is armed.
        on_message: Told every sample of the holder, for the measured rates.
        announce: Tells everybody what happened, and records it.
        record: Notes a payload under a topic in the running trial's log.
        clock: Monotonic time in seconds.
    """

    def __init__(
        self,
        lease: Lease,
        hand: HandControl,
        step: Callable[[float], None],
        hold: Callable[[], None],
        on_message: Callable[[HandSample], None],
        announce: Announce,
        record: Callable[[str, Mapping[str, object]], None],
        clock: Callable[[], float],
    ) -> None:
        self._lease = lease
        self._hand = hand
        self._step = step
        self._hold = hold
        self._announce = announce
        self._record = record
        self._clock = clock
        self._on_message = on_message

    def acquire(self, session: str, hello: Hello) -> bool:
        """Make a session the hand; tell whether it is."""
        try:
            self._lease.take_hand(session, hello.client or "hand", self._clock())
        except RefusedError:
            return False
        self._tell_lease()
        return True

    def take(self, sample: HandSample) -> None:
        """Let an accepted sample of the holder move the rig; anybody else's moves nothing."""
        if not self._lease.is_hand(sample.session):
            return
        self._lease.hear(sample.session, self._clock())
        self._on_message(sample)
        self._hand.on_sample(sample)
        point = sample.point
        self._record(
            "hand",
            {
                "seq": sample.seq,
                "sender_s": sample.sender_t_s,
                "received_s": sample.received_s,
                "p_m": [round(point.x_m, 6), round(point.y_m, 6), round(point.z_m, 6)],
                "clutch": sample.clutch,
                "valid": sample.valid,
                "new_pose": sample.new_pose,
            },
        )
        self._step(sample.received_s)

    def on_bad_numbers(self, session: str) -> None:
        """Hold: the holder keeps sending numbers that measure nothing."""
        if self._lease.is_hand(session):
            self._hold()
            self._announce("fault", {"reason": "the hand sends numbers that are not finite: holding"})

    def leave(self, session: str) -> None:
        """Free the seat: the link has ended."""
        if self._lease.is_hand(session):
            self._hand.lose()
            self._lease.give_back(session)
            self._tell_lease()

    def _tell_lease(self) -> None:
        self._announce("lease", {"epoch": self._lease.epoch, "client": self._lease.state().client})
