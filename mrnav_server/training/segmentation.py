"""From a photograph of a printed vessel to its lumen on the grid."""

from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from mrnav_server.core.arrays import BoolArray, ByteArray, Float32Array, IntArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.vision.vessel_model import ROBOT_RADIUS_UM

Polarity = Literal["auto", "bright", "dark"]
GRID_UM_PER_PX = 10.0
MIN_SIZE_PX = 200
MAX_SIZE_PX = 6000
"""Sides of the grid: 2 to 60 mm."""

_SMOOTH_UM = 60.0
"""Noise and print layers are finer than this; the robot is 1000 µm wide."""
_LIGHT_UM = 3000.0
"""Light varies more slowly than this; vessels are narrower than about twice as much."""
_SPECK_UM = 300.0
"""Structures narrower than this are hairs, scratches and noise."""
_HIGHLIGHT_UM = 1000.0
"""Holes narrower than this are bubbles and reflections in the lumen, not tissue between vessels."""


@dataclass(frozen=True, slots=True)
class Segmentation:
    """A lumen on the grid of 10 µm, and the photograph that it was found in.

    Attributes:
        mask: Shape (size, size), uint8, 255 in the lumen.
        photograph: The photograph on the same grid, shape (size, size, 3), uint8, BGR.
        lumen_is: Whether the lumen is the bright or the dark part of the photograph.
        origin_um: Where the grid's upper left corner lies in the photograph (x, y).
    """

    mask: ByteArray
    photograph: ByteArray
    lumen_is: Literal["bright", "dark"]
    origin_um: tuple[float, float]


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
    if min(picture.shape[:2]) < 64:
        height, width = picture.shape[:2]
        raise ConfigError(f"photograph: {path} is {width} x {height} px; 64 px a side are needed at least")
    scaled = picture.astype(np.float32)
    return scaled / max(float(scaled.max()), 1.0)


def segment(
    photograph: Float32Array,
    um_per_px: float,
    robot_radius_um: float = ROBOT_RADIUS_UM,
    polarity: Polarity = "auto",
) -> Segmentation:
    """Find the connected lumen in which the robot has most room.

    The light is flattened, the lumen starts from Otsu's threshold, and its wall is then put half-way between
    the local brightness of lumen and background, so that neither uneven light nor wide vessels shift it. If
    the photograph is larger than the largest grid, the grid holds the part in which the robot has most room.

    Args:
        photograph: Shape (height, width, 3), BGR, 0..1.
        um_per_px: Size of one of its pixels in µm.
        robot_radius_um: Radius of the robot in µm.
        polarity: Whether the lumen is bright or dark; by default it is what takes less of the edge.

    Raises:
        ConfigError: If the size is out of range, there is no lumen, or the robot fits nowhere.
    """
    height_um, width_um = (side * um_per_px for side in photograph.shape[:2])
    if min(height_um, width_um) < MIN_SIZE_PX * GRID_UM_PER_PX:
        raise ConfigError(
            f"photograph: it shows {width_um / 1000:.2g} x {height_um / 1000:.2g} mm at {um_per_px:g} µm/px;"
            f" at least {MIN_SIZE_PX * GRID_UM_PER_PX / 1000:g} mm a side are needed: check the scale"
        )
    work_um = max(um_per_px, GRID_UM_PER_PX)
    picture = _resized(photograph, um_per_px / work_um)
    field = _field_of_view(picture.mean(axis=2), work_um)
    level, lumen_is = _lumen_level(picture, field, work_um, polarity)
    room = _room(_cleaned(level > 0, work_um), robot_radius_um / work_um)
    origin_px, side_px = _window(room, work_um, robot_radius_um)
    grid_level = _on_grid(level, origin_px, side_px, work_um, outside=-1.0)
    lumen = _cleaned(grid_level > 0, GRID_UM_PER_PX)
    kept = _with_most_room(lumen, robot_radius_um / GRID_UM_PER_PX)
    shown = _on_grid(picture, origin_px, side_px, work_um, outside=0.0)
    return Segmentation(
        mask=kept.astype(np.uint8) * 255,
        photograph=(shown * 255).clip(0, 255).astype(np.uint8),
        lumen_is=lumen_is,
        origin_um=(origin_px[0] * work_um, origin_px[1] * work_um),
    )


def _resized(picture: Float32Array, factor: float) -> Float32Array:
    """Shrink a picture; a factor of 1 leaves it as it is."""
    height, width = (max(round(side * factor), 1) for side in picture.shape[:2])
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)


def _field_of_view(gray: Float32Array, um_per_px: float) -> BoolArray:
    """Return where the picture shows anything: an eyepiece leaves a black surround."""
    shown = (gray > 0.08 * np.percentile(gray, 99)).astype(np.uint8)
    outlines, _ = cv2.findContours(shown, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    if outlines:
        outline = max(outlines, key=cv2.contourArea)
        area = cv2.contourArea(outline)
        if 0.4 * gray.size < area and area > 0.95 * cv2.contourArea(cv2.convexHull(outline)):
            disc = np.zeros_like(shown)
            cv2.drawContours(disc, [outline], -1, 1, cv2.FILLED)
            if not disc.all():
                rim = _disc(4 * _SMOOTH_UM / um_per_px)
                return cv2.erode(disc, rim, borderType=cv2.BORDER_REPLICATE).astype(bool)
    return np.ones(gray.shape, dtype=bool)


def _lumen_level(
    picture: Float32Array, field: BoolArray, um_per_px: float, polarity: Polarity
) -> tuple[Float32Array, Literal["bright", "dark"]]:
    """Return a map that is positive in the lumen, and which part of the picture that is.

    Raises:
        ConfigError: If the picture is uniform.
    """
    sigma_px = _SMOOTH_UM / um_per_px
    planes = [cv2.GaussianBlur(plane, (0, 0), max(sigma_px, 0.3)) for plane in cv2.split(picture)]
    flat = [plane - _local_mean(plane, field, um_per_px) for plane in planes]
    spread = [float(plane[field].std()) for plane in flat]
    if max(spread) < 0.004:
        raise ConfigError("photograph: no lumen found, the picture is uniform; use one with more contrast")
    best = flat[
        int(np.argmax([_separability(plane[field]) * s for plane, s in zip(flat, spread, strict=True)]))
    ]
    bright = best > _otsu(best[field])
    if polarity == "auto":
        edge = field & ~cv2.erode(
            field.astype(np.uint8), _disc(2.0), borderType=cv2.BORDER_CONSTANT, borderValue=0
        ).astype(bool)
        polarity = "bright" if bright[edge].mean() < 0.5 else "dark"
    contrast = best if polarity == "bright" else -best
    lumen = field & (bright if polarity == "bright" else ~bright)
    level = contrast
    for _ in range(3):
        inside = _local_level(contrast, lumen, field, um_per_px)
        outside = _local_level(contrast, field & ~lumen, field, um_per_px)
        level = contrast - (inside + outside) / 2
        lumen = field & (level > 0)
    level[~field] = -np.abs(level).max()
    return level, polarity


def _local_mean(values: Float32Array, weight: BoolArray, um_per_px: float) -> Float32Array:
    """Return the Gaussian mean of the weighted pixels around each pixel."""
    return _blurred(values * weight, um_per_px) / np.maximum(_blurred(weight, um_per_px), 1e-6)


def _local_level(values: Float32Array, part: BoolArray, field: BoolArray, um_per_px: float) -> Float32Array:
    """Return a part's brightness around each pixel, drawn to its mean where little of the part is near."""
    mean = float(values[part].mean()) if part.any() else 0.0
    trust = 0.1 * _blurred(field, um_per_px)
    return (_blurred(values * part, um_per_px) + mean * trust) / (_blurred(part, um_per_px) + trust + 1e-6)


def _blurred(values: Float32Array | BoolArray, um_per_px: float) -> Float32Array:
    """Blur over the scale on which light varies; outside the picture counts as zero."""
    height, width = values.shape
    factor = min(1.0, um_per_px / 80.0)
    small = cv2.resize(
        values.astype(np.float32),
        (max(round(width * factor), 1), max(round(height * factor), 1)),
        interpolation=cv2.INTER_AREA,
    )
    sigma_px = _LIGHT_UM / um_per_px * factor
    blurred = cv2.GaussianBlur(small, (0, 0), sigma_px, borderType=cv2.BORDER_CONSTANT)
    return cv2.resize(blurred, (width, height), interpolation=cv2.INTER_LINEAR).astype(np.float32)


def _histogram(values: Float32Array) -> tuple[Float32Array, Float32Array]:
    counts, edges = np.histogram(values, 512)
    share = counts / counts.sum()
    return share, (edges[:-1] + edges[1:]) / 2


def _between_variance(values: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Return Otsu's between-class variance for each threshold, and the thresholds."""
    share, centre = _histogram(values)
    low, moment = np.cumsum(share), np.cumsum(share * centre)
    return (moment[-1] * low - moment) ** 2 / np.maximum(low * (1 - low), 1e-12), centre


def _otsu(values: Float32Array) -> float:
    variance, threshold = _between_variance(values)
    return float(threshold[int(np.argmax(variance))])


def _separability(values: Float32Array) -> float:
    variance, _ = _between_variance(values)
    return float(variance.max() / max(float(values.var()), 1e-12))


def _cleaned(lumen: BoolArray, um_per_px: float) -> BoolArray:
    """Fill bubbles and reflections, and remove hairs and specks.

    Raises:
        ConfigError: If nothing remains.
    """
    highlight = _disc(_HIGHLIGHT_UM / 2 / um_per_px)
    speck = _disc(_SPECK_UM / 2 / um_per_px)
    gaps = (~lumen).astype(np.uint8)
    padded = cv2.copyMakeBorder(gaps, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=1)
    count, labels = cv2.connectedComponents(padded, connectivity=4)
    wide = cv2.erode(padded, highlight, borderType=cv2.BORDER_CONSTANT, borderValue=1)
    keep = np.zeros(count, dtype=bool)
    keep[np.unique(labels[wide > 0])] = True
    keep[0] = False
    keep[labels[0, 0]] = True
    filled = (~keep[labels])[1:-1, 1:-1].astype(np.uint8)
    opened = cv2.morphologyEx(filled, cv2.MORPH_OPEN, speck)
    if not opened.any():
        raise ConfigError(
            f"photograph: no lumen found: nothing in it is wider than {_SPECK_UM:.0f} µm;"
            " check the scale, or use a picture with more contrast"
        )
    return opened.astype(bool)


def _distance_px(lumen: BoolArray) -> Float32Array:
    padded = cv2.copyMakeBorder(lumen.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    return cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1].astype(np.float32)


def _room(lumen: BoolArray, radius_px: float) -> BoolArray:
    """Return the largest connected part where the robot's centre fits.

    Raises:
        ConfigError: If there is none.
    """
    distance_px = _distance_px(lumen)
    fits = (distance_px > radius_px).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(fits, connectivity=8)
    if count < 2:
        share = float(distance_px.max()) / radius_px
        raise ConfigError(
            "photograph: the robot is wider than every vessel, the widest is"
            f" {share:.0%} of the robot's width: check the scale"
        )
    return np.asarray(labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))


def _with_most_room(lumen: BoolArray, radius_px: float) -> BoolArray:
    """Return the connected lumen that holds the largest part where the robot's centre fits."""
    _, labels = cv2.connectedComponents(lumen.astype(np.uint8), connectivity=8)
    room = _room(lumen, radius_px)
    return np.asarray(labels == labels[room][0])


def _window(room: BoolArray, um_per_px: float, robot_radius_um: float) -> tuple[IntArray, float]:
    """Return the corner (x, y) and side of the square that becomes the grid, in pixels.

    Raises:
        ConfigError: If the room is too large for the grid, or too small to go anywhere.
    """
    limit_px = MAX_SIZE_PX * GRID_UM_PER_PX / um_per_px
    rows, columns = np.nonzero(room)
    low = np.array([columns.min(), rows.min()])
    high = np.array([columns.max(), rows.max()]) + 1
    if (high - low).max() * um_per_px < 2 * robot_radius_um:
        raise ConfigError(
            f"photograph: the robot has only {(high - low).max() * um_per_px:.0f} µm to move in:"
            " check the scale, or use a wider vessel"
        )
    if max(room.shape) <= limit_px:
        return np.zeros(2, dtype=np.int64), float(max(room.shape))
    rim_px = ceil(2 * robot_radius_um / um_per_px)
    corner = np.maximum(low - rim_px, 0)
    side = int((high + rim_px - corner).max())
    if side > limit_px:
        raise ConfigError(
            f"photograph: the vessel spans {side * um_per_px / 1000:.0f} mm, a model at most"
            f" {MAX_SIZE_PX * GRID_UM_PER_PX / 1000:.0f} mm: check the scale, or cut a part out with --crop"
        )
    return corner.astype(np.int64), float(side)


def _on_grid(
    values: Float32Array, origin_px: IntArray, side_px: float, um_per_px: float, outside: float
) -> Float32Array:
    """Resample a square of a picture to 10 µm/px; what lies beyond the picture is ``outside``."""
    step = GRID_UM_PER_PX / um_per_px
    size = ceil(side_px / step - 1e-6)
    shift = 0.5 * step - 0.5
    matrix = np.array([[step, 0, origin_px[0] + shift], [0, step, origin_px[1] + shift]])
    return cv2.warpAffine(
        values,
        matrix,
        (size, size),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(outside, outside, outside),
    ).astype(np.float32)


def _disc(radius_px: float) -> ByteArray:
    side = 2 * max(round(radius_px), 1) + 1
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)).astype(np.uint8)
