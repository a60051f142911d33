"""Measures the robot's radius and polarity in one picture that shows it and nothing else of its size."""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray, Float32Array
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import ImagePoint
from mrnav_server.vision.rim import Polarity, RimEstimate, RimFit

_LARGEST_SIDE_PX = 600
"""Circles are proposed on a copy of the picture no larger than this."""
_BAND = 1.3
"""Circles are proposed in bands of radii, each so many times the last: of two about one centre both are."""
_CANDIDATES = 12
"""So many are proposed in each band."""
_AROUND = 0.5
"""A circle around another is the robot's rim if its edge is at least so strong: no halo, no ripple is."""
_SURE = 0.7
"""Least confidence of the circle that is measured."""
_DOUBT = 0.4
"""A circle around the surest one that is no surer than this is chance."""
_LEAD = 1.3
"""The runner-up elsewhere must be less confident by this factor."""
_EDGE = 25.0


@dataclass(frozen=True, slots=True)
class RobotLook:
    """What a robot looks like.

    Attributes:
        radius_px: Its radius in image pixels.
        radius_um: The same in µm.
        polarity: Whether it is darker or brighter than what surrounds it.
        confidence: Share of its rim that agrees, times how strong that is, 0..1.
        center: Where it was measured.
        spread_px: Standard deviation of the radius, by what the rays to its rim differ.
    """

    radius_px: float
    radius_um: float
    polarity: Polarity
    confidence: float
    center: ImagePoint
    spread_px: float


def measure_robot(
    image: ByteArray, um_per_px: float, radius_um: tuple[float, float] = (50.0, 1500.0)
) -> RobotLook:
    """Measure the one disc in a picture.

    Circles are proposed from the gradient and each is fitted to its rim for both polarities; the radius of
    the fit is the result, so it does not depend on what was proposed. Of circles within one another the
    outermost clear one counts: a highlight or the bright middle of a clear sphere is no robot.

    Args:
        image: Shape (height, width, 3), BGR, uint8.
        um_per_px: Size of an image pixel on the channel's floor, in µm.
        radius_um: Smallest and largest radius that is looked for, in µm.

    Raises:
        RefusedError: If no circle is sure enough, or two are; with the remedy.
    """
    smallest_px, largest_px = (radius / um_per_px for radius in radius_um)
    smallest_px = max(smallest_px, 6.0)
    largest_px = min(largest_px, min(image.shape[:2]) / 2.0)
    if largest_px <= smallest_px:
        raise RefusedError(
            "robot_not_measured", "the robot would be smaller than 6 pixels or wider than the picture: zoom"
        )
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.uint8, copy=False)
    looks: list[RobotLook] = []
    for x_px, y_px, radius_px in _circles(gray, smallest_px, largest_px):
        look = _best(gray, x_px, y_px, radius_px, um_per_px)
        if look is not None and smallest_px <= look.radius_px <= largest_px:
            looks.append(look)
    looks.sort(key=lambda look: look.confidence, reverse=True)
    if not looks or looks[0].confidence < _SURE:
        raise RefusedError(
            "robot_not_measured",
            "no disc is clear enough to be measured: bring the robot into the open, in focus and away from"
            " the magnet",
        )
    best = _outermost(gray, looks)
    for other in looks:
        # What lies within one another has been decided.
        apart = not _holds(best, other) and not _holds(other, best)
        if apart and other.confidence * _LEAD > best.confidence:
            raise RefusedError(
                "robot_not_measured",
                f"there is more than one disc (radius {best.radius_px:.1f} px and {other.radius_px:.1f} px):"
                " show the robot alone",
            )
    return best


def _outermost(gray: ByteArray, looks: list[RobotLook]) -> RobotLook:
    """Return the circle that bounds the surest one, or that itself."""
    best = looks[0]
    contrast = _contrast(gray, best)
    for other in sorted(looks, key=lambda look: look.radius_px):
        if other.radius_px < 1.05 * best.radius_px or not _holds(other, best):
            continue
        strong = _contrast(gray, other)
        if strong < _AROUND * contrast:
            continue
        if other.confidence >= _SURE:
            best, contrast = other, max(contrast, strong)
        elif other.confidence > _DOUBT:
            raise RefusedError(
                "robot_not_measured",
                f"a disc of {best.radius_px:.1f} px lies in one of {other.radius_px:.1f} px that is less"
                " clear: light the robot more evenly, or narrow the radii that are looked for",
            )
    return best


def _holds(outer: RobotLook, inner: RobotLook) -> bool:
    """Whether a circle lies within another, or is nearly the same."""
    apart_px = math.hypot(outer.center.x_px - inner.center.x_px, outer.center.y_px - inner.center.y_px)
    return apart_px + inner.radius_px < 1.05 * outer.radius_px + 1.0


def _contrast(gray: ByteArray, look: RobotLook) -> float:
    """Return by how many gray levels the two sides of a rim differ."""
    angles = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    beside_px = max(1.5, 0.08 * look.radius_px)
    radii_px = look.radius_px + np.array([[-beside_px], [beside_px]])
    samples = cv2.remap(
        gray,
        (look.center.x_px + radii_px * np.cos(angles)).astype(np.float32),
        (look.center.y_px + radii_px * np.sin(angles)).astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    inside, outside = np.median(samples, axis=1).tolist()
    return float(abs(outside - inside))


def _circles(gray: ByteArray, smallest_px: float, largest_px: float) -> list[tuple[float, float, float]]:
    """Propose circles (x, y, radius), band by band, most votes first."""
    # Hough needs a few pixels of radius.
    scale = min(1.0, max(_LARGEST_SIDE_PX / max(gray.shape), 5.0 / smallest_px))
    size = (round(gray.shape[1] * scale), round(gray.shape[0] * scale))
    small = cv2.resize(gray, size, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), 1.0)
    proposed: list[tuple[float, float, float]] = []
    least_px = smallest_px
    while least_px < largest_px:
        most_px = min(least_px * _BAND, largest_px)
        found = cv2.HoughCircles(
            small,
            cv2.HOUGH_GRADIENT,
            dp=1.0,
            minDist=max(8.0, scale * least_px),
            param1=60,
            param2=14,
            minRadius=max(4, int(scale * least_px)),
            maxRadius=max(5, math.ceil(scale * most_px)),
        )
        least_px = most_px
        if found is None:
            continue
        circles: Float32Array = np.asarray(found, np.float32).reshape(-1, found.shape[-1])[:_CANDIDATES]
        proposed += [
            ((float(x) + 0.5) / scale - 0.5, (float(y) + 0.5) / scale - 0.5, float(radius) / scale)
            for x, y, radius in circles[:, :3]
        ]
    return proposed


def _best(gray: ByteArray, x_px: float, y_px: float, radius_px: float, um_per_px: float) -> RobotLook | None:
    """Return a proposed circle as measured, by the polarity that fits better."""
    best: RobotLook | None = None
    polarities: tuple[Polarity, ...] = ("dark", "bright")
    for polarity in polarities:
        found = _settled(gray, x_px, y_px, radius_px, polarity)
        if found is not None and (best is None or found.confidence > best.confidence):
            best = RobotLook(
                found.radius_px,
                found.radius_px * um_per_px,
                polarity,
                found.confidence,
                ImagePoint(found.x_px, found.y_px),
                found.radius_sigma_px,
            )
    return best


def _settled(
    gray: ByteArray, x_px: float, y_px: float, radius_px: float, polarity: Polarity
) -> RimEstimate | None:
    """Fit until the radius that is found is the one that was assumed; its prior then pulls nowhere."""
    for _ in range(8):
        found = RimFit(radius_px, _EDGE, 0.0, polarity).fit(gray, x_px, y_px)
        if found.confidence == 0.0 or found.radius_px < 4.0:
            return None
        settled = abs(found.radius_px - radius_px) < 0.02
        x_px, y_px, radius_px = found.x_px, found.y_px, found.radius_px
        if settled:
            return found
    return None
