"""Sprites of the simulated picture: how one is blended in, and the robot's sphere."""

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray, Float32Array, FloatArray
from mrnav_server.core.frames import ImagePoint

Region = tuple[slice, slice]
"""Rows and columns of the picture that a sprite has touched."""


def blend(pixels: ByteArray, clear: ByteArray, own: ByteArray) -> None:
    """Dim pixels to the share of light let through, and add a sprite's own gray, in place.

    Args:
        pixels: Shape (h, w, 3), uint8.
        clear: Share of light let through, 0..255, shape (h, w), uint8.
        own: The sprite's gray times its opacity, shape (h, w), uint8.
    """
    cv2.multiply(pixels, cv2.cvtColor(clear, cv2.COLOR_GRAY2BGR), pixels, 1.0 / 255.0)
    cv2.add(pixels, cv2.cvtColor(own, cv2.COLOR_GRAY2BGR), pixels)


def to_bytes(values: Float32Array | FloatArray) -> ByteArray:
    """Round values, which must lie in 0..255."""
    return (values + np.float32(0.5)).astype(np.uint8)


class SphereSprite:
    """A dark metal sphere with a soft rim, a highlight and a shadow, at any sub-pixel position.

    Args:
        blur_px: Softness of the rim.
        offset: Gray levels that the noise adds later.
    """

    def __init__(self, blur_px: float, offset: float) -> None:
        self._blur_px = blur_px
        self._offset = offset

    def paint(self, scene: ByteArray, center: ImagePoint, radius_px: float) -> Region | None:
        """Paint the sphere; return what it touched, or None when it is outside the picture."""
        height, width = scene.shape[:2]
        half = int(np.ceil(1.42 * radius_px))
        column, row = round(center.x_px), round(center.y_px)
        x0, x1 = max(0, column - half), min(width, column + half + 1)
        y0, y1 = max(0, row - half), min(height, row + half + 1)
        if x0 >= x1 or y0 >= y1:
            return None
        columns = np.arange(x0 - column, x1 - column, dtype=np.float32)[None, :]
        rows = np.arange(y0 - row, y1 - row, dtype=np.float32)[:, None]
        unit = np.float32(1.0 / radius_px)
        x = (columns - np.float32(center.x_px - column)) * unit
        y = (rows - np.float32(center.y_px - row)) * unit
        region = (slice(y0, y1), slice(x0, x1))
        blend(scene[region], *self._look(x, y, radius_px))
        return region

    def _look(self, x: Float32Array, y: Float32Array, radius_px: float) -> tuple[ByteArray, ByteArray]:
        """Return the share of light let through and the own gray, on coordinates of unit radius."""
        square = x * x + y * y
        cover: Float32Array = np.clip(
            (1.0 - np.sqrt(square)) * np.float32(radius_px / (2.2 * self._blur_px)) + 0.5,
            np.float32(0.0),
            np.float32(1.0),
        )
        cover *= cover * (3.0 - 2.0 * cover)
        gray = 40.0 * np.sqrt(np.maximum(np.float32(0.0), 1.0 - square)) - (10.2 * x + 13.6 * y)
        gray += 150.0 * _bell(x + 0.29, 0.14) * _bell(y + 0.37, 0.14)
        gray += 34.0 * _bell(x - 0.38, 0.25) * _bell(y - 0.34, 0.25)
        gray += np.float32(27.0 - self._offset)
        depth = np.maximum(np.float32(0.0), 1.0 - ((x - 0.16) ** 2 + (y - 0.2) ** 2) / np.float32(1.2**2))
        shadow = np.float32(0.36) * depth * depth
        clear = (1.0 - cover) * (1.0 - shadow)
        return to_bytes(255.0 * clear), to_bytes(np.maximum(cover * gray, np.float32(0.0)))


def _bell(t: Float32Array, sigma: float) -> Float32Array:
    bell: Float32Array = np.exp(t * t * np.float32(-0.5 / sigma**2))
    return bell
