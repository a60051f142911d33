"""From the operator's fingertip to a reference for the tip: clutch, re-zero, gain, bounds, smoothing.

The hand arrives as a cumulative pose, so loss, duplication and reordering cannot drift. The server forms
the increments: P_s(t) = P_s(t−1) + τ·(P_m(t) − P_m(t−1)).
"""

import math
from dataclasses import dataclass

from mrnav_server.core.frames import HandPoint, StagePoint
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.shaping import Reference


@dataclass(frozen=True, slots=True)
class HandConfig:
    """How the hand moves the tip.

    Attributes:
        gain: τ, tip motion per hand motion, without unit.
        vertical_gain: The same for the hand's up and down; 0 keeps the working height.
        dead_band_um: Hand motion below this between two poses is not motion.
        smoothing_hz: Corner of the second-order low-pass on the reference (delay 1/(π·corner) s).
        quiet_s: Silence after which the reference stands still.
        hold_s: Silence after which the hand counts as lost, 0.05 to 0.2 s.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    gain: float = 0.04
    vertical_gain: float = 0.0
    dead_band_um: float = 50.0
    smoothing_hz: float = 9.0
    quiet_s: float = 0.04
    hold_s: float = 0.1

    def __post_init__(self) -> None:
        if not 0.05 <= self.hold_s <= 0.2:
            raise ValueError("hold_s must lie between 0.05 and 0.2 s")
        if not 0.0 < self.gain <= 1.0:
            raise ValueError("gain must lie above 0 and be at most 1")


class HandControl:
    """The operator's hand as the control loop sees it.

    The clutch must be closed anew for the hand to engage: a clutch that was already closed when a mode
    began, or when the hand came into view, moves nothing.

    Args:
        config: Gains and bounds.
        speed_um_per_s: Largest speed of the reference. The bound is a speed and never a step per message:
            a headset sends 60 messages with about 30 different poses a second.
    """

    def __init__(self, config: HandConfig, speed_um_per_s: float) -> None:
        self._config = config
        self._speed_um_per_s = speed_um_per_s
        self._received_s = -math.inf
        self._clutch = False
        self._closing = self._closing_anew = False
        self._seen_open = False
        self._engaged = False
        self._pose: HandPoint | None = None
        self._pose_s = 0.0
        self._base = StagePoint(0.0, 0.0, 0.0)
        self._goal_um = [0.0, 0.0, 0.0]
        self._smooth_um = [0.0, 0.0, 0.0]
        self._smooth_um_per_s = [0.0, 0.0, 0.0]
        self._smoothed_s = 0.0

    @property
    def clutch(self) -> bool:
        """Whether the operator's clutch is closed."""
        return self._clutch

    @property
    def engaged(self) -> bool:
        """Whether the hand moves the tip."""
        return self._engaged

    def fresh(self, now_s: float) -> bool:
        """Tell whether a valid sample arrived within ``hold_s``."""
        return now_s - self._received_s <= self._config.hold_s

    def take_closing(self, *, anew: bool = True) -> bool:
        """Return whether the clutch was closed since the last call, and forget it.

        Args:
            anew: Only a clutch that was seen open before counts; False also takes a hand that comes into view
                with its clutch closed.
        """
        closing = self._closing_anew if anew else self._closing
        self._closing = self._closing_anew = False
        return closing

    def on_sample(self, sample: HandSample) -> None:
        """Take one accepted hand message; one that sees no hand is silence and opens the clutch."""
        if not sample.valid:
            self._open_clutch()
            return
        self._received_s = sample.received_s
        if sample.clutch:
            self._closing |= not self._clutch
            self._closing_anew |= self._seen_open
        else:
            self._open_clutch()
        self._clutch, self._seen_open = sample.clutch, not sample.clutch
        if not sample.new_pose:
            return
        if self._engaged and self._pose is not None:
            self._add_increment(self._pose, sample.point, sample.sender_t_s - self._pose_s)
        self._pose, self._pose_s = sample.point, sample.sender_t_s

    def engage(self, base: StagePoint, now_s: float) -> None:
        """Start following from ``base``: the hand's pose of this moment becomes zero."""
        self._engaged = True
        self._base = base
        self._goal_um = [0.0, 0.0, 0.0]
        self._smooth_um = [0.0, 0.0, 0.0]
        self._smooth_um_per_s = [0.0, 0.0, 0.0]
        self._smoothed_s = now_s

    def release(self) -> None:
        """Stop following; the clutch must be closed anew."""
        self._engaged = False

    def lose(self) -> None:
        """Forget the hand: its link ended or its lease was lost."""
        self._open_clutch()
        self._seen_open = False
        self._received_s = -math.inf
        self._pose = None

    def reference(self, now_s: float) -> Reference | None:
        """Return where the hand wants the tip; None while it does not move it."""
        if not self._engaged:
            return None
        if now_s - self._received_s > self._config.quiet_s:
            self._goal_um = list(self._smooth_um)
        self._smooth(now_s)
        base, offset, velocity = self._base, self._smooth_um, self._smooth_um_per_s
        return Reference(
            StagePoint(base.x_um + offset[0], base.y_um + offset[1], base.z_um + offset[2]),
            (velocity[0], velocity[1], velocity[2]),
            self._speed_um_per_s,
        )

    def _open_clutch(self) -> None:
        self._clutch = self._closing = self._closing_anew = self._engaged = False

    def _add_increment(self, before: HandPoint, after: HandPoint, elapsed_s: float) -> None:
        hand_um = tuple(1e6 * (b - a) for a, b in zip(_xyz(before), _xyz(after), strict=True))
        if math.hypot(*hand_um) < self._config.dead_band_um:
            return
        gain, vertical = self._config.gain, self._config.vertical_gain
        # The operator looks down on the picture: hand right is stage x, towards the body is stage y.
        step_um = (gain * hand_um[0], gain * hand_um[2], vertical * hand_um[1])
        length_um = math.hypot(*step_um)
        most_um = self._speed_um_per_s * min(max(elapsed_s, 0.0), 0.1)
        scale = min(1.0, most_um / length_um) if length_um > 0 else 0.0
        for axis in range(3):
            self._goal_um[axis] += scale * step_um[axis]

    def _smooth(self, now_s: float) -> None:
        """Advance the critically damped low-pass, exactly for a constant goal."""
        dt_s = now_s - self._smoothed_s
        if dt_s <= 0:
            return
        self._smoothed_s = now_s
        w = 2 * math.pi * self._config.smoothing_hz
        decay = math.exp(-w * dt_s)
        for axis in range(3):
            gap = self._smooth_um[axis] - self._goal_um[axis]
            rate = self._smooth_um_per_s[axis] + w * gap
            self._smooth_um[axis] = self._goal_um[axis] + (gap + rate * dt_s) * decay
            self._smooth_um_per_s[axis] = (self._smooth_um_per_s[axis] - w * rate * dt_s) * decay


def _xyz(point: HandPoint) -> tuple[float, float, float]:
    return (point.x_m, point.y_m, point.z_m)
