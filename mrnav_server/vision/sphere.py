"""Sees a sphere of known radius: the rim fit where it is expected, re-detection where it is not."""

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.frames import ImagePoint
from mrnav_server.vision.detector import Sighting
from mrnav_server.vision.redetect import Redetector
from mrnav_server.vision.rim import RimEstimate, RimFit


class SphereDetector:
    """Sees a disc of known radius.

    Args:
        rim: The fit; it knows radius and polarity.
        radius_tolerance: Share by which the fitted radius may differ from the known one.
    """

    def __init__(self, rim: RimFit, radius_tolerance: float) -> None:
        self.radius_px = rim.radius_px
        self._rim = rim
        self._tolerance_px = radius_tolerance * rim.radius_px
        self._redetector = Redetector(rim, radius_tolerance)

    def find(self, image: ByteArray) -> Sighting | None:
        """Return the best disc of a picture, or None if none has the right radius."""
        found = self._redetector.find(image)
        return None if found is None else _sighting(found)

    def follow(self, image: ByteArray, near: ImagePoint) -> Sighting | None:
        """Return the disc within reach of a point, or None if its radius is another one."""
        height, width = image.shape[:2]
        if not (0.0 <= near.x_px < width and 0.0 <= near.y_px < height):
            return None
        found = self._rim.fit_in(image, near.x_px, near.y_px)
        if found.confidence == 0.0 or abs(found.radius_px - self.radius_px) > self._tolerance_px:
            return None
        return _sighting(found)


def _sighting(found: RimEstimate) -> Sighting:
    return Sighting(found.x_px, found.y_px, found.confidence, found.sigma_px)
