"""Counts wall contacts as events, live and in the study. Time is passed in."""

import math

from mrnav_server.core.arrays import FloatArray

REARM_CLEARANCE_UM = 20.0
REARM_S = 0.2


class ContactCounter:
    """A contact begins at clearance ≤ 0 and is over after more than 20 µm for 0.2 s.

    Source: study metric (e), collisions.
    """

    def __init__(self) -> None:
        self._count = 0
        self._touching = False
        self._clear_since_s: float | None = None

    @property
    def count(self) -> int:
        """Contacts so far."""
        return self._count

    def step(self, clearance_um: float | None, now_s: float) -> bool:
        """Take one tracked position; tell whether a contact begins with it.

        Args:
            clearance_um: Gap between the robot's rim and the wall; None or NaN where the robot is not seen,
                which neither begins a contact nor helps to end one.
            now_s: When, in seconds, never falling.
        """
        if clearance_um is None or math.isnan(clearance_um):
            self._clear_since_s = None
            return False
        if self._touching:
            self._rearm(clearance_um, now_s)
        if clearance_um > 0.0 or self._touching:
            return False
        self._touching = True
        self._clear_since_s = None
        self._count += 1
        return True

    def _rearm(self, clearance_um: float, now_s: float) -> None:
        if clearance_um <= REARM_CLEARANCE_UM:
            self._clear_since_s = None
        elif self._clear_since_s is None:
            self._clear_since_s = now_s
        elif now_s - self._clear_since_s >= REARM_S:
            self._touching = False


def contact_starts(t_s: FloatArray, clearance_um: FloatArray) -> list[int]:
    """Return the samples at which a wall contact begins; their number is C.

    Args:
        t_s: Shape (n,), rising.
        clearance_um: Gap between the robot's rim and the wall, shape (n,); NaN where unknown.

    Source: study metric (e), collisions C.
    """
    counter = ContactCounter()
    return [
        index
        for index, (now_s, gap_um) in enumerate(zip(t_s.tolist(), clearance_um.tolist(), strict=True))
        if counter.step(gap_um, now_s)
    ]
