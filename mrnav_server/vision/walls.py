"""The walls of a vessel model, and what a picture shows across them."""

from dataclasses import dataclass
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from mrnav_server.core.arrays import ByteArray, Float32Array, FloatArray
from mrnav_server.core.frames import Calibration
from mrnav_server.core.vessel import VesselMap

_FROM_BORDER_UM = 200.0
"""So near to the grid's border a vessel is cut off, which is no wall."""
_ROUNDING_UM = 40.0
_CORNER_SLOPE = 0.7
"""Where the smoothed distance to the wall grows by less, the wall has a corner and no direction."""


@dataclass(frozen=True)
class Walls:
    """Points on the walls, evenly spread.

    Attributes:
        points_px: Grid pixels, shape (n, 2).
        normals: Unit vectors into the lumen, shape (n, 2).
        spacing_um: Wall that a point stands for.
    """

    points_px: FloatArray
    normals: FloatArray
    spacing_um: float

    @classmethod
    def of(cls, vessel: VesselMap, spacing_um: float) -> Self:
        """Return points on a model's walls, ``spacing_um`` apart."""
        lumen = vessel.lumen.astype(np.uint8)
        contours, _ = cv2.findContours(lumen, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        stride = max(1, round(spacing_um / vessel.um_per_px))
        points = np.concatenate([contour[::stride, 0] for contour in contours]).astype(np.float64)
        rim_px = _FROM_BORDER_UM / vessel.um_per_px
        inside = np.all((points > rim_px) & (points < vessel.size_px - 1 - rim_px), axis=1)
        points = points[inside]
        smooth = cv2.GaussianBlur(vessel.distance_px, (0, 0), _ROUNDING_UM / vessel.um_per_px)
        gradient = (cv2.Sobel(smooth, cv2.CV_32F, *axis, scale=1 / 8) for axis in ((1, 0), (0, 1)))
        slope = np.stack([_read(part.astype(np.float32), points) for part in gradient], -1)
        steep = np.linalg.norm(slope, axis=1)
        straight = steep > _CORNER_SLOPE
        points, normals = points[straight], slope[straight] / steep[straight, None]
        points -= normals * _read(vessel.distance_px, points)[:, None]
        return cls(points, normals, stride * vessel.um_per_px)

    def across(self, offsets_um: NDArray[np.floating[Any]], um_per_px: float) -> FloatArray:
        """Return points along every normal, grid pixels, shape (n, offsets, 2)."""
        steps_px = offsets_um[None, :, None] / um_per_px
        return np.asarray(self.points_px[:, None] + steps_px * self.normals[:, None])


def image_px(calibration: Calibration, grid_px: FloatArray) -> FloatArray:
    """Return where points of the model's grid appear, in image pixels; shapes (..., 2)."""
    if calibration.floor is not None:
        return calibration.floor.image(grid_px)
    rows = np.array(calibration.image_from_vessel.rows())
    return np.asarray(grid_px @ rows[:, :2].T + rows[:, 2])


def gray_at(picture: ByteArray, at_px: FloatArray) -> Float32Array:
    """Return gray levels at image points, NaN outside.

    Args:
        picture: Gray, or BGR of which the mean is taken; uint8.
        at_px: Image pixels, shape (rows, columns, 2).

    Returns:
        Shape (rows, columns).
    """
    x, y = (np.ascontiguousarray(at_px[..., axis], np.float32) for axis in (0, 1))
    values = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    gray = values.mean(axis=2, dtype=np.float32) if values.ndim == 3 else values.astype(np.float32)
    height, width = picture.shape[:2]
    seen = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    return np.where(seen, gray, np.float32(np.nan))


def best_shift(
    profiles: Float32Array, pattern: Float32Array, step_um: float
) -> tuple[FloatArray, FloatArray]:
    """Find where patterns lie in longer profiles, by normalised correlation.

    Args:
        profiles: Gray levels, shape (n, long); a profile with NaN matches nowhere.
        pattern: What is looked for, shape (short,) or (n, short); centred where it is not displaced.
        step_um: Between two levels.

    Returns:
        Displacements in µm, shape (n,), and the correlations there, -1..1, shape (n,).
    """
    short = pattern.shape[-1]
    windows = np.lib.stride_tricks.sliding_window_view(profiles, short, axis=1)
    wanted = pattern - pattern.mean(axis=-1, keepdims=True)
    wanted = wanted / np.maximum(np.linalg.norm(wanted, axis=-1, keepdims=True), 1e-6)
    wanted = np.broadcast_to(wanted, (len(profiles), short))
    mean = windows.mean(axis=2)
    spread = np.sqrt(np.maximum((windows**2).mean(axis=2) - mean**2, 0.0) * short)
    match = np.einsum("nls,ns->nl", windows, wanted) / np.maximum(spread, _FLAT_GRAY * np.sqrt(short))
    match = np.nan_to_num(match, nan=-1.0)
    best = match.argmax(axis=1)
    rows = np.arange(len(profiles))
    inner = np.clip(best, 1, match.shape[1] - 2)
    before, here, after = (match[rows, inner + d] for d in (-1, 0, 1))
    bend = before - 2.0 * here + after
    part = np.where((bend < -1e-9) & (best == inner), 0.5 * (before - after) / np.minimum(bend, -1e-9), 0.0)
    middle = (match.shape[1] - 1) / 2.0
    return (best + np.clip(part, -1.0, 1.0) - middle) * step_um, match[rows, best].astype(np.float64)


_FLAT_GRAY = 1.0
"""A standard deviation of gray levels under which a profile shows nothing."""


def _read(values: Float32Array, at_px: FloatArray) -> FloatArray:
    x, y = (np.ascontiguousarray(at_px[None, :, axis], np.float32) for axis in (0, 1))
    return np.asarray(cv2.remap(values, x, y, cv2.INTER_LINEAR)[0], np.float64)
