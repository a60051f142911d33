"""A constant-velocity Kalman filter for a point in the plane, in seconds.

Both axes share one covariance, since model and measurement are isotropic.
"""

import math


class PointFilter:
    """Position and velocity of a point under white-noise acceleration.

    Args:
        position_px: Where it is, (x, y).
        sigma_px: Standard deviation of that.
        speed_sigma_px_per_s: Standard deviation of its unknown velocity.
        acceleration_density: Spectral density of its acceleration, in px²/s³.
    """

    def __init__(
        self,
        position_px: tuple[float, float],
        sigma_px: float,
        speed_sigma_px_per_s: float,
        acceleration_density: float,
    ) -> None:
        self._x_px, self._y_px = position_px
        self._vx_px_per_s = self._vy_px_per_s = 0.0
        # Of position, position with velocity, and velocity, along either axis.
        self._pp, self._pv, self._vv = sigma_px**2, 0.0, speed_sigma_px_per_s**2
        self._density = acceleration_density

    @property
    def position_px(self) -> tuple[float, float]:
        """The estimated position (x, y)."""
        return self._x_px, self._y_px

    @property
    def velocity_px_per_s(self) -> tuple[float, float]:
        """The estimated velocity (x, y)."""
        return self._vx_px_per_s, self._vy_px_per_s

    @property
    def sigma_px(self) -> float:
        """Standard deviation of the position along either axis."""
        return math.sqrt(self._pp)

    def predict(self, dt_s: float) -> None:
        """Move on by a time of any length.

        The process noise is that of continuous white acceleration, q·[[t³/3, t²/2], [t²/2, t]], so that
        two steps are the same as one of their sum: a dropped frame needs no special case.
        """
        self._x_px += dt_s * self._vx_px_per_s
        self._y_px += dt_s * self._vy_px_per_s
        self._pp += dt_s * (2.0 * self._pv + dt_s * self._vv) + self._density * dt_s**3 / 3.0
        self._pv += dt_s * self._vv + self._density * dt_s**2 / 2.0
        self._vv += self._density * dt_s

    def correct(self, position_px: tuple[float, float], sigma_px: float) -> None:
        """Take in a measured position with its standard deviation along either axis."""
        variance = self._pp + sigma_px**2
        gain_p, gain_v = self._pp / variance, self._pv / variance
        off_x_px, off_y_px = position_px[0] - self._x_px, position_px[1] - self._y_px
        self._x_px += gain_p * off_x_px
        self._y_px += gain_p * off_y_px
        self._vx_px_per_s += gain_v * off_x_px
        self._vy_px_per_s += gain_v * off_y_px
        self._vv -= gain_v * self._pv
        # What is left of a share 1 - g, so that rounding never makes it negative.
        self._pp *= sigma_px**2 / variance
        self._pv *= sigma_px**2 / variance
