"""From a raw polyline to a smooth path away from the walls: elastic band, Gaussian, even spacing."""

import numpy as np

from mrnav_server.core.arrays import Float32Array, FloatArray
from mrnav_server.core.vessel import VesselMap

SPACING_PX = 2.0
"""Spacing of the band's points; even spacing turns iterations into lengths."""
PUSH = 0.12
"""Step away from the wall per pixel of missing clearance and iteration."""
PULL = 0.5
"""Step towards the neighbours' mean per iteration."""
RISE_PER_PX = 0.15
"""Near its ends the band may keep the ends' own clearance plus this much per pixel of path."""
ROUNDS, ITERATIONS = 3, 60


def clearance_field_px(vessel: VesselMap) -> Float32Array:
    """Return the gap between rim and wall for a robot at each pixel, slightly blurred, shape (size, size).

    The blur (2 px) takes the kinks off the medial axis, where the gradient would jump.
    """
    from scipy.ndimage import gaussian_filter

    blurred = gaussian_filter(vessel.distance_px, 2.0, truncate=3.0)
    return np.asarray(blurred - vessel.robot_radius_px, dtype=np.float32)


def resampled(points_px: FloatArray, spacing_px: float) -> FloatArray:
    """Return the polyline at even spacing (the nearest that divides its length), shape (m, 2), m >= 2."""
    along_px = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points_px, axis=0).T))])
    count = max(2, round(along_px[-1] / spacing_px) + 1)
    at_px = np.linspace(0.0, along_px[-1], count)
    return np.stack([np.interp(at_px, along_px, points_px[:, axis]) for axis in (0, 1)], axis=1)


def smoothed(points: FloatArray, sigma: float) -> FloatArray:
    """Return the sequence convolved with a Gaussian, both ends pinned by odd reflection.

    Args:
        points: Shape (n, 2).
        sigma: Standard deviation in points.
    """
    from scipy.ndimage import gaussian_filter1d

    n = len(points)
    if n < 3:
        return points
    margin = min(n - 1, int(4 * sigma) + 1)
    before = 2.0 * points[0] - points[margin:0:-1]
    after = 2.0 * points[-1] - points[-2 : -margin - 2 : -1]
    padded = np.concatenate([before, points, after])
    blurred = gaussian_filter1d(padded, sigma, axis=0, mode="nearest")
    return np.asarray(blurred[margin : margin + n])


def smooth_path(
    raw_px: FloatArray, clearance_px: Float32Array, wanted_clearance_px: float, sigma_px: float
) -> FloatArray:
    """Pull a polyline taut, push it from the walls and smooth it; its ends stay.

    Args:
        raw_px: Shape (n, 2), n >= 2.
        clearance_px: As `clearance_field_px`.
        wanted_clearance_px: Walls push up to this clearance.
        sigma_px: Standard deviation of the Gaussian, along the path.

    Returns:
        Points about 1 px apart, shape (m, 2), m >= 2.
    """
    points_px = resampled(raw_px, SPACING_PX)
    sigma = sigma_px / SPACING_PX
    if len(points_px) > 4:
        for _ in range(ROUNDS):
            points_px = _relaxed(points_px, clearance_px, wanted_clearance_px)
            points_px = smoothed(resampled(points_px, SPACING_PX), sigma / 2)
    return resampled(smoothed(points_px, sigma), 1.0)


def tangents(points_px: FloatArray) -> FloatArray:
    """Return smoothed unit tangents of evenly spaced points, shape (n, 2); zero without any length."""
    forward = _unit(np.gradient(points_px, axis=0))
    return _unit(smoothed(forward, 3.0))


def _relaxed(points_px: FloatArray, clearance_px: Float32Array, wanted_px: float) -> FloatArray:
    """Run the band's iterations; clearance is compared with what the ends allow nearby."""
    points_px = points_px.copy()
    along_px = SPACING_PX * np.arange(len(points_px))
    ends_px = np.maximum(_bilinear(clearance_px, points_px[[0, -1]])[0], 5.0)
    from_ends_px = np.minimum(ends_px[0] + RISE_PER_PX * along_px, ends_px[1] + RISE_PER_PX * along_px[::-1])
    goal_px = np.minimum(wanted_px, from_ends_px)[1:-1]
    for _ in range(ITERATIONS):
        inner = points_px[1:-1]
        gap_px, gradient = _bilinear(clearance_px, inner)
        chord = points_px[2:] - points_px[:-2]
        along = _unit(chord)
        across = gradient - (gradient * along).sum(axis=1, keepdims=True) * along
        push = PUSH * np.clip(goal_px - gap_px, 0.0, 10.0)
        mean = 0.5 * (points_px[2:] + points_px[:-2])
        points_px[1:-1] = inner + push[:, None] * across + PULL * (mean - inner)
    return points_px


def _bilinear(field: Float32Array, points_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return values, shape (n,), and gradients over 5 px, shape (n, 2), of a field at points."""
    size = field.shape[0]
    flat = field.ravel()
    i = np.clip(points_px[:, 0].astype(np.int64), 2, size - 4)
    j = np.clip(points_px[:, 1].astype(np.int64), 2, size - 4)
    u, v = points_px[:, 0] - i, points_px[:, 1] - j
    k = j * size + i
    upper = flat[k] * (1 - u) + flat[k + 1] * u
    lower = flat[k + size] * (1 - u) + flat[k + size + 1] * u
    value: FloatArray = upper * (1 - v) + lower * v
    gx = flat[k + 3] - flat[k - 2] + flat[k + size + 3] - flat[k + size - 2]
    gy = flat[k + 3 * size] - flat[k - 2 * size] + flat[k + 3 * size + 1] - flat[k - 2 * size + 1]
    gradient: FloatArray = np.stack([gx, gy], axis=1).astype(np.float64) / 10.0
    return value, gradient


def _unit(vectors: FloatArray) -> FloatArray:
    """Return the vectors at unit length; zero stays zero."""
    length = np.hypot(vectors[:, 0], vectors[:, 1])
    return vectors / np.where(length > 0.0, length, 1.0)[:, None]
