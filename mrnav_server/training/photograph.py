"""Photographs of printed vessels: reading, cutting, and resampling to a vessel grid."""

from math import ceil
from pathlib import Path

import cv2
import numpy as np

from mrnav_server.core.arrays import BoolArray, Float32Array, FloatArray
from mrnav_server.core.errors import ConfigError

MIN_SIDE_PX = 64
Crop = tuple[int, int, int, int]
"""Left, top, width and height in pixels of the photograph."""

_DARK_SHARE = 0.08
"""Of the brightest pixels' brightness; what is darker may be an eyepiece's surround."""


def read_photograph(path: Path) -> Float32Array:
    """Read a picture, gray or colour, 8 or 16 bits.

    Returns:
        Shape (height, width, 3), BGR, scaled to 0..1.

    Raises:
        ConfigError: If it cannot be read, or has fewer than 64 px on a side.
    """
    if not path.is_file():
        raise ConfigError(f"photograph: there is no file {path}")
    try:
        picture = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    except cv2.error:
        picture = None
    if picture is None:
        raise ConfigError(f"photograph: {path} is not a picture that can be read; use PNG, JPEG or TIFF")
    height, width = picture.shape[:2]
    if min(height, width) < MIN_SIDE_PX:
        raise ConfigError(
            f"photograph: {path} is {width} x {height} px; {MIN_SIDE_PX} px a side are needed at least"
        )
    scaled = picture.astype(np.float32)
    return scaled / max(float(scaled.max()), 1.0)


def cut(photograph: Float32Array, crop: Crop) -> Float32Array:
    """Return a part of a photograph.

    Raises:
        ConfigError: If the part is too small or not inside the photograph.
    """
    left, top, width, height = crop
    full_height, full_width = photograph.shape[:2]
    if min(width, height) < MIN_SIDE_PX:
        raise ConfigError(f"crop: {width} x {height} px; {MIN_SIDE_PX} px a side are needed at least")
    if left < 0 or top < 0 or left + width > full_width or top + height > full_height:
        raise ConfigError(
            f"crop: {left},{top},{width},{height} (left, top, width, height) leaves the photograph,"
            f" which is {full_width} x {full_height} px"
        )
    return photograph[top : top + height, left : left + width]


def shrink(picture: Float32Array, factor: float) -> Float32Array:
    """Shrink a picture by averaging; a factor of 1 leaves it as it is."""
    height, width = (max(round(side * factor), 1) for side in picture.shape[:2])
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)


def field_of_view(gray: Float32Array, rim_px: float) -> BoolArray:
    """Return where a picture shows anything: an eyepiece leaves a black surround.

    Args:
        gray: Shape (height, width), 0..1.
        rim_px: What lies so close to the surround is left out too.
    """
    shown = (gray > _DARK_SHARE * np.percentile(gray, 99)).astype(np.uint8)
    outlines, _ = cv2.findContours(shown, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    everything = np.ones(gray.shape, dtype=bool)
    if not outlines:
        return everything
    outline = max(outlines, key=cv2.contourArea)
    area = cv2.contourArea(outline)
    if area < 0.4 * gray.size or area < 0.95 * cv2.contourArea(cv2.convexHull(outline)):
        return everything
    field = np.zeros_like(shown)
    cv2.drawContours(field, [outline], -1, 1, cv2.FILLED)
    if field.all():
        return everything
    return np.asarray(cv2.distanceTransform(field, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) > rim_px)


def on_grid(values: Float32Array, origin_px: FloatArray, size: int, step: float, fill: float) -> Float32Array:
    """Resample a square of a picture to a grid.

    Args:
        values: Shape (height, width) or (height, width, 3).
        origin_px: The square's upper left corner (x, y) in the picture.
        size: Side of the grid.
        step: Picture pixels per grid pixel, at most 1.
        fill: What lies beyond the picture.

    Returns:
        Shape (size, size) or (size, size, 3).
    """
    shift = 0.5 * step - 0.5
    matrix = np.array([[step, 0, origin_px[0] + shift], [0, step, origin_px[1] + shift]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    # The outermost half pixel would fade into what lies beyond: it repeats the edge instead.
    resampled = cv2.warpAffine(values, matrix, (size, size), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    height, width = (
        ceil((side - corner) / step - 1e-6)
        for side, corner in zip(values.shape[:2], origin_px[::-1], strict=True)
    )
    resampled[max(height, 0) :] = fill
    resampled[:, max(width, 0) :] = fill
    return resampled.astype(np.float32)
