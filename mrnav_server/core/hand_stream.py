"""Which messages of one hand connection count: order, age and repeated poses. Time is passed in."""

import math
from collections import Counter
from dataclasses import dataclass

from mrnav_server.core.frames import HandPoint
from mrnav_server.core.wire_hand import HandMessage, Increment

MAX_AGE_S = 0.1
_CLOCK_DRIFT = 200e-6
"""How much faster one clock may run than the other; keeps a long session from looking stale."""


@dataclass(frozen=True, slots=True)
class HandSample:
    """One accepted hand message.

    Attributes:
        session: The connection it came over.
        seq: The sender's number.
        sender_t_s: The sender's own clock, in seconds.
        received_s: Arrival, monotonic, in seconds.
        point: Cumulative fingertip position.
        clutch: Whether the operator's clutch is closed.
        valid: Whether the headset sees the hand.
        new_pose: False when the headset repeated its last pose: no motion, not new data.
    """

    session: str
    seq: int
    sender_t_s: float
    received_s: float
    point: HandPoint
    clutch: bool
    valid: bool
    new_pose: bool


class HandStream:
    """Turns one connection's messages into samples; loss, duplication and reordering cannot drift.

    A message's age is estimated as receive time − sender's time − the smallest such difference seen: the
    clocks need no common zero, and a message that waited in the network shows.

    Args:
        session: Named in every sample.
        counters: Counts ``hand_out_of_order`` and ``hand_stale``.
    """

    def __init__(self, session: str, counters: Counter[str]) -> None:
        self._session = session
        self._counters = counters
        self._seq = -1
        self._offset_s = math.inf
        self._offset_taken_s = 0.0
        self._point = HandPoint(0.0, 0.0, 0.0)
        self._pose: int | None = None
        self._pose_t_s = -math.inf
        self._empty = True

    def take(self, message: HandMessage | Increment, received_s: float) -> HandSample | None:
        """Return the message as a sample, or None if it does not count.

        Args:
            message: As parsed.
            received_s: Arrival, monotonic, in seconds; never falls.
        """
        if message.seq <= self._seq:
            self._counters["hand_out_of_order"] += 1
            return None
        self._seq = message.seq
        if self._age_s(message.t_s, received_s) > MAX_AGE_S:
            self._counters["hand_stale"] += 1
            return None
        point, new_pose = self._pose_of(message)
        return HandSample(
            session=self._session,
            seq=message.seq,
            sender_t_s=message.t_s,
            received_s=received_s,
            point=point,
            clutch=message.clutch,
            valid=message.valid,
            new_pose=new_pose,
        )

    def _age_s(self, sender_t_s: float, received_s: float) -> float:
        offset_s = received_s - sender_t_s
        allowed_s = _CLOCK_DRIFT * (received_s - self._offset_taken_s)
        self._offset_s = min(offset_s, self._offset_s + allowed_s)
        self._offset_taken_s = received_s
        return offset_s - self._offset_s

    def _pose_of(self, message: HandMessage | Increment) -> tuple[HandPoint, bool]:
        """Return the cumulative position and whether it is a new pose of the headset's tracker."""
        before = self._point
        if isinstance(message, Increment):
            if message.valid:
                step = message.step
                self._point = HandPoint(before.x_m + step.x_m, before.y_m + step.y_m, before.z_m + step.z_m)
            number = None
        else:
            self._point, number = message.point, message.pose
        if number is not None:
            new = number != self._pose
        else:
            # Without numbers a repeat shows as the same source time or the very same position.
            new = message.t_s != self._pose_t_s and self._point != before
        new, self._empty = new or self._empty, False
        if new:
            self._pose, self._pose_t_s = number, message.t_s
        return self._point, new
