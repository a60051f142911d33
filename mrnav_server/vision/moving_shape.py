"""Sees a robot of any shape, such as a helix or a swarm, by what it adds to a background that is learned.

The magnet and its needle move too, but far above the focus. So a robot is where the picture has sharp edges
that the background has not, within a circle of known size; its centre is the centroid of what is darker (or
brighter) than the background there.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from mrnav_server.core.arrays import BoolArray, ByteArray, Float32Array
from mrnav_server.core.frames import ImagePoint
from mrnav_server.vision.detector import Sighting
from mrnav_server.vision.rim import Polarity

_AGREES = 12.0
"""A picture that differs by less gray than this shows the background, whose light may drift."""
_DRIFT = 0.05
"""Share by which the background follows the picture, each frame, where they agree."""
_ABSORB = 0.02
"""The same where something covers it that is not the robot: a needle that stays becomes background."""
_KEPT = 1.7
"""Within so many radii of a robot that is followed nothing is absorbed."""
_EXTENT = (0.45, 1.35)
"""The circle round what is seen may be smaller or larger than the known one by these factors."""
_REACH = 2.0
"""A robot is followed within so many of its radii."""
_SHAPE_SIGMA = 0.015
"""Standard deviation of a whole shape's centroid in radii: shadow, threshold, edges that are not seen."""
_HIDDEN_SIGMA = 0.5
"""The same for the share of the shape that is hidden ..."""
_FLICKER = 0.05
"""... beyond this share, by which a whole shape's area varies."""
_SHADED_SIGMA = 0.08
"""The same under a needle that darkens the floor by ``_FULL_SHADE`` gray levels or more."""
_FULL_SHADE = 40.0
_LEARN_MORE, _LEARN_LESS = 0.3, 0.003
"""Shares by which the shape's known area grows and shrinks towards what is seen: it may be hidden in part."""
_LEAST_AREA = 0.1
"""The least that a robot fills of its circle."""
_RING = 3
"""Small pixels around what is seen, which tell how the floor is shaded there."""


@dataclass(frozen=True, slots=True)
class _Blob:
    """What might be the robot, in pixels of the small picture."""

    x: float
    y: float
    area: float
    strength: float
    shade: float


class MovingShapeDetector:
    """Sees whatever differs from the background, is in focus and has the robot's size.

    It learns all the time: a pixel is trusted when it has shown the same for ``learning_frames``. What is
    uncovered is learned anew at once, so a robot that was still at the start is found when it has moved.

    Args:
        radius_px: Radius of the smallest circle round the robot.
        edge_strength: Gray levels over two pixels at which its edges count in full.
        polarity: Whether the robot is darker or brighter than the background.
        learning_frames: Pictures in which a pixel must agree with the background to be trusted.
    """

    def __init__(
        self, radius_px: float, edge_strength: float, polarity: Polarity, learning_frames: int
    ) -> None:
        self.radius_px = radius_px
        self._edge_strength = edge_strength
        self._sign = np.float32(1.0 if polarity == "dark" else -1.0)
        # Small enough to be quick; centroids keep their place in a picture averaged over areas.
        self._step = int(np.clip(radius_px // 6.0, 1, 4))
        self._radius = radius_px / self._step
        self._learning_frames = learning_frames
        self._background: Float32Array | None = None
        self._agreed: Float32Array | None = None
        self._area = 0.0
        size = 2 * max(1, round(0.35 * self._radius)) + 1
        self._closing = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))

    def find(self, image: ByteArray) -> Sighting | None:
        """Return the most evident shape of a picture."""
        small = self._small(image)
        background, trusted = self._learn(small, None)
        best = max(
            self._blobs(small, background, trusted), key=lambda blob: blob.area * blob.strength, default=None
        )
        if best is None:
            return None
        return self._sighting(best)

    def follow(self, image: ByteArray, near: ImagePoint) -> Sighting | None:
        """Return the shape nearest to a point, within two radii."""
        small = self._small(image)
        x, y = (near.x_px + 0.5) / self._step - 0.5, (near.y_px + 0.5) / self._step - 0.5
        background, trusted = self._learn(small, self._window(small, x, y, _KEPT))
        window = self._window(small, x, y, _REACH + _EXTENT[1])
        if small[window].size == 0:
            return None
        left, top = window[1].start, window[0].start
        blobs = [
            _Blob(blob.x + left, blob.y + top, blob.area, blob.strength, blob.shade)
            for blob in self._blobs(small[window], background[window], trusted[window])
        ]
        best = min(blobs, key=lambda blob: math.hypot(blob.x - x, blob.y - y), default=None)
        if best is None or math.hypot(best.x - x, best.y - y) > _REACH * self._radius:
            return None
        sighting = self._sighting(best)
        pace = _LEARN_MORE if best.area > self._area else _LEARN_LESS
        self._area += pace * (best.area - self._area)
        return sighting

    def _window(self, small: Float32Array, x: float, y: float, radii: float) -> tuple[slice, slice]:
        """Return the rows and columns within some radii of a point, in small pixels."""
        reach = math.ceil(radii * self._radius)
        height, width = small.shape
        top, left = min(max(0, int(y) - reach), height), min(max(0, int(x) - reach), width)
        return slice(top, max(top, int(y) + reach + 1)), slice(left, max(left, int(x) + reach + 1))

    def _small(self, image: ByteArray) -> Float32Array:
        height, width = image.shape[:2]
        size = (width // self._step, height // self._step)
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA) if self._step > 1 else image
        return cv2.cvtColor(small, cv2.COLOR_BGR2GRAY).astype(np.float32)

    def _learn(
        self, small: Float32Array, robot: tuple[slice, slice] | None
    ) -> tuple[Float32Array, BoolArray]:
        """Take in a picture; return the background at its light, and where it is trusted."""
        if self._background is None or self._agreed is None or self._background.shape != small.shape:
            self._background = small.copy()
            self._agreed = np.zeros_like(small)
        # The lamp may change for all pixels at once; the robot is too small to change the median.
        light = float(np.median(small[::4, ::4])) / max(float(np.median(self._background[::4, ::4])), 1.0)
        lit = self._background * np.float32(light)
        more = self._sign * (lit - small)
        agrees, uncovered = np.abs(more) <= _AGREES, more < -_AGREES
        self._agreed += agrees
        self._agreed[uncovered] = 0.0
        rate = np.where(agrees, np.float32(_DRIFT), np.float32(_ABSORB))
        if robot is not None:
            rate[robot] = np.where(agrees[robot], np.float32(_DRIFT), np.float32(0.0))
        rate[uncovered] = 1.0
        self._background += rate * (small - lit)
        return lit, self._agreed >= self._learning_frames

    def _blobs(self, small: Float32Array, background: Float32Array, trusted: BoolArray) -> list[_Blob]:
        """Return what, on a trusted background, has fresh sharp edges, the right size and the right shade."""
        fresh = _edges(small) - np.float32(1.5) * _edges(background)
        floor = np.float32(0.4 * self._edge_strength)
        seeds: BoolArray = (fresh > floor) & trusted
        closed = cv2.morphologyEx(seeds.astype(np.uint8), cv2.MORPH_CLOSE, self._closing)
        count, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
        more = self._sign * (background - small)
        blobs = []
        for label in range(1, count):
            left, top, width, height, _ = (int(value) for value in stats[label])
            if not _EXTENT[0] * self._radius <= 0.5 * max(width, height) <= _EXTENT[1] * self._radius:
                continue
            left, top = max(0, left - _RING), max(0, top - _RING)
            box = (slice(top, top + height + 2 * _RING), slice(left, left + width + 2 * _RING))
            own = labels[box] == label
            # Where the needle shades robot and floor alike, only what the robot adds counts.
            shade = float(np.median(more[box][~own]))
            added = more[box] - np.float32(shade)
            weight = np.where(own & trusted[box] & (added > _AGREES), added, np.float32(0.0))
            area = float(np.count_nonzero(weight))
            if area < _LEAST_AREA * math.pi * self._radius**2:
                continue
            total = float(weight.sum())
            x = float(weight.sum(axis=0) @ np.arange(weight.shape[1])) / total
            y = float(weight.sum(axis=1) @ np.arange(weight.shape[0])) / total
            sharpness = float(np.mean(fresh[box][own & seeds[box]]))
            blobs.append(_Blob(left + x, top + y, area, min(sharpness, total / area), abs(shade)))
        return blobs

    def _sighting(self, blob: _Blob) -> Sighting:
        """Return a blob in image pixels; what is smaller than what was learned is partly hidden."""
        self._area = self._area or blob.area
        shown = min(1.0, (1.0 + _FLICKER) * blob.area / self._area)
        confidence = shown * min(1.0, blob.strength / self._edge_strength)
        return Sighting(
            (blob.x + 0.5) * self._step - 0.5,
            (blob.y + 0.5) * self._step - 0.5,
            confidence,
            self.radius_px
            * math.hypot(
                _SHAPE_SIGMA,
                _HIDDEN_SIGMA * (1.0 - shown),
                _SHADED_SIGMA * min(1.0, blob.shade / _FULL_SHADE),
            ),
        )


def _edges(gray: Float32Array) -> Float32Array:
    """Return gray levels over two pixels, in the steepest direction."""
    dx = cv2.Sobel(gray, cv2.CV_32F, 1, 0, scale=0.25)
    dy = cv2.Sobel(gray, cv2.CV_32F, 0, 1, scale=0.25)
    return cv2.magnitude(dx, dy).astype(np.float32)
