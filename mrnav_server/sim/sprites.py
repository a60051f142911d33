"""Sprites of the simulated picture: how one is blended in, and the robot's sphere."""

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray, Float32Array
from mrnav_server.core.frames import ImagePoint

Region = tuple[slice, slice]
"""Rows and columns of the picture that a sprite has touched."""


def blend(pixels: ByteArray, sprite: ByteArray) -> None:
    """Dim pixels to the share of light let through, and add a sprite's own gray, in place.

    Args:
        pixels: Shape (h, w, 3), uint8.
        sprite: Share of light let through, 0..255, and the sprite's gray times its opacity, shape
            (2, h, w), uint8.
    """
    clear, own = sprite
    cv2.multiply(pixels, cv2.cvtColor(clear, cv2.COLOR_GRAY2BGR), pixels, 1.0 / 255.0)
    cv2.add(pixels, cv2.cvtColor(own, cv2.COLOR_GRAY2BGR), pixels)


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
        blend(scene[region], self._look(x, y, radius_px))
        return region

    def _look(self, x: Float32Array, y: Float32Array, radius_px: float) -> ByteArray:
        """Return the share of light let through and the own gray, on coordinates of unit radius.

        Args:
            x: Shape (1, w).
            y: Shape (h, 1).
            radius_px: How many pixels the unit is.
        """
        depth = (1.0 - np.float32(1.2**-2) * (x - 0.16) ** 2) - np.float32(1.2**-2) * (y - 0.2) ** 2
        np.maximum(depth, np.float32(0.0), out=depth)
        sprite = np.zeros((2, *depth.shape), np.float32)
        # The shadow reaches further than the sphere.
        soft = np.float32(2.2 * self._blur_px / radius_px)
        rows, columns = (_within(axis.ravel(), 1.0 + float(soft)) for axis in (y, x))
        x, y = x[:, columns], y[rows]
        square = x * x + y * y
        cover = (1.0 - np.sqrt(square)) / soft
        cover += np.float32(0.5)
        np.minimum(np.maximum(cover, np.float32(0.0), out=cover), np.float32(1.0), out=cover)
        cover *= cover * (3.0 - 2.0 * cover)
        gray = (np.float32(27.0 - self._offset) - 10.2 * x) - 13.6 * y
        gray += 40.0 * np.sqrt(np.maximum(np.float32(0.0), 1.0 - square))
        gray += 150.0 * _bell(x + 0.29, 0.14) * _bell(y + 0.37, 0.14)
        gray += 34.0 * _bell(x - 0.38, 0.25) * _bell(y - 0.34, 0.25)
        clear, own = sprite
        np.multiply(depth, depth * np.float32(-0.36 * 255.0), out=clear)
        clear += np.float32(255.0)
        clear[rows, columns] *= 1.0 - cover
        own[rows, columns] = np.maximum(cover * gray, np.float32(0.0), out=gray)
        sprite += np.float32(0.5)
        return sprite.astype(np.uint8)


def _within(axis: Float32Array, reach: float) -> slice:
    """Return the places on an increasing axis that are no further from 0."""
    return slice(*np.searchsorted(axis, [-reach, reach]).tolist())


def _bell(t: Float32Array, sigma: float) -> Float32Array:
    bell: Float32Array = np.exp(t * t * np.float32(-0.5 / sigma**2))
    return bell
