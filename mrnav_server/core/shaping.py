"""One jerk-limited shaper owns the setpoint; a mode switch changes only its reference.

A velocity servo with feed-forward. Limits hold for the length of the vector, so motion is the same in
every direction (an axis-wise generator would give a diagonal 1.4 times the acceleration of an axis).
"""

import math
from dataclasses import dataclass

from mrnav_server.core.frames import StagePoint
from mrnav_server.core.limits import Limits

_SUBSTEP_S = 0.001


@dataclass(frozen=True, slots=True)
class ShaperGains:
    """Gains of the servo inside the shaper.

    Attributes:
        position_per_s: Position error to velocity.
        velocity_per_s: Velocity error to acceleration.
    """

    position_per_s: float
    velocity_per_s: float


FIRM = ShaperGains(20.0, 60.0)
"""For a reference that keeps within the limits, as a planned one does."""
GENTLE = ShaperGains(8.0, 40.0)
"""For a reference that does not, as that of a hand under a headset's errors.

Its jerk is several times the limit, so the acceleration is late however large its gain is. A firm pull on
the position then swings, and makes four times as much of the errors at 2 to 3 Hz, where the robot rings. The
velocity's feed-forward keeps a steady hand from being late.
"""


@dataclass(frozen=True, slots=True)
class Reference:
    """Where the tip should be and how fast it should move there.

    Attributes:
        position: In the stage frame.
        velocity_um_per_s: Feed-forward, stage x, y, z.
        speed_um_per_s: Speed limit of the mode.
        gains: How firmly the setpoint is drawn there.
    """

    position: StagePoint
    velocity_um_per_s: tuple[float, float, float]
    speed_um_per_s: float
    gains: ShaperGains = FIRM

    @property
    def finite(self) -> bool:
        """Whether every number in it is."""
        at = self.position
        return all(map(math.isfinite, (at.x_um, at.y_um, at.z_um, *self.velocity_um_per_s)))


class Shaper:
    """Position, velocity and acceleration of the setpoint; all three are continuous across modes.

    Args:
        limits: Speed, acceleration and jerk bounds.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._p = [0.0, 0.0, 0.0]
        self._v = [0.0, 0.0, 0.0]
        self._a = [0.0, 0.0, 0.0]

    @property
    def position(self) -> StagePoint:
        """The setpoint."""
        return StagePoint(*self._p)

    @property
    def velocity_um_per_s(self) -> tuple[float, float, float]:
        """The setpoint's velocity, stage x, y, z."""
        return (self._v[0], self._v[1], self._v[2])

    @property
    def acceleration_um_per_s2(self) -> tuple[float, float, float]:
        """The setpoint's acceleration, stage x, y, z."""
        return (self._a[0], self._a[1], self._a[2])

    @property
    def speed_um_per_s(self) -> float:
        """The setpoint's speed."""
        return math.hypot(*self._v)

    @property
    def at_rest(self) -> bool:
        """Whether the setpoint stands still (slower than a manipulator can be told to move)."""
        return self.speed_um_per_s < 1.0 and math.hypot(*self._a) < 1000.0

    @property
    def rest_point(self) -> StagePoint:
        """Where the setpoint comes to rest if it brakes now.

        The acceleration is taken back first, then the speed, both as fast as jerk and acceleration allow.
        """
        most, jerk = self._limits.acceleration_um_per_s2, self._limits.jerk_um_per_s3
        back_s = math.hypot(*self._a) / jerk
        p = [p + v * back_s + a * back_s**2 / 3 for p, v, a in zip(self._p, self._v, self._a, strict=True)]
        v = [v + a * back_s / 2 for v, a in zip(self._v, self._a, strict=True)]
        speed = math.hypot(*v)
        braking_s = speed / most + most / jerk if speed > most**2 / jerk else 2 * math.sqrt(speed / jerk)
        return StagePoint(*(p + v * braking_s / 2 for p, v in zip(p, v, strict=True)))

    def reset(self, position: StagePoint) -> None:
        """Stand still at a position: before the first motion, and after a device stop."""
        self._p = [position.x_um, position.y_um, position.z_um]
        self._v = [0.0, 0.0, 0.0]
        self._a = [0.0, 0.0, 0.0]

    def step(self, dt_s: float, reference: Reference | None) -> StagePoint:
        """Advance the setpoint and return it.

        Args:
            dt_s: Time since the last step; long gaps are cut to 50 ms, so that a stall never becomes a leap.
            reference: Where to go; None brings the setpoint to rest with full, jerk-limited deceleration.
        """
        left_s = min(dt_s, 0.05)
        elapsed_s = 0.0
        while left_s > 1e-9:
            h_s = min(_SUBSTEP_S, left_s)
            self._substep(h_s, elapsed_s, reference)
            left_s -= h_s
            elapsed_s += h_s
        if reference is None and self.at_rest:
            self.reset(self.position)
        return self.position

    def _substep(self, h_s: float, elapsed_s: float, reference: Reference | None) -> None:
        limits, gains = self._limits, FIRM if reference is None else reference.gains
        wanted = _wanted_velocity(self._p, elapsed_s, reference, gains.position_per_s, limits)
        ax = gains.velocity_per_s * (wanted[0] - self._v[0])
        ay = gains.velocity_per_s * (wanted[1] - self._v[1])
        az = gains.velocity_per_s * (wanted[2] - self._v[2])
        asked = math.sqrt(ax * ax + ay * ay + az * az)
        # An acceleration that jerk can still take back before the wanted velocity is reached.
        gap_um_per_s = asked / gains.velocity_per_s
        bound = min(limits.acceleration_um_per_s2, math.sqrt(1.6 * limits.jerk_um_per_s3 * gap_um_per_s))
        if asked > bound:
            scale = bound / asked
            ax, ay, az = ax * scale, ay * scale, az * scale
        a, v, p = self._a, self._v, self._p
        most = limits.jerk_um_per_s3 * h_s
        jx, jy, jz = ax - a[0], ay - a[1], az - a[2]
        scale = min(1.0, most / max(math.hypot(jx, jy, jz), 1e-9))
        turned = [a[0] + scale * jx, a[1] + scale * jy, a[2] + scale * jz]
        kept = max(0.0, 1.0 - most / max(math.hypot(*a), 1e-9))
        eased = [kept * a[0], kept * a[1], kept * a[2]]
        top = reference.speed_um_per_s if reference is not None else 0.0
        # Easing off now keeps the speed limit; so whatever would break it has to wait.
        if self._speed_after(turned, h_s) > max(top, self._speed_after(eased, h_s)):
            turned = eased
        for axis in range(3):
            a[axis] = turned[axis]
            v[axis] += a[axis] * h_s
            p[axis] += v[axis] * h_s

    def _speed_after(self, a: list[float], h_s: float) -> float:
        """Return the speed once an acceleration has acted for a moment and been taken back."""
        v, left_s = self._v, h_s + math.hypot(*a) / (2.0 * self._limits.jerk_um_per_s3)
        return math.hypot(v[0] + left_s * a[0], v[1] + left_s * a[1], v[2] + left_s * a[2])


def _wanted_velocity(
    p: list[float], elapsed_s: float, reference: Reference | None, gain_per_s: float, limits: Limits
) -> tuple[float, float, float]:
    if reference is None:
        return (0.0, 0.0, 0.0)
    target, feed = reference.position, reference.velocity_um_per_s
    ex = target.x_um + feed[0] * elapsed_s - p[0]
    ey = target.y_um + feed[1] * elapsed_s - p[1]
    ez = target.z_um + feed[2] * elapsed_s - p[2]
    error = math.sqrt(ex * ex + ey * ey + ez * ez)
    # Far away the linear gain would ask for more than deceleration can take back: v = sqrt(a·e).
    pull = min(gain_per_s, math.sqrt(limits.acceleration_um_per_s2 / max(error, 1e-9)))
    wx, wy, wz = feed[0] + pull * ex, feed[1] + pull * ey, feed[2] + pull * ez
    speed = math.sqrt(wx * wx + wy * wy + wz * wz)
    if speed > reference.speed_um_per_s:
        scale = reference.speed_um_per_s / speed
        wx, wy, wz = wx * scale, wy * scale, wz * scale
    return (wx, wy, wz)
