"""What filtered motion (core/motion.py) says: speed, straightness, smoothness (docs/metrics.md).

Lower is straighter for G, lower is smoother for S.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.motion import RATE_HZ, Motion

SLOWEST_UM_PER_S = 50.0
"""Below this filtered speed the robot counts as standing."""
FLOOR = 1e-6
"""Curvature (1/µm) and jerk cost are floored here before the logarithm."""
_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class MedianLog:
    """A metric that is the median of a logarithm over samples.

    Attributes:
        value: The median; NaN if nothing moves.
        samples: How many samples it is the median of.
        moving_share: Their share of all samples, 0..1.
        floored_share: Share of them that lay below the floor, 0..1.
    """

    value: float
    samples: int
    moving_share: float
    floored_share: float


def path_length_um(motions: Sequence[Motion]) -> float:
    """Return the length of the filtered path; gaps count nothing."""
    return float(sum(np.hypot(*np.diff(motion.xy_um, axis=0).T).sum() for motion in motions))


def average_speed_um_per_s(motions: Sequence[Motion]) -> float:
    """Return path length over duration; NaN without motion data.

    Source: study metric (a), average speed Va.
    """
    duration_s = sum(float(motion.t_s[-1] - motion.t_s[0]) for motion in motions)
    return path_length_um(motions) / duration_s if duration_s > 0 else _NAN


def peak_speed_um_per_s(motions: Sequence[Motion]) -> float:
    """Return the largest filtered speed, v_p; NaN without motion data."""
    return max((float(motion.speed_um_per_s.max()) for motion in motions), default=_NAN)


def first_motion_s(motions: Sequence[Motion]) -> float:
    """Return when the filtered speed first reaches 50 µm/s; NaN if never."""
    for motion in motions:
        moving = np.flatnonzero(motion.speed_um_per_s >= SLOWEST_UM_PER_S)
        if moving.size:
            return float(motion.t_s[moving[0]])
    return _NAN


def straightness(motions: Sequence[Motion]) -> MedianLog:
    """Return G, the median of log10 κ with κ = |v×a|/|v|³ in 1/µm, over the samples that move.

    A sample moves at ``|v| >= max(0.05·v_p, 50 µm/s)``.

    Source: study metric (c), geometric straightness.
    """
    if not motions:
        return MedianLog(_NAN, 0, 0.0, 0.0)
    v = np.concatenate([motion.velocity_um_per_s for motion in motions])
    a = np.concatenate([motion.acceleration_um_per_s2 for motion in motions])
    speed = np.hypot(v[:, 0], v[:, 1])
    moving = speed >= slowest_moving_um_per_s(float(speed.max()))
    v, a, speed = v[moving], a[moving], speed[moving]
    curvature = np.abs(v[:, 0] * a[:, 1] - v[:, 1] * a[:, 0]) / speed**3
    return _median_log(curvature, moving.size)


def smoothness(
    motions: Sequence[Motion], sigma_s: float = 1.0, peak_um_per_s: float | None = None
) -> MedianLog:
    """Return S, the median of log10 φ over sliding windows of σ inside a segment.

    Args:
        motions: The trial's filtered motion, or a part of it.
        sigma_s: σ; the value depends on it. At 1 s the literal σ⁵ and the dimensionless σ³ agree.
        peak_um_per_s: v_p; that of these motions if left out.

    Source: study metric (d), smoothness.
    """
    peak = peak_speed_um_per_s(motions) if peak_um_per_s is None else peak_um_per_s
    if not peak >= SLOWEST_UM_PER_S:
        return MedianLog(_NAN, 0, 0.0, 0.0)
    costs = np.concatenate([jerk_cost(m.jerk_um_per_s3, RATE_HZ, sigma_s, peak) for m in motions])
    return _median_log(costs, costs.size)


def jerk_cost(
    jerk_um_per_s3: FloatArray, rate_hz: float, sigma_s: float, peak_speed_um_per_s: float
) -> FloatArray:
    """Return φ(t) = σ⁵/v_p² · ∫_{t−σ}^{t} |jerk|² dt for every whole window.

    Args:
        jerk_um_per_s3: Shape (m, 2).
        rate_hz: Its rate.
        sigma_s: σ, a whole number of samples.
        peak_speed_um_per_s: v_p.

    Returns:
        Shape (m − σ·rate,), empty if no window fits.
    """
    steps = round(sigma_s * rate_hz)
    squared = (jerk_um_per_s3**2).sum(axis=1)
    if squared.size <= steps:
        return np.zeros(0)
    integral = np.concatenate([[0.0], np.cumsum((squared[1:] + squared[:-1]) / (2.0 * rate_hz))])
    cost: FloatArray = (integral[steps:] - integral[:-steps]) * sigma_s**5 / peak_speed_um_per_s**2
    return cost


def slowest_moving_um_per_s(peak_um_per_s: float) -> float:
    """Return the filtered speed from which on a sample counts as moving, ``max(0.05·v_p, 50 µm/s)``."""
    return max(0.05 * peak_um_per_s, SLOWEST_UM_PER_S)


def _median_log(values: FloatArray, of_all: int) -> MedianLog:
    if values.size == 0:
        return MedianLog(_NAN, 0, 0.0, 0.0)
    return MedianLog(
        value=float(np.median(np.log10(np.maximum(values, FLOOR)))),
        samples=values.size,
        moving_share=values.size / of_all,
        floored_share=float((values <= FLOOR).mean()),
    )
