"""Finds the magnet's centre by its outline before a plain background, with nothing calibrated.

The needle is a straight rod that leaves the picture; the magnet is the wider part at its free end. Half-way
through the blur of its two ends lie the ends themselves, and between them the magnet's centre, however far
out of focus it is. A model of both ends, with whatever gray metal and light give, is fitted to all of it.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray, Float32Array, FloatArray
from mrnav_server.core.frames import ImagePoint

_COARSE = 4
"""The needle is searched on a picture this many times smaller."""
_LEAST_CONTRAST = 12.0
"""Gray levels by which the needle must differ from the background."""
_REFINEMENTS = 3
_STRIDE_PX = 3.0


@dataclass(frozen=True, slots=True)
class _Axis:
    """The needle's axis in the picture: its free end, and the direction away from the needle."""

    end_px: FloatArray
    outward: FloatArray
    length_px: float = 0.0
    width_px: float = 0.0


def plain_background(grays: list[ByteArray]) -> ByteArray:
    """Return what lies behind a tip that was at many places: the median over the pictures."""
    return np.asarray(np.median(np.stack(grays), axis=0), np.uint8)


def locate_tip(gray: ByteArray, background: ByteArray) -> ImagePoint | None:
    """Return the magnet's centre, or None if no needle with a magnet at its end is seen whole.

    Args:
        gray: The picture, shape (height, width), uint8.
        background: The same scene without the tip.
    """
    change = cv2.absdiff(gray, background).astype(np.float32)
    axis = _axis(change)
    if axis is None:
        return None
    for _ in range(_REFINEMENTS):
        found = _magnet(change, axis)
        if found is None:
            return None
        center_px, axis = found
    refined_px = _refined(change, center_px, axis)
    if refined_px is None:
        return None
    center_px = refined_px
    return ImagePoint(float(center_px[0]), float(center_px[1]))


def _axis(change: Float32Array) -> _Axis | None:
    """Find the needle as the largest thing that changed."""
    size = (change.shape[1] // _COARSE, change.shape[0] // _COARSE)
    small = cv2.GaussianBlur(cv2.resize(change, size, interpolation=cv2.INTER_AREA), (0, 0), 1.5)
    level = 0.5 * float(np.quantile(small, 0.995))
    if level < _LEAST_CONTRAST / 2.0:
        return None
    count, labels, stats, _ = cv2.connectedComponentsWithStats((small > level).astype(np.uint8))
    if count < 2:
        return None
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    y, x = np.nonzero(labels == largest)
    points = np.column_stack([x, y]).astype(np.float64)
    middle = points.mean(axis=0)
    _, _, directions = np.linalg.svd(points - middle, full_matrices=False)
    along = (points - middle) @ directions[0]
    ends = [middle + along.min() * directions[0], middle + along.max() * directions[0]]
    inset = [min(p[0], p[1], size[0] - 1 - p[0], size[1] - 1 - p[1]) for p in ends]
    free = int(np.argmax(inset))
    outward = directions[0] if free == 1 else -directions[0]
    shift = (_COARSE - 1) / 2.0
    return _Axis(ends[free] * _COARSE + shift, outward)


def _magnet(change: Float32Array, axis: _Axis) -> tuple[FloatArray, _Axis] | None:
    """Return the magnet's centre and a better axis, from the strip around an axis."""
    width = float(np.clip(0.12 * change.shape[1], 40.0, 400.0))
    inward_px, outward_px, half_px = 1.8 * width, 0.5 * width, 0.6 * width
    s = np.arange(-outward_px, inward_px, dtype=np.float32)
    t = np.arange(-half_px, half_px + 1.0, dtype=np.float32)
    u = -axis.outward
    v = np.array([-u[1], u[0]])
    x = axis.end_px[0] + s[:, None] * u[0] + t[None, :] * v[0]
    y = axis.end_px[1] + s[:, None] * u[1] + t[None, :] * v[1]
    strip = cv2.remap(change, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR, borderValue=0.0)
    strip = cv2.GaussianBlur(strip, (0, 0), 2.0).astype(np.float64)
    across = strip.sum(axis=1)
    widest = int(np.argmax(cv2.blur(across[:, None], (1, 31))[:, 0]))
    profile = strip[max(widest - 8, 0) : widest + 9].mean(axis=0)
    edges = _half_width(profile)
    if edges is None:
        return None
    left, right = edges
    reach = 0.5 * (right - left)
    # The needle is about half as wide: out there only the magnet darkens anything.
    middle = 0.5 * (left + right)
    offset = np.abs(np.arange(len(t)) - middle) / reach
    wings = strip[:, (offset > 0.78) & (offset < 1.1)].mean(axis=1)
    ends = _half_width(wings)
    if ends is None:
        return None
    first, last = ends
    rows = slice(round(first + 0.25 * (last - first)), round(last - 0.25 * (last - first)) + 1)
    sides = [_half_width(line) for line in strip[rows]]
    places = np.array([0.5 * (a + b) for a, b in (side for side in sides if side is not None)])
    if len(places) < 5:
        return None
    center_s, center_t = 0.5 * (first + last), float(np.median(places))
    center = axis.end_px + (s[0] + center_s) * u + (t[0] + center_t) * v
    # The rod's own direction: its middle at the magnet and well up the needle.
    in_view = round(_way_out_px(axis.end_px, u, change.shape) + outward_px)
    far = min(len(s) - 9, round(last + 0.6 * width), in_view - 20)
    if far < last + 0.15 * width:
        return None
    up = _half_width(strip[far - 8 : far + 9].mean(axis=0))
    if up is None:
        return None
    slope = (0.5 * (up[0] + up[1]) - center_t) / max(far - center_s, 1.0)
    inward = u + slope * v
    inward /= np.linalg.norm(inward)
    return center, _Axis(center - 0.5 * (last - first) * inward, -inward, last - first, right - left)


def _refined(change: Float32Array, center_px: FloatArray, axis: _Axis) -> FloatArray | None:
    """Move the centre along the axis to where a model of the magnet's two ends fits best.

    Across the axis metal and light are as they are: each line along it has its own darkness on the magnet
    and on the needle, solved for in closed form. The two ends are round and blurred alike. There is no
    centre too near to the picture's edge to see the needle leave the magnet.
    """
    from scipy.optimize import least_squares

    length, half = axis.length_px, 0.5 * axis.width_px
    in_view_px = _way_out_px(center_px, -axis.outward, change.shape) - half
    if in_view_px < 0.75 * length:
        return None
    s = np.arange(-1.0 * length, min(1.1 * length, in_view_px), _STRIDE_PX)
    t = np.arange(-1.5 * half, 1.5 * half + 1.0, _STRIDE_PX)
    inward = -axis.outward
    across = np.array([-inward[1], inward[0]])

    x = center_px[0] + s[:, None] * inward[0] + t * across[0]
    y = center_px[1] + s[:, None] * inward[1] + t * across[1]
    strip = cv2.remap(change, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
    bow = np.sqrt(np.maximum(1.0 - (t / half) ** 2, 0.0))

    def misses(parameters: FloatArray) -> FloatArray:
        first, last, blur, cap = parameters
        begun = _edge((s[:, None] - first + cap * bow) / blur)
        needle = _edge((s[:, None] - last - cap * bow) / blur)
        magnet = begun * (1.0 - needle)
        mm, mn, nn = (
            np.sum(a * b, axis=0) for a, b in ((magnet, magnet), (magnet, needle), (needle, needle))
        )
        md, nd = np.sum(magnet * strip, axis=0), np.sum(needle * strip, axis=0)
        det = mm * nn - mn * mn + 1e-9
        model = magnet * ((nn * md - mn * nd) / det) + needle * ((mm * nd - mn * md) / det)
        return np.asarray((strip - model).ravel(), np.float64)

    start = np.array([-0.5 * length, 0.5 * length, 0.25 * length, 0.3 * half])
    low = np.array([-0.9 * length, 0.1 * length, 2.0, -half])
    high = np.array([-0.1 * length, 0.9 * length, length, 1.5 * half])
    found = least_squares(misses, start, bounds=(low, high), diff_step=[1e-3])
    middle = 0.5 * float(found.x[0] + found.x[1])
    return np.asarray(center_px + middle * inward)


def _way_out_px(start_px: FloatArray, direction: FloatArray, shape: tuple[int, ...]) -> float:
    """Return how far it is along a direction to the picture's edge; negative from outside."""
    ways = [
        ((side if pace > 0.0 else 0.0) - begin) / pace
        for begin, pace, side in zip(start_px, direction, (shape[1] - 1.0, shape[0] - 1.0), strict=True)
        if abs(pace) > 1e-9
    ]
    return float(min(ways))


def _edge(t: FloatArray) -> FloatArray:
    """Return the share of a disc of radius 1 on one side of a line at distance t."""
    t = np.clip(t, -1.0, 1.0)
    return np.asarray(0.5 + t * (0.75 - 0.25 * t * t))


def _half_width(profile: FloatArray) -> tuple[float, float] | None:
    """Return where a bump rises through half its height and falls through it again, by interpolation."""
    peak = int(np.argmax(profile))
    top = float(np.quantile(profile[profile > 0.5 * profile[peak]], 0.5)) if profile[peak] > 0 else 0.0
    if top < _LEAST_CONTRAST:
        return None
    half = 0.5 * top
    below = np.flatnonzero(profile[: peak + 1] < half)
    above = np.flatnonzero(profile[peak:] < half)
    if not below.size or not above.size:
        return None
    i, j = int(below[-1]), peak + int(above[0])
    left = i + (half - profile[i]) / (profile[i + 1] - profile[i])
    right = j - 1 + (profile[j - 1] - half) / (profile[j - 1] - profile[j])
    return float(left), float(right)
