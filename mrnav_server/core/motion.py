"""From tracked positions to filtered motion: gaps, one rate, derivatives (docs/study.md).

Windows are in seconds, so that a change of the camera's rate does not change a metric's meaning.
"""

from dataclasses import dataclass

import numpy as np

from mrnav_server.core.arrays import FloatArray

RATE_HZ = 30.0
MAX_GAP_S = 0.2
MOTION_WINDOW_S, MOTION_ORDER = 0.7, 3
JERK_WINDOW_S, JERK_ORDER = 1.0, 5
_SAME_STAMP_S = 1e-3


@dataclass(frozen=True)
class Segment:
    """Positions without a gap, at 30 Hz.

    Attributes:
        t_s: Shape (n,), evenly spaced.
        xy_um: Shape (n, 2).
    """

    t_s: FloatArray
    xy_um: FloatArray


@dataclass(frozen=True)
class Motion:
    """A segment's filtered motion; half a filter window is missing at each end.

    Attributes:
        t_s: Time of the next three, shape (n,).
        xy_um, velocity_um_per_s, acceleration_um_per_s2: Shape (n, 2).
        jerk_t_s: Time of the jerk, shape (m,); its window is longer, so m <= n.
        jerk_um_per_s3: Shape (m, 2).
    """

    t_s: FloatArray
    xy_um: FloatArray
    velocity_um_per_s: FloatArray
    acceleration_um_per_s2: FloatArray
    jerk_t_s: FloatArray
    jerk_um_per_s3: FloatArray

    @property
    def speed_um_per_s(self) -> FloatArray:
        """Shape (n,)."""
        speed: FloatArray = np.hypot(self.velocity_um_per_s[:, 0], self.velocity_um_per_s[:, 1])
        return speed

    def between(self, begin_s: float, end_s: float) -> "Motion":
        """Return the part with ``begin_s <= t <= end_s``; it may be empty."""
        kept = _within(self.t_s, begin_s, end_s)
        jerk_kept = _within(self.jerk_t_s, begin_s, end_s)
        return Motion(
            self.t_s[kept],
            self.xy_um[kept],
            self.velocity_um_per_s[kept],
            self.acceleration_um_per_s2[kept],
            self.jerk_t_s[jerk_kept],
            self.jerk_um_per_s3[jerk_kept],
        )


def segments(t_s: FloatArray, xy_um: FloatArray) -> list[Segment]:
    """Drop what is no data, split at gaps of more than 0.2 s, and resample to 30 Hz.

    Args:
        t_s: Capture times in seconds, shape (n,).
        xy_um: Positions, shape (n, 2); NaN where the robot was not seen.

    Returns:
        One segment per stretch of at least four positions, in the order of time.
    """
    seen = np.isfinite(t_s) & np.isfinite(xy_um).all(axis=1)
    t_s, xy_um = t_s[seen], xy_um[seen]
    if t_s.size == 0:
        return []
    newest_s = np.concatenate([[-np.inf], np.maximum.accumulate(t_s)[:-1]])
    fresh = t_s > newest_s + _SAME_STAMP_S
    t_s, xy_um = t_s[fresh], xy_um[fresh]
    cuts = np.flatnonzero(np.diff(t_s) > MAX_GAP_S + 1e-6) + 1
    pieces = zip(np.split(t_s, cuts), np.split(xy_um, cuts), strict=True)
    return [_resampled(piece_s, piece_um) for piece_s, piece_um in pieces if piece_s.size >= 4]


def filtered(segment: Segment) -> Motion:
    """Return a segment's velocity, acceleration and jerk by Savitzky–Golay filters.

    A window of 0.7 s and order 3 gives position, velocity and acceleration; 1.0 s and order 5 the jerk.
    A segment shorter than a window gives none of what that window gives.
    """
    half = _window(MOTION_WINDOW_S) // 2
    jerk_half = _window(JERK_WINDOW_S) // 2
    t_s = segment.t_s
    return Motion(
        t_s[half : len(t_s) - half],
        _savgol(segment.xy_um, MOTION_WINDOW_S, MOTION_ORDER, 0),
        _savgol(segment.xy_um, MOTION_WINDOW_S, MOTION_ORDER, 1),
        _savgol(segment.xy_um, MOTION_WINDOW_S, MOTION_ORDER, 2),
        t_s[jerk_half : len(t_s) - jerk_half],
        _savgol(segment.xy_um, JERK_WINDOW_S, JERK_ORDER, 3),
    )


def _resampled(t_s: FloatArray, xy_um: FloatArray) -> Segment:
    # A straight line between frames would add a kink, and so jerk, at every dropped frame.
    from scipy.interpolate import CubicSpline

    count = int((t_s[-1] - t_s[0]) * RATE_HZ + 1e-6) + 1
    even_s = t_s[0] + np.arange(count) / RATE_HZ
    return Segment(even_s, np.asarray(CubicSpline(t_s, xy_um)(even_s), dtype=np.float64))


def _savgol(xy_um: FloatArray, window_s: float, order: int, derivative: int) -> FloatArray:
    """Return a derivative where the whole window holds data, shape (n − window + 1, 2)."""
    from scipy.signal import savgol_filter

    window = _window(window_s)
    if len(xy_um) < window:
        return np.empty((0, 2))
    whole = savgol_filter(xy_um, window, order, deriv=derivative, delta=1.0 / RATE_HZ, axis=0)
    half = window // 2
    return np.asarray(whole[half : len(whole) - half], dtype=np.float64)


def _window(window_s: float) -> int:
    """Return the odd number of samples nearest above a window."""
    return int(round(window_s * RATE_HZ) // 2 * 2 + 1)


def _within(t_s: FloatArray, begin_s: float, end_s: float) -> slice:
    first = int(np.searchsorted(t_s, begin_s - 1e-9))
    return slice(first, int(np.searchsorted(t_s, end_s + 1e-9)))
