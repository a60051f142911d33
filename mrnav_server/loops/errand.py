"""Motion that neither hand nor policy asks for: a procedure sends the tip somewhere through the control loop.

While an errand is under way the rig is armed and in HOLD, the hand moves nothing, and whoever asks for
anything ends it. It goes anywhere in the manipulator's travel: a calibration must go where the present one
does not allow.
"""

from collections.abc import Callable

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.limits import Limits
from mrnav_server.core.modes import Ask
from mrnav_server.core.records import TipReading
from mrnav_server.core.shaping import Reference

_BUSY = "a calibration is under way: cancel it first"


class Errand:
    """Where a procedure sends the tip, and why it no longer may.

    Args:
        limits: The manipulator's travel.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._reserved = False
        self._reference: Reference | None = None
        self._objection: Callable[[], str] | None = None
        self._hesitates: Callable[[], bool] = lambda: False
        self._waiting = False
        self._ended = ""

    @property
    def reserved(self) -> bool:
        """Whether nobody but a procedure may arm the rig or move the tip."""
        return self._reserved

    @property
    def under_way(self) -> bool:
        """Whether the procedure may move the tip now."""
        return self._objection is not None

    @property
    def busy(self) -> str:
        """Why nobody else may use the rig, or ""."""
        return _BUSY if self._reserved else ""

    @property
    def text(self) -> str:
        """What the operator is told while the tip may move; "" otherwise."""
        return "the calibration moves the tip: STOP or the space bar ends it" if self.under_way else ""

    @property
    def ended(self) -> str:
        """Why it was ended by somebody else, or ""."""
        return self._ended

    @property
    def waiting(self) -> bool:
        """Whether the tip rests on its way, until it may go on."""
        return self._waiting

    @property
    def reference(self) -> Reference | None:
        """Where the tip is to go; None to come to rest."""
        return None if self._waiting else self._reference

    def reserve(self) -> None:
        """Keep hand and policy off; what ended an earlier errand is forgotten."""
        self._reserved, self._ended = True, ""

    def release(self) -> None:
        """Let hand and policy in again; only once the rig is no longer armed."""
        self.pause()
        self._reserved = False

    def begin(self, objection: Callable[[], str], hesitates: Callable[[], bool]) -> None:
        """Let the tip move from now on. Both are asked at every control step.

        Args:
            objection: What it says ends the errand, "" does not.
            hesitates: Whether the tip is to rest where it is for the moment.
        """
        self._objection, self._hesitates, self._ended = objection, hesitates, ""

    def pause(self) -> None:
        """Let the tip rest: a person is at the bench."""
        self._objection = self._reference = None
        self._waiting = False

    def end(self, reason: str) -> None:
        """Let the tip come to rest; the procedure is told why."""
        if self.under_way:
            self._ended = reason
            self.pause()

    def look(self) -> None:
        """End the errand if there is an objection, and let it wait while there is a doubt."""
        if self._objection is None:
            return
        self._waiting = self._hesitates()
        if reason := self._objection():
            self.end(reason)

    def go(self, target: StagePoint, speed_um_per_s: float) -> None:
        """Send the tip to a place, in a straight line.

        Raises:
            RefusedError: If the errand was ended, or the place is outside the manipulator's travel.
        """
        if not self.under_way:
            raise RefusedError("ended", self._ended or "the calibration rests")
        low, high = self._limits.workspace_min_um, self._limits.workspace_max_um
        if any(not a <= v <= b for a, v, b in zip(low, target.array(), high, strict=True)):
            raise RefusedError(
                "out_of_travel",
                f"the tip would go to ({target.x_um:.0f}, {target.y_um:.0f}, {target.z_um:.0f}) µm, outside"
                " its travel: change the calibration's raster and heights",
            )
        speed = min(speed_um_per_s, self._limits.speed_um_per_s)
        self._reference = Reference(target, (0.0, 0.0, 0.0), speed)

    def told(self, ask: Ask) -> None:
        """Take note of what somebody asks for.

        Raises:
            RefusedError: If it would arm or move the rig besides the procedure.
        """
        if not self._reserved or (ask is Ask.ARM and self.under_way):
            return
        if ask in (Ask.ARM, Ask.MANUAL, Ask.AUTO):
            raise RefusedError("busy", _BUSY)
        self.end(f"{ask.value} was asked")

    def kept(self, point: StagePoint) -> StagePoint:
        """Return a point within the manipulator's travel."""
        low, high = self._limits.workspace_min_um, self._limits.workspace_max_um
        x, y, z = (min(max(v, a), b) for a, v, b in zip(low, point.array(), high, strict=True))
        return StagePoint(float(x), float(y), float(z))

    def arm_refusal(self, tip: TipReading | None) -> str:
        """Return why the tip must not be set in motion from where it is, or ""."""
        if tip is None:
            return "the manipulator has not reported a position yet"
        if self.kept(tip.position) != tip.position:
            return "the tip is outside its travel: re-zero the manipulator"
        return "the tip still moves: wait until it rests" if tip.moving else ""
