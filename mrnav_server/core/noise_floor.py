"""What a tracker's noise alone makes of straightness and smoothness (docs/metrics.md)."""

import numpy as np

from mrnav_server.core.arrays import FloatArray

_NAN = float("nan")
_MEDIAN = 0.6745
"""Median magnitude of a standard normal."""
_POINTS = 5


def straightness_floor(sigma_um: float, speed_um_per_s: float) -> float:
    """Return the G that a tracker's noise alone gives on a straight line.

    12.0 /s² is the gain of the acceleration filter for white noise at 30 Hz.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.log10(_MEDIAN * 12.0 * sigma_um / np.float64(speed_um_per_s) ** 2))


def smoothness_floor(sigma_um: float, peak_speed_um_per_s: float) -> float:
    """Return the S that a tracker's noise alone gives; 237 /s³ is the gain of the jerk filter."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.log10(2.0 * (237.0 * sigma_um) ** 2 / np.float64(peak_speed_um_per_s) ** 2))


def noise_um(t_s: FloatArray, xy_um: FloatArray) -> float:
    """Return the standard deviation of a track's noise along one axis, judged by the track itself.

    Each position is compared with the cubic through its four neighbours in time, which a moving robot follows
    and noise does not. The median keeps single leaps out.

    Args:
        t_s: Capture times in seconds, rising, shape (n,); they need not be even.
        xy_um: Positions, shape (n, 2), finite.

    Returns:
        NaN with fewer than five positions.
    """
    if t_s.size < _POINTS:
        return _NAN
    times = np.lib.stride_tricks.sliding_window_view(t_s, _POINTS)
    places = np.lib.stride_tricks.sliding_window_view(xy_um, _POINTS, axis=0)
    apart = times[:, :, None] - times[:, None, :] + np.eye(_POINTS)
    # The divided difference of order four is zero for a cubic.
    weights = 1.0 / apart.prod(axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    residual = np.einsum("nap,np->na", places, weights)
    return float(np.median(np.abs(residual)) / _MEDIAN)
