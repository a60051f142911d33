"""What a device has said of its tip, and what is to be thought of it. Pure; is told the time."""

import math
from collections import deque
from collections.abc import Sequence

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.records import TipReading
from mrnav_server.devices.sensapex.goto import TRAVEL_UM
from mrnav_server.devices.sensapex.smcp1 import Status

_BEYOND_UM = 200.0
"""A sound device reports positions this far outside its travel at most."""
_WINDOW_S = 0.1
_MOVED_UM = 1.0
"""Further than this within the window is motion; readings of a tip at rest scatter by less."""
_BELIEVE_S = 1.0
"""A status that says "moving" of a tip that stays where it is is believed for this long."""
_MISSED_S = 0.3
"""A notification that is later than this against what the positions show was lost."""
_THERE_UM = 5.0
_TOLD_S = 10.0
"""A warning is shown for this long after its last cause."""
_AXES_MOVE = Status.X | Status.Y | Status.Z | Status.W

_NO_STATUS = "the controller does not say when it moves and rests: motion is seen by the position alone"
_NO_COMPLETION = "the controller does not say that a move has ended: arrival is seen by the position alone"
_ENDED_EARLY = "the controller ended a move early: its completion code says that it failed"
_ANNOUNCED = "the controller announced itself anew"
_RESTARTED = (
    "the controller has started anew: check its position and its calibration on the touch screen, then reset"
)
_RESTART_S = 1.0
"""A controller that has started anew is at fault for this long, so that nobody resets without noticing."""


class TipRecord:
    """The readings of one device.

    Args:
        axes: How many values a reading has.
        name: The device in messages.
        silent_s: A device that answers nothing for this long has failed.
    """

    def __init__(self, axes: int, name: str, silent_s: float = 0.1) -> None:
        self._silent_s = silent_s
        self._axes = axes
        self._name = name
        self._readings: deque[tuple[float, tuple[float, ...]]] = deque(maxlen=256)
        self._answered_s = -math.inf
        self._status = Status(0)
        self._said_moving_s = -math.inf
        self._moved_s = -math.inf
        self._began_s = -math.inf
        self._target: StagePoint | None = None
        self._arrived_s: float | None = None
        self._told_s: dict[str, float] = {}
        self._outside = ""
        self._restarted_s = -math.inf

    @property
    def newest(self) -> StagePoint:
        """The newest position, whatever is to be thought of it; there must be one."""
        return StagePoint(*self._readings[-1][1][:3])

    def on_position(self, position_um: Sequence[float], taken_s: float) -> bool:
        """Take a position; False if it has another number of axes, or is older than the newest.

        Args:
            position_um: One value for each axis.
            taken_s: When it was true, or before.
        """
        if len(position_um) != self._axes or not all(map(math.isfinite, position_um)):
            return False
        if self._readings and taken_s < self._readings[-1][0]:
            return False
        self._readings.append((taken_s, tuple(position_um)))
        self._outside = _outside(position_um)
        while self._readings[0][0] < taken_s - _WINDOW_S and len(self._readings) > 2:
            self._readings.popleft()
        moved_um = max(
            max(values) - min(values) for values in zip(*(at for _, at in self._readings), strict=True)
        )
        if moved_um > _MOVED_UM:
            if taken_s - self._moved_s > _WINDOW_S:
                self._began_s = taken_s
            self._moved_s = taken_s
            silent_s = taken_s - max(self._began_s, self._said_moving_s)
            if silent_s > _MISSED_S and not self._status & _AXES_MOVE:
                self._tell(_NO_STATUS, taken_s)
        elif self._status & _AXES_MOVE and taken_s - max(self._moved_s, self._said_moving_s) > _BELIEVE_S:
            self._tell(_NO_STATUS, taken_s)
        self._watch_arrival(taken_s)
        return True

    def on_answer(self, now_s: float) -> None:
        """Note that the device answered a question for its position."""
        self._answered_s = now_s

    def on_status(self, status: Status, now_s: float) -> None:
        """Take a status."""
        if status & _AXES_MOVE:
            self._said_moving_s = now_s
        self._status = status

    def on_goto(self, target: StagePoint) -> None:
        """Note a move that was sent."""
        self._target, self._arrived_s = target, None

    def on_completed(self, code: int, now_s: float) -> None:
        """Take the news that a move has ended; 0 and 2 mean well."""
        if code not in (0, 2) and self._target is not None:
            self._tell(_ENDED_EARLY, now_s)
        self._target = None

    def on_stop(self) -> None:
        """Note a STOP: nothing is on its way any more."""
        self._target = None

    def on_hello(self, now_s: float) -> None:
        """Take an announcement; one out of silence means that the device has started anew."""
        if now_s - self._answered_s > self._silent_s:
            self._restarted_s = now_s
            self._tell(_RESTARTED, now_s)
        else:
            self._tell(_ANNOUNCED, now_s)

    def slack_um(self, now_s: float) -> float:
        """Return how far the tip may have gone since the newest reading, by its speed before."""
        if len(self._readings) < 2:
            return 0.0
        (then_s, then), (taken_s, at) = self._readings[0], self._readings[-1]
        if taken_s <= then_s:
            return 0.0
        return math.dist(then[:3], at[:3]) / (taken_s - then_s) * max(now_s - taken_s, 0.0)

    def check(self, now_s: float) -> None:
        """Check that the newest position can be relied on.

        Raises:
            DeviceError: If there is none, or the device is silent, faulty or without its calibration.
        """
        if now_s - self._restarted_s < _RESTART_S:
            raise DeviceError(f"{self._name}: {_RESTARTED}")
        if not self._readings:
            raise DeviceError(f"{self._name} is not open: open it first")
        silent_s = now_s - self._answered_s
        if silent_s > self._silent_s:
            raise DeviceError(
                f"{self._name} has not answered for {1000 * silent_s:.0f} ms: check its power and its cable"
            )
        if self._outside:
            raise DeviceError(
                f"{self._name} reports {self._outside}, outside its travel: its zero calibration is lost; "
                "calibrate it on the touch screen"
            )
        if self._status & Status.ERROR:
            raise DeviceError(f"{self._name} reports an error: see its touch screen")

    def reading(self, now_s: float) -> TipReading:
        """Return the newest reading.

        Raises:
            DeviceError: As ``check``.
        """
        self.check(now_s)
        taken_s, position_um = self._readings[-1]
        return TipReading(taken_s, StagePoint(*position_um[:3]), self._moving(now_s))

    def require_acknowledged(self, missing_s: float) -> None:
        """Check how long moves have gone without an acknowledgement.

        Raises:
            DeviceError: If that is too long.
        """
        if missing_s > self._silent_s:
            raise DeviceError(
                f"{self._name} has not acknowledged a move for {1000 * missing_s:.0f} ms: movement may be "
                "locked on its touch screen, or its network cable is bad"
            )

    def warnings(self, now_s: float) -> list[str]:
        """Return what the operator should know."""
        return [text for text, told_s in self._told_s.items() if now_s - told_s <= _TOLD_S]

    def _moving(self, now_s: float) -> bool:
        said_s = max(self._said_moving_s, self._moved_s)
        says = bool(self._status & _AXES_MOVE) and now_s - said_s <= _BELIEVE_S
        return says or now_s - self._moved_s <= _WINDOW_S

    def _watch_arrival(self, taken_s: float) -> None:
        """Miss the completion of a move whose target the tip has reached."""
        at, target = self.newest, self._target
        if target is None or taken_s - self._moved_s <= _WINDOW_S:
            return
        away_um = (at.x_um - target.x_um, at.y_um - target.y_um, at.z_um - target.z_um)
        if max(map(abs, away_um)) > _THERE_UM:
            return
        if self._arrived_s is None:
            self._arrived_s = taken_s
        elif taken_s - self._arrived_s > _MISSED_S:
            self._tell(_NO_COMPLETION, taken_s)
            self._target = None

    def _tell(self, warning: str, now_s: float) -> None:
        self._told_s[warning] = now_s


def _outside(position_um: Sequence[float]) -> str:
    """Return the first axis that is far outside its travel, or ""."""
    for axis, value_um in zip("xyzw", position_um, strict=False):
        if not -_BEYOND_UM <= value_um <= TRAVEL_UM + _BEYOND_UM:
            return f"{axis} = {value_um:.0f} µm"
    return ""
