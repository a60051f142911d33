"""A constant-velocity Kalman filter for a point in the plane, in seconds.

Both axes share one covariance, since model and measurement are isotropic.
"""

import numpy as np

from mrnav_server.core.arrays import FloatArray


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
        self._state: FloatArray = np.array([position_px, (0.0, 0.0)], dtype=np.float64)
        self._covariance: FloatArray = np.diag([sigma_px**2, speed_sigma_px_per_s**2])
        self._density = acceleration_density

    @property
    def position_px(self) -> tuple[float, float]:
        """The estimated position (x, y)."""
        return float(self._state[0, 0]), float(self._state[0, 1])

    @property
    def velocity_px_per_s(self) -> tuple[float, float]:
        """The estimated velocity (x, y)."""
        return float(self._state[1, 0]), float(self._state[1, 1])

    @property
    def sigma_px(self) -> float:
        """Standard deviation of the position along either axis."""
        return float(np.sqrt(self._covariance[0, 0]))

    def predict(self, dt_s: float) -> None:
        """Move on by a time of any length.

        The process noise is that of continuous white acceleration, q·[[t³/3, t²/2], [t²/2, t]], so that
        two steps are the same as one of their sum: a dropped frame needs no special case.
        """
        step = np.array([[1.0, dt_s], [0.0, 1.0]])
        noise = np.array([[dt_s**3 / 3.0, dt_s**2 / 2.0], [dt_s**2 / 2.0, dt_s]])
        self._state = step @ self._state
        self._covariance = step @ self._covariance @ step.T + self._density * noise

    def correct(self, position_px: tuple[float, float], sigma_px: float) -> None:
        """Take in a measured position with its standard deviation along either axis."""
        gain = self._covariance[:, 0] / (self._covariance[0, 0] + sigma_px**2)
        self._state = self._state + np.outer(gain, np.asarray(position_px) - self._state[0])
        self._covariance = self._covariance - np.outer(gain, self._covariance[0])
