"""Finds the robot anywhere in a picture: a template on a small copy proposes, the rim fit disposes."""

from collections.abc import Iterator

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray, Float32Array
from mrnav_server.vision.rim import RimEstimate, RimFit

_CANDIDATES = 6
_MATCH_MIN = 0.35
_CERTAIN = 0.75
"""A candidate as good as this ends the search."""
_RIM_SHARE = 0.3
"""Width of the rim of a sphere that focuses light into its middle, in radii."""


class Redetector:
    """Searches a whole picture for a disc of known radius.

    Args:
        rim: The fit that verifies candidates; it knows the polarity too.
        radius_tolerance: Share by which the fitted radius may differ from the known one.
    """

    def __init__(self, rim: RimFit, radius_tolerance: float) -> None:
        self._rim = rim
        self._tolerance_px = radius_tolerance * rim.radius_px
        # A quarter of the scale, unless the disc would shrink to fewer than about five pixels of radius.
        self._step = int(np.clip(rim.radius_px // 5.0, 1, 4))
        radius_px = rim.radius_px / self._step
        half = int(radius_px) + 6
        grid = np.arange(-half, half + 1, dtype=np.float32)
        inside = np.clip(radius_px - np.hypot(grid[None, :], grid[:, None]) + 0.5, 0.0, 1.0)
        hollow = inside - np.clip(
            (1.0 - _RIM_SHARE) * radius_px - np.hypot(grid[None, :], grid[:, None]) + 0.5, 0.0, 1.0
        )
        sign = -1.0 if rim.polarity == "dark" else 1.0
        self._disc: Float32Array = (sign * inside).astype(np.float32)
        # A clear sphere is dark at its rim alone: its middle is a lens and as bright as what surrounds it.
        self._ring: Float32Array = (sign * hollow).astype(np.float32)
        self._half = half
        self._blank_px = max(1, round(0.8 * radius_px))

    def find(self, image: ByteArray) -> RimEstimate | None:
        """Return the best disc, or None if no candidate has the right radius and any agreeing rim.

        Args:
            image: Shape (height, width, 3), BGR, uint8.
        """
        small = self._small(image)
        best: RimEstimate | None = None
        for template in (self._disc, self._ring):
            for x_px, y_px in self._candidates(image, small, template):
                found = self._rim.fit_in(image, x_px, y_px)
                if abs(found.radius_px - self._rim.radius_px) > self._tolerance_px or found.confidence == 0.0:
                    continue
                if best is None or found.confidence > best.confidence:
                    best = found
                if best.confidence > _CERTAIN:
                    return best
        return best

    def _small(self, image: ByteArray) -> Float32Array:
        """Return a small gray copy of a picture, with a margin."""
        step, half = self._step, self._half
        size = (image.shape[1] // step, image.shape[0] // step)
        # Every other row says enough about a disc that is several small pixels wide.
        gray = cv2.cvtColor(image[:: max(1, step // 2)], cv2.COLOR_BGR2GRAY)
        small = cv2.resize(gray, size, interpolation=cv2.INTER_AREA)
        # A robot at the picture's edge would have no place for the template's centre otherwise.
        margined = cv2.copyMakeBorder(small, half, half, half, half, cv2.BORDER_REPLICATE)
        return margined.astype(np.float32)

    def _candidates(
        self, image: ByteArray, small: Float32Array, template: Float32Array
    ) -> Iterator[tuple[float, float]]:
        """Yield where a template fits best, best first, in full-scale pixels."""
        step = self._step
        match = cv2.matchTemplate(small, template, cv2.TM_CCOEFF_NORMED)
        for _ in range(_CANDIDATES):
            _, score, _, (column, row) = cv2.minMaxLoc(match)
            if score < _MATCH_MIN:
                return
            cv2.circle(match, (column, row), self._blank_px, -1.0, -1)
            x_px, y_px = (column + 0.5) * step - 0.5, (row + 0.5) * step - 0.5
            yield min(max(x_px, 0.0), image.shape[1] - 1.0), min(max(y_px, 0.0), image.shape[0] - 1.0)
