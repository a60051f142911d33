"""Carries a wish out: limits it, shapes it, and sends the manipulator no further than it may go.

The only caller of ``move_to``; of ``stop``, together with the STOP button, which waits for nobody.
"""

import math
from collections.abc import Callable
from typing import Any

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.frames import Calibration, StagePoint
from mrnav_server.core.limits import Limits, allowed_target, require_finite
from mrnav_server.core.modes import Mode
from mrnav_server.core.records import MotionCommand, TipReading
from mrnav_server.core.shaping import Reference, Shaper
from mrnav_server.core.vessel import VesselMap
from mrnav_server.devices.base import Manipulator
from mrnav_server.loops.guards import GuardConfig
from mrnav_server.loops.tip_watch import TipWatch

Log = Callable[[str, dict[str, Any]], None]

_SETTLE_S = 0.5
"""A tip that has not come to rest this long after its setpoint counts as noise, or is driven by hand."""
_EDGE_UM = 10.0
"""The setpoint may come to rest this far outside; what is sent stays inside."""


class Drive:
    """The setpoint and the manipulator that is led along it.

    Args:
        limits: Bounds on motion.
        guards: Bounds on what the tip may do.
        manipulator: Open before the first command.
        calibration: Frames and heights.
        vessel: The vessel model.
        log: Called with a topic and a payload for every command.
    """

    def __init__(
        self,
        limits: Limits,
        guards: GuardConfig,
        manipulator: Manipulator,
        calibration: Calibration,
        vessel: VesselMap,
        log: Log,
    ) -> None:
        self.shaper = Shaper(limits)
        self.counters = {"commands": 0, "clamped": 0, "non_finite": 0, "held_back": 0}
        self.fault = ""
        """Why the last command could not be sent, or ""; for whoever latches it to clear."""
        self.elsewhere: Callable[[StagePoint], StagePoint] | None = None
        """Where the tip may be instead of where the calibration allows it."""
        self._limits = limits
        self._manipulator = manipulator
        self._calibration = calibration
        self._vessel = vessel
        self._log = log
        self._watch = TipWatch(guards)
        self._moved_s = -math.inf

    def recalibrate(self, calibration: Calibration) -> None:
        """Go by another calibration; while nothing moves."""
        self._calibration = calibration

    def begin(self, tip: TipReading) -> None:
        """Take the tip up where it is."""
        self.shaper.reset(tip.position)
        self._watch.begin(tip)

    def at_rest(self, tip: TipReading | None, now_s: float) -> bool:
        """Tell whether setpoint and tip stand still."""
        if not self.shaper.at_rest:
            self._moved_s = now_s
            return False
        return tip is None or not tip.moving or now_s - self._moved_s > _SETTLE_S

    def disobedience(self, tip: TipReading) -> str:
        """Return how the tip does not do what it was told, or ""."""
        return self._watch.fault(tip)

    def limited(self, wish: Reference) -> Reference | None:
        """Return a wish within every limit; None for one that is not a number."""
        if not wish.finite:
            self.counters["non_finite"] += 1
            return None
        rest = self.shaper.rest_point
        kept = self._allowed(rest)
        if _distance_um(kept, rest) > _EDGE_UM:
            # Whoever waits until the setpoint is at the edge can no longer stop there: aim back inside.
            target = _mirrored(rest, kept)
        else:
            target = self._allowed(wish.position)
        if target == wish.position:
            return wish
        self.counters["clamped"] += 1
        return Reference(target, (0.0, 0.0, 0.0), wish.speed_um_per_s)

    def follow(
        self, dt_s: float, reference: Reference | None, tip: TipReading, now_s: float, mode: Mode
    ) -> MotionCommand | None:
        """Advance the setpoint and send it; None if it stands still or could not be sent (``fault``).

        Args:
            dt_s: Since the last step.
            reference: Limited; None to come to rest.
            tip: The newest reading.
            now_s: Now.
            mode: For the log.
        """
        before = self.shaper.position
        top_um_per_s = max(self._limits.speed_um_per_s, self._limits.autonomy_speed_um_per_s)
        ahead_um = top_um_per_s * self._limits.ahead_s
        if reference is not None and _distance_um(before, tip.position) > ahead_um:
            self.counters["held_back"] += 1
            reference = None
        wished = self.shaper.step(dt_s, reference)
        if wished == before:
            return None
        target = self._allowed(_towards(wished, tip.position, ahead_um))
        gap_um = _distance_um(target, tip.position)
        # Fast enough to close the gap in half the time that the setpoint may be ahead.
        speed_um_per_s = min(
            max(self.shaper.speed_um_per_s + 2.0 * gap_um / self._limits.ahead_s, 50.0), 1.2 * top_um_per_s
        )
        try:
            sent = self._manipulator.move_to(target, speed_um_per_s, now_s)
        except DeviceError as error:
            self.fault = f"manipulator: {error}"
            self._log("command_failed", {"setpoint_um": _xyz(wished), "reason": self.fault})
            return None
        self._watch.sent(sent)
        self.counters["commands"] += 1
        self._log(
            "command",
            {
                "sent_s": sent.sent_s,
                "setpoint_um": _xyz(wished),
                "asked_um": _xyz(target),
                "asked_um_per_s": speed_um_per_s,
                "target_um": _xyz(sent.target),
                "speed_um_per_s": sent.speed_um_per_s,
                "ahead_ms": round(1000.0 * gap_um / sent.speed_um_per_s, 2),
                "mode": mode.value,
            },
        )
        return sent

    def _allowed(self, point: StagePoint) -> StagePoint:
        if self.elsewhere is not None:
            return self.elsewhere(require_finite(point))
        return allowed_target(point, self._limits, self._calibration, self._vessel)


def _xyz(point: StagePoint) -> tuple[float, float, float]:
    return (point.x_um, point.y_um, point.z_um)


def _distance_um(a: StagePoint, b: StagePoint) -> float:
    return math.hypot(a.x_um - b.x_um, a.y_um - b.y_um, a.z_um - b.z_um)


def _mirrored(point: StagePoint, at: StagePoint) -> StagePoint:
    return StagePoint(2 * at.x_um - point.x_um, 2 * at.y_um - point.y_um, 2 * at.z_um - point.z_um)


def _towards(target: StagePoint, tip: StagePoint, most_um: float) -> StagePoint:
    """Return the target, or the place on the way there that is ``most_um`` from the tip."""
    gap_um = _distance_um(target, tip)
    if gap_um <= most_um:
        return target
    share = most_um / gap_um
    return StagePoint(
        tip.x_um + share * (target.x_um - tip.x_um),
        tip.y_um + share * (target.y_um - tip.y_um),
        tip.z_um + share * (target.z_um - tip.z_um),
    )
