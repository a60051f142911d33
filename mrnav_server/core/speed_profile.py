"""Smoothness of a speed profile by two measures of the motor-control literature; higher is smoother."""

import numpy as np

from mrnav_server.core.arrays import FloatArray

_NAN = float("nan")


def log_dimensionless_jerk(speed: FloatArray, rate_hz: float) -> float:
    """Return LDLJ = −ln(T³/v_p² · ∫ (d²v/dt²)² dt) of a speed profile; NaN if it does not move.

    Source: Balasubramanian et al., On the analysis of movement smoothness, 2015.
    """
    if speed.size < 3 or not speed.max() > 0:
        return _NAN
    jerk = np.diff(speed, 2) * rate_hz**2
    duration_s = speed.size / rate_hz
    cost = duration_s**3 / speed.max() ** 2 * (jerk**2).sum() / rate_hz
    return float(-np.log(cost)) if cost > 0 else _NAN


def spectral_arc_length(
    speed: FloatArray, rate_hz: float, cutoff_hz: float = 10.0, least_amplitude: float = 0.05
) -> float:
    """Return SPARC, the negative length of a speed profile's normalised spectrum; NaN if it does not move.

    Args:
        speed: Speed profile, shape (n,).
        rate_hz: Its rate.
        cutoff_hz: Frequencies above count for nothing.
        least_amplitude: The spectrum ends at the last amplitude at least this large, of 1.

    Source: Balasubramanian et al., On the analysis of movement smoothness, 2015.
    """
    if speed.size < 3 or not speed.max() > 0:
        return _NAN
    padded = 2 ** (int(np.ceil(np.log2(speed.size))) + 4)
    amplitude = np.abs(np.fft.rfft(speed, padded))
    frequency_hz = np.fft.rfftfreq(padded, 1.0 / rate_hz)
    amplitude = amplitude[frequency_hz <= cutoff_hz] / amplitude.max()
    last = int(np.flatnonzero(amplitude >= least_amplitude)[-1])
    if last == 0:
        return _NAN
    return float(-np.hypot(1.0 / last, np.diff(amplitude[: last + 1])).sum())
