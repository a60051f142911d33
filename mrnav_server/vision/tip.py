"""Locates the magnet in the live picture, near where the calibration expects it.

The magnet hangs more than a centimetre above the focus, so it is a blurred shade and no outline. Its
silhouette is drawn as the calibration says, blurred as the pupil blurs it, and moved to where magnet, needle
and an even change of light together explain best what the floor has lost.
"""

import math
from dataclasses import dataclass, fields

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray, Float32Array, FloatArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import Calibration, ImagePoint, StagePoint

_STEP = 4
"""Everything is done on a picture this many times smaller; the shade has no finer detail."""
_WINDOW_UM = 2600.0
"""Half the side of what is compared, at the magnet's height."""
_SEARCH_UM = 900.0
_APART_UM = 2500.0
_FEWEST_PLACES = 5
_MOST_PLACES = 9
_METAL = 70.0
"""Gray of metal; a floor no brighter than this shows no shade on it."""
_ROBOT = 1.6
"""What lies within so many radii of the robot is not looked at, for its shadow."""
_NEEDLE_UM = 5000.0
_SLICES = 24
_PLACES = 40.0
"""What is not explained is coarse, walls and sheen: so many places of it are independent."""
_SURE_SHADE = 0.3
"""Opacity of the magnet from which on it counts in full."""


@dataclass(frozen=True)
class TipLook:
    """The end-effector's shape, as its maker states it, and the camera's pupil.

    Attributes:
        magnet_diameter_um: Diameter of the magnet in µm, 50..20000.
        magnet_length_um: Its length in µm, along the needle, 50..20000.
        needle_diameter_um: Diameter of the needle behind it in µm, 10..10000.
        tilt_deg: The needle's tilt from the vertical, 0..80°.
        azimuth_deg: Direction in the stage's x-y plane in which the needle rises, from x to y, -360..360°.
        pupil_um: Diameter of the camera's entrance pupil, which sets the blur, in µm, 0..100000.
        systematic_um: Error of the place that no noise explains (sheen, blur that is not as stated) in µm,
            1..1000.
        spread_max_um: A place less certain than this is none, in µm, 10..1000.
        confidence_min: Least share of the shade that must be explained, 0.3..1.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    magnet_diameter_um: float = 1000.0
    magnet_length_um: float = 2000.0
    needle_diameter_um: float = 450.0
    tilt_deg: float = 45.0
    azimuth_deg: float = -15.0
    pupil_um: float = 3000.0
    systematic_um: float = 25.0
    spread_max_um: float = 120.0
    confidence_min: float = 0.6

    def __post_init__(self) -> None:
        for field in fields(self):
            low, high = _RANGES[field.name]
            value = getattr(self, field.name)
            if not low <= value <= high:
                raise ConfigError(f"tip {field.name} is {value}: set it to {low:g}..{high:g}")


_RANGES = {
    "magnet_diameter_um": (50, 20_000),
    "magnet_length_um": (50, 20_000),
    "needle_diameter_um": (10, 10_000),
    "tilt_deg": (0, 80),
    "azimuth_deg": (-360, 360),
    "pupil_um": (0, 100_000),
    "systematic_um": (1, 1000),
    "spread_max_um": (10, 1000),
    "confidence_min": (0.3, 1),
}


@dataclass(frozen=True, slots=True)
class TipSighting:
    """Where the tip was seen.

    Attributes:
        image: The magnet's centre in image pixels.
        expected: Where the calibration puts it.
        sigma_px: Standard deviation along either axis.
        um_per_px: Size of an image pixel at the magnet's height, in µm.
        confidence: Share of the shade that magnet and needle explain, 0..1.
    """

    image: ImagePoint
    expected: ImagePoint
    sigma_px: float
    um_per_px: float
    confidence: float

    @property
    def off_um(self) -> float:
        """Distance from where the calibration expects the tip, at the magnet's height, in µm."""
        return self.um_per_px * math.hypot(
            self.image.x_px - self.expected.x_px, self.image.y_px - self.expected.y_px
        )


class TipFinder:
    """Locates the magnet in pictures of a scene that it has seen with the tip at several places.

    Args:
        look: The end-effector's shape.
        calibration: Where things appear.
    """

    def __init__(self, look: TipLook, calibration: Calibration) -> None:
        self._look = look
        self._calibration = calibration
        tilt, azimuth = math.radians(look.tilt_deg), math.radians(look.azimuth_deg)
        run = math.sin(tilt)
        self._rise = math.cos(tilt)
        self._axis = np.array([run * math.cos(azimuth), run * math.sin(azimuth), self._rise])
        self._places: list[tuple[StagePoint, Float32Array]] = []
        self._floor: Float32Array | None = None

    @property
    def is_ready(self) -> bool:
        """Whether pictures with the tip at enough places were learned."""
        return self._floor is not None

    def learn(self, image: ByteArray, tip: StagePoint) -> None:
        """Take in a picture, if the tip has moved on since the others; the floor is their median.

        Args:
            image: Shape (height, width, 3), BGR, uint8.
            tip: Where the tip was.
        """
        near = [p for p, _ in self._places if math.hypot(p.x_um - tip.x_um, p.y_um - tip.y_um) < _APART_UM]
        if near or len(self._places) >= _MOST_PLACES:
            return
        self._places.append((tip, _small(image)))
        if len(self._places) >= _FEWEST_PLACES:
            self._floor = np.median([picture for _, picture in self._places], axis=0).astype(np.float32)

    def find(
        self, image: ByteArray, tip: StagePoint, robot: ImagePoint | None = None, robot_radius_px: float = 0.0
    ) -> TipSighting | None:
        """Return the magnet near where it is expected, or None if it is not seen for sure.

        Args:
            image: Shape (height, width, 3), BGR, uint8.
            tip: Where the manipulator says that the tip is.
            robot: Where the robot is, which is left out; None if it is nowhere.
            robot_radius_px: The robot's radius.
        """
        if self._floor is None:
            return None
        expected = self._calibration.tip_in_image(tip)
        um_per_px = 1.0 / max(self._px_per_um(tip), 1e-9)
        half = math.ceil(_WINDOW_UM / um_per_px / _STEP)
        search = math.ceil(_SEARCH_UM / um_per_px / _STEP)
        column, row = round((expected.x_px + 0.5) / _STEP - 0.5), round((expected.y_px + 0.5) / _STEP - 0.5)
        reach = half + search
        small = _small(image)
        if not (reach <= row < small.shape[0] - reach and reach <= column < small.shape[1] - reach):
            return None
        box = (slice(row - reach, row + reach + 1), slice(column - reach, column + reach + 1))
        room = np.maximum(self._floor[box] - np.float32(_METAL), np.float32(0.0))
        loss = self._floor[box] - small[box]
        looked = np.ones_like(loss)
        if robot is not None:
            at = (
                (robot.x_px + 0.5) / _STEP - 0.5 - box[1].start,
                (robot.y_px + 0.5) / _STEP - 0.5 - box[0].start,
            )
            cv2.circle(looked, (round(at[0]), round(at[1])), round(_ROBOT * robot_radius_px / _STEP), 0.0, -1)
        parts = self._silhouette(tip, half, ((column + 0.5) * _STEP - 0.5, (row + 0.5) * _STEP - 0.5))
        unexplained, magnet = _explain(loss, room, looked, parts)
        _, _, (x, y), _ = cv2.minMaxLoc(unexplained)
        if not (0 < x < 2 * search and 0 < y < 2 * search):
            return None
        patch = unexplained[y - 1 : y + 2, x - 1 : x + 2].astype(np.float64)
        dx, dy = _lowest(patch)
        confidence = (1.0 - float(unexplained[y, x])) * min(1.0, float(magnet[y, x]) / _SURE_SHADE)
        confidence *= _looked_at(looked[y : y + 2 * half + 1, x : x + 2 * half + 1], parts[0])
        if confidence < self._look.confidence_min:
            return None
        center = ImagePoint(
            (column + x - search + dx + 0.5) * _STEP - 0.5, (row + y - search + dy + 0.5) * _STEP - 0.5
        )
        spread_px = _STEP * _spread(unexplained.astype(np.float64), x + dx, y + dy)
        if spread_px * um_per_px > self._look.spread_max_um:
            return None
        sigma_px = math.hypot(spread_px, self._look.systematic_um / um_per_px)
        return TipSighting(center, expected, sigma_px, um_per_px, confidence)

    def _project(self, tip: StagePoint, length_um: float) -> FloatArray:
        """Return where a point on the needle's axis appears, in image pixels."""
        x, y, z = tip.array() + length_um * self._axis
        seen = self._calibration.tip_in_image(StagePoint(x, y, z))
        return np.array([seen.x_px, seen.y_px])

    def _px_per_um(self, tip: StagePoint, length_um: float = 0.0) -> float:
        """Return the image's scale at a point on the axis."""
        x, y, z = tip.array() + length_um * self._axis
        a = self._calibration.tip_in_image(StagePoint(x - 100.0, y, z))
        b = self._calibration.tip_in_image(StagePoint(x + 100.0, y, z))
        return math.hypot(b.x_px - a.x_px, b.y_px - a.y_px) / 200.0

    def _blur(self, tip: StagePoint) -> float:
        """Return the radius of the blur in small pixels: a point at height z is (k - 1) pupils wide."""
        depth_um = self._calibration.working_distance_um
        zoom = depth_um / max(depth_um - self._calibration.height_um(tip), 1.0)
        return (zoom - 1.0) * 0.5 * self._look.pupil_um * self._px_per_um(tip) / zoom / _STEP

    def _silhouette(self, tip: StagePoint, half: int, middle_px: tuple[float, float]) -> list[Float32Array]:
        """Draw the opacity of magnet and needle, and the sheen that lightens one side of the magnet.

        A cross-section of a rod appears as an ellipse, short along the rod; a rod is all of them together.
        """
        look = self._look
        side = 2 * half + 1
        ahead = self._project(tip, 100.0) - self._project(tip, -100.0)
        angle = math.degrees(math.atan2(ahead[1], ahead[0]))
        drawn = []
        for low_um, high_um, diameter_um in (
            (-0.5 * look.magnet_length_um, 0.5 * look.magnet_length_um, look.magnet_diameter_um),
            (0.5 * look.magnet_length_um, _NEEDLE_UM, look.needle_diameter_um),
        ):
            part = np.zeros((side, side), np.uint8)
            for length_um in np.linspace(low_um, high_um, _SLICES):
                at = (self._project(tip, length_um) - np.asarray(middle_px)) / _STEP + half
                radius = 0.5 * diameter_um * self._px_per_um(tip, length_um) / _STEP
                axes = (round(16 * radius * self._rise), round(16 * radius))
                center = (round(16 * at[0]), round(16 * at[1]))
                cv2.ellipse(part, center, axes, angle, 0, 360, 255, -1, cv2.LINE_AA, shift=4)
            drawn.append(part.astype(np.float32) / np.float32(255.0))
        sigma = max(0.5 * self._blur(tip), 0.5)
        magnet, needle = (cv2.GaussianBlur(part, (0, 0), sigma).astype(np.float32) for part in drawn)
        y, x = np.mgrid[0:side, 0:side].astype(np.float32)
        at = (self._project(tip, 0.0) - np.asarray(middle_px)) / _STEP + half
        across = (ahead[0] * (y - at[1]) - ahead[1] * (x - at[0])) / np.float32(math.hypot(*ahead))
        sheen = magnet * across / np.float32(0.5 * look.magnet_diameter_um * self._px_per_um(tip) / _STEP)
        return [magnet, needle * (np.float32(1.0) - magnet), sheen.astype(np.float32)]


def _small(image: ByteArray) -> Float32Array:
    size = (image.shape[1] // _STEP, image.shape[0] // _STEP)
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(small, cv2.COLOR_BGR2GRAY).astype(np.float32)


def _explain(
    loss: Float32Array, room: Float32Array, looked: Float32Array, parts: list[Float32Array]
) -> tuple[Float32Array, Float32Array]:
    """Return, for every shift, the share of the loss that is left unexplained, and the magnet's opacity.

    At every shift the loss is fitted, by least squares over what is looked at, by a constant, and by each
    part times the room between floor and metal. All sums over windows are correlations.

    Args:
        loss: Gray levels that the floor has lost, shape (h, w).
        room: Gray levels that it has to lose.
        looked: 1 where it counts, 0 elsewhere.
        parts: Opacity of the magnet, of the needle, and what else there may be, shape (h', w') each.
    """
    one = np.ones_like(parts[0])
    lit, dark = looked * room, looked * loss
    room_2, gain = lit * room, dark * room

    def sums(values: Float32Array, window: Float32Array) -> FloatArray:
        return np.asarray(cv2.matchTemplate(values, window, cv2.TM_CCORR), np.float64)

    size = 1 + len(parts)
    gram = np.empty((*sums(looked, one).shape, size, size))
    gram[..., 0, 0] = sums(looked, one)
    for i, part in enumerate(parts, 1):
        gram[..., 0, i] = gram[..., i, 0] = sums(lit, part)
        for j in range(i, size):
            gram[..., i, j] = gram[..., j, i] = sums(room_2, part * parts[j - 1])
    gram += 1e-3 * np.eye(size)
    along = np.stack([sums(dark, one), *(sums(gain, part) for part in parts)], -1)
    weights = np.linalg.solve(gram, along[..., None])[..., 0]
    square = sums(dark * loss, one)
    left = square - np.sum(weights * along, axis=-1)
    variance = square - along[..., 0] ** 2 / gram[..., 0, 0]
    share = left / np.maximum(variance, 1e-6)
    return share.astype(np.float32), weights[..., 1].astype(np.float32)


def _looked_at(looked: Float32Array, part: Float32Array) -> float:
    """Return the share of a part that is looked at."""
    return float(np.sum(looked * part, dtype=np.float64) / np.sum(part, dtype=np.float64))


def _lowest(patch: FloatArray) -> tuple[float, float]:
    """Return where a paraboloid through 3 by 3 samples is lowest, (x, y) from the middle."""
    gx, gy = 0.5 * (patch[1, 2] - patch[1, 0]), 0.5 * (patch[2, 1] - patch[0, 1])
    xx, yy = patch[1, 2] - 2.0 * patch[1, 1] + patch[1, 0], patch[2, 1] - 2.0 * patch[1, 1] + patch[0, 1]
    xy = 0.25 * (patch[2, 2] - patch[2, 0] - patch[0, 2] + patch[0, 0])
    det = xx * yy - xy * xy
    if det <= 0.0:
        return 0.0, 0.0
    dx, dy = (xy * gy - yy * gx) / det, (xy * gx - xx * gy) / det
    return float(np.clip(dx, -1.0, 1.0)), float(np.clip(dy, -1.0, 1.0))


def _spread(unexplained: FloatArray, x: float, y: float) -> float:
    """Return the standard deviation of the place along its worst direction.

    Places are weighed by their likelihood, so that a second place that explains as much is told as well.
    """
    best = float(unexplained.min())
    weight = np.exp(-0.5 * _PLACES * (unexplained - best) / max(best, 1e-6))
    weight /= weight.sum()
    dy, dx = np.mgrid[0 : weight.shape[0], 0 : weight.shape[1]] - np.array([y, x])[:, None, None]
    xx, yy, xy = (float(np.sum(weight * product)) for product in (dx * dx, dy * dy, dx * dy))
    return math.sqrt(0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy))
