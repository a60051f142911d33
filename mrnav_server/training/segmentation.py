"""From a photograph of a printed vessel, or a mask, to the connected lumen on a grid of 10 µm."""

from dataclasses import dataclass
from math import ceil, isfinite

import cv2
import numpy as np

from mrnav_server.core.arrays import BoolArray, ByteArray, Float32Array, FloatArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.training.lumen_level import Polarity, Side, is_mask, mask_level, photograph_level
from mrnav_server.training.photograph import field_of_view, on_grid, shrink
from mrnav_server.vision.vessel_model import PLAY_UM, ROBOT_RADIUS_UM, largest_part

GRID_UM_PER_PX = 10.0
MIN_SIZE_PX = 200
MAX_SIZE_PX = 4000
"""Sides of the grid: 2 to 40 mm; a policy's grid has 4000 pixels at most."""
SCALE_UM_PER_PX = (0.1, 500.0)
ROBOT_RADIUS_RANGE_UM = (50.0, 5000.0)

_RIM_UM = 240.0
"""A photograph's edge towards an eyepiece's surround is blurred over less than this."""
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
        side: Whether the lumen is the bright or the dark part of the photograph.
        drawn: Whether the photograph was a mask, and was taken as it is.
        shown_mm: Width and height of what the photograph shows.
        origin_um: Where the grid's upper left corner lies in the photograph (x, y).
    """

    mask: ByteArray
    photograph: ByteArray
    side: Side
    drawn: bool
    shown_mm: tuple[float, float]
    origin_um: tuple[float, float]


def segment(
    photograph: Float32Array,
    um_per_px: float,
    robot_radius_um: float = ROBOT_RADIUS_UM,
    polarity: Polarity = "auto",
) -> Segmentation:
    """Find the connected lumen in which the robot has most room.

    The grid holds the whole photograph, or, if that is too large for a grid, the part in which the robot has
    most room. A mask is taken as it is; in a photograph, bubbles are filled and hairs are removed.

    Args:
        photograph: Shape (height, width, 3), BGR, 0..1.
        um_per_px: Size of one of its pixels in µm.
        robot_radius_um: Radius of the robot in µm.
        polarity: Whether the lumen is bright or dark; by default it is what takes less of the edge.

    Raises:
        ConfigError: If the size is out of range, there is no lumen, or the robot fits nowhere.
    """
    _check_range("scale", um_per_px, SCALE_UM_PER_PX, "µm/px")
    _check_range("robot radius", robot_radius_um, ROBOT_RADIUS_RANGE_UM, "µm")
    height_um, width_um = (side * um_per_px for side in photograph.shape[:2])
    if min(height_um, width_um) < MIN_SIZE_PX * GRID_UM_PER_PX:
        raise ConfigError(
            f"photograph: it shows {width_um / 1000:.2g} x {height_um / 1000:.2g} mm at {um_per_px:g} µm/px;"
            f" at least {MIN_SIZE_PX * GRID_UM_PER_PX / 1000:g} mm a side are needed: check the scale"
        )
    work_um = max(um_per_px, GRID_UM_PER_PX)
    picture = shrink(photograph, um_per_px / work_um)
    gray: Float32Array = picture.mean(axis=2, dtype=np.float32)
    drawn = is_mask(gray)
    if drawn:
        level, side = mask_level(gray, polarity)
    else:
        field = field_of_view(gray, _RIM_UM / work_um)
        level, side = photograph_level(picture, field, work_um, polarity)
    lumen = level > 0 if drawn else _cleaned(level > 0, work_um)
    room = _room(lumen, work_um, robot_radius_um)
    origin_px, side_px = _window(room, work_um, robot_radius_um)
    step = GRID_UM_PER_PX / work_um
    size = ceil(side_px / step - 1e-6)
    lumen = on_grid(level, origin_px, size, step, fill=-1.0) > 0
    lumen = lumen if drawn else _cleaned(lumen, GRID_UM_PER_PX)
    kept = _with_most_room(lumen, robot_radius_um)
    shown = on_grid(picture, origin_px, size, step, fill=0.0)
    return Segmentation(
        mask=kept.astype(np.uint8) * 255,
        photograph=(shown * 255).clip(0, 255).astype(np.uint8),
        side=side,
        drawn=drawn,
        shown_mm=(width_um / 1000, height_um / 1000),
        origin_um=(float(origin_px[0]) * work_um, float(origin_px[1]) * work_um),
    )


def _check_range(name: str, value: float, allowed: tuple[float, float], unit: str) -> None:
    if not (isfinite(value) and allowed[0] <= value <= allowed[1]):
        raise ConfigError(f"{name}: {value:g} {unit} is not within {allowed[0]:g} to {allowed[1]:g} {unit}")


def _cleaned(lumen: BoolArray, um_per_px: float) -> BoolArray:
    """Fill bubbles and reflections, and remove hairs and specks.

    Raises:
        ConfigError: If nothing remains.
    """
    # Beyond the picture there is tissue, so that no gap at its edge is taken for a bubble.
    gaps = cv2.copyMakeBorder((~lumen).astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=1)
    count, labels = cv2.connectedComponents(gaps, connectivity=4)
    wide = cv2.distanceTransform(gaps, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) > _HIGHLIGHT_UM / 2 / um_per_px
    kept = np.zeros(count, dtype=bool)
    kept[np.unique(labels[wide])] = True
    kept[labels[0, 0]] = True
    kept[0] = False
    opened = _opened(~kept[labels][1:-1, 1:-1], _SPECK_UM / 2 / um_per_px)
    if not opened.any():
        raise ConfigError(
            f"photograph: no lumen found: nothing in it is wider than {_SPECK_UM:.0f} µm;"
            " check the scale, or use a picture with more contrast"
        )
    return opened


def _opened(lumen: BoolArray, radius_px: float) -> BoolArray:
    """Return the union of all discs of a radius that fit."""
    apart = (_distance_px(lumen) <= radius_px).astype(np.uint8)
    if apart.all():
        return np.zeros_like(lumen)
    return np.asarray(cv2.distanceTransform(apart, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) <= radius_px)


def _distance_px(lumen: BoolArray) -> Float32Array:
    """Return the distance to the wall; the picture's edge is a wall."""
    padded = cv2.copyMakeBorder(lumen.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    return cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1].astype(np.float32)


def _room(lumen: BoolArray, um_per_px: float, robot_radius_um: float) -> BoolArray:
    """Return the largest connected part where the robot's centre fits with some play.

    Raises:
        ConfigError: If there is none.
    """
    distance_px = _distance_px(lumen)
    needed_um = robot_radius_um + PLAY_UM
    room = largest_part(distance_px > needed_um / um_per_px)
    if not room.any():
        raise ConfigError(
            "photograph: the robot is wider than every vessel: the widest is"
            f" {2 * float(distance_px.max()) * um_per_px:.0f} µm, the robot needs {2 * needed_um:.0f} µm"
            f" ({PLAY_UM:.0f} µm to either side); check the scale and the robot's radius"
        )
    return room


def _with_most_room(lumen: BoolArray, robot_radius_um: float) -> BoolArray:
    """Return the connected lumen that holds the largest part where the robot's centre fits."""
    _, labels = cv2.connectedComponents(lumen.astype(np.uint8), connectivity=8)
    return np.asarray(labels == labels[_room(lumen, GRID_UM_PER_PX, robot_radius_um)][0])


def _window(room: BoolArray, um_per_px: float, robot_radius_um: float) -> tuple[FloatArray, float]:
    """Return the corner (x, y) and side of the square that becomes the grid, in pixels.

    Raises:
        ConfigError: If the room is too small to go anywhere.
    """
    limit_px = MAX_SIZE_PX * GRID_UM_PER_PX / um_per_px
    rows, columns = np.nonzero(room)
    low = np.array([columns.min(), rows.min()])
    high = np.array([columns.max(), rows.max()]) + 1
    span_um = float((high - low).max()) * um_per_px
    if span_um < 2 * robot_radius_um:
        raise ConfigError(
            f"photograph: the robot has only {span_um:.0f} µm to move in:"
            " check the scale, or use a wider vessel"
        )
    if max(room.shape) <= limit_px:
        return np.zeros(2), float(max(room.shape))
    rim_px = 2 * robot_radius_um / um_per_px
    corner = np.maximum(low - rim_px, 0.0).round()
    side_px = float((high + rim_px - corner).max())
    if side_px <= limit_px:
        return corner, side_px
    return _fullest_square(room, int(limit_px)), float(int(limit_px))


def _fullest_square(room: BoolArray, side_px: int) -> FloatArray:
    """Return the upper left corner (x, y) of the square of a side that holds most room."""
    sums = np.pad(room.astype(np.int64).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    height, width = (min(side_px, side) for side in room.shape)
    inside = sums[height:, width:] - sums[:-height, width:] - sums[height:, :-width] + sums[:-height, :-width]
    top, left = np.unravel_index(int(inside.argmax()), inside.shape)
    return np.array([float(left), float(top)])
