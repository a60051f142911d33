"""A device stop is repeated until the tip rests: one datagram may be lost, one reading may be old."""

import math

from mrnav_server.core.frames import StagePoint
from mrnav_server.core.records import TipReading

_REPEAT_S = 0.02
_SLACK_S = 0.004
"""Steps come every 10 ms, give or take: without it, some stops would be repeated only after 30 ms."""
_STILL_UM = 1.0
"""Two readings nearer than this are of one place."""
_WATCH_S = 2.0


class Stopping:
    """When to send the next stop. Told the time; sends nothing itself.

    Args:
        tip_age_s: A position older than this is unknown.
    """

    def __init__(self, tip_age_s: float) -> None:
        self._tip_age_s = tip_age_s
        self._began_s: float | None = None
        self._sent_s = -math.inf
        self._rested_s: float | None = None
        self._last: TipReading | None = None
        self._before: StagePoint | None = None

    @property
    def pending(self) -> bool:
        """Whether a stop was sent and the tip is not known to rest."""
        return self._began_s is not None and self._rested_s is None

    def begin(self, now_s: float) -> None:
        """Note that the first stop was sent now."""
        self._began_s = self._sent_s = now_s
        self._rested_s = None

    def end(self) -> None:
        """Send no more: the tip may move."""
        self._began_s = self._rested_s = None

    def due(self, tip: TipReading | None, now_s: float, *, latched: bool) -> bool:
        """Tell whether to send a stop now.

        Args:
            tip: The newest reading; None while the device gives none.
            now_s: Now.
            latched: Whether the rig waits for a reset. Until then a tip that rests is watched for 2 s more.
        """
        if self._began_s is None:
            return False
        if self._rests(tip, self._began_s, now_s):
            if self._rested_s is None:
                self._rested_s = now_s
            if not latched or now_s - self._rested_s >= _WATCH_S:
                self.end()
            return False
        self._rested_s = None
        if now_s - self._sent_s < _REPEAT_S - _SLACK_S:
            return False
        self._sent_s = now_s
        return True

    def _rests(self, tip: TipReading | None, began_s: float, now_s: float) -> bool:
        """Tell whether a fresh reading from after the stop says so, and the one before it too."""
        if tip is None or tip.taken_s <= began_s or now_s - tip.taken_s > self._tip_age_s:
            return False
        if self._last is None or tip.taken_s > self._last.taken_s:
            self._before = None if self._last is None else self._last.position
            self._last = tip
        if tip.moving or self._before is None:
            return False
        at, before = tip.position, self._before
        moved = (at.x_um - before.x_um, at.y_um - before.y_um, at.z_um - before.z_um)
        return math.hypot(*moved) <= _STILL_UM
