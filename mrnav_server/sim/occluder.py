"""What hides the robot in the simulated picture: the magnet on its tilted needle, high over the floor."""

from dataclasses import dataclass

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray, Float32Array, FloatArray
from mrnav_server.core.frames import Calibration, ImagePoint, StagePoint
from mrnav_server.sim.optics import View
from mrnav_server.sim.sprites import Region, blend

_CELL_PX = 8
"""The occluder is out of focus over tens of pixels, so its opacity is computed on cells of this side."""
_NICKEL = (44.0, 88.0)
"""Gray of the magnet, and how much its sheen adds."""
_STEEL = (78.0, 150.0)
_PROBE_UM = 50.0
"""Length of axis from which its direction in the image is taken."""
_CLEAR = 254.5
"""Cells that let this much through of 255 hide nothing."""
_STRIP_CELLS = 20
"""Column strips hug an oblique needle: far fewer pixels than its bounding box."""


@dataclass(frozen=True)
class NeedleShape:
    """The end-effector's size and pose.

    Attributes:
        magnet_diameter_um, magnet_length_um: The cylinder, coaxial with the needle.
        needle_diameter_um: The needle behind it.
        tilt_deg: From the vertical.
        azimuth_deg: Direction in the image in which the needle rises, clockwise from the right.
        pupil_um: Diameter of the camera's entrance pupil, which sets the blur.
    """

    magnet_diameter_um: float
    magnet_length_um: float
    needle_diameter_um: float
    tilt_deg: float
    azimuth_deg: float
    pupil_um: float


class Occluder:
    """The magnet and its needle, in exact perspective and defocused by their height.

    A point at height z over the floor appears magnified by k = WD / (WD - z) about the optical axis and
    blurred by the pupil's disc of radius (k - 1)·pupil/2. The needle's axis is a straight line in the
    image, along which both grow; a strip seen through the disc has a closed-form opacity. The tip and the
    axis' direction follow the view; tilt and distortion bend the rest of the needle by less than is drawn.

    Args:
        shape: The end-effector.
        calibration: Heights, and how the stage lies in the vessel's plane.
        view: Where the magnet appears.
        width_px: Image width.
        height_px: Image height.
        offset: Gray levels that the noise adds later.
    """

    def __init__(
        self,
        shape: NeedleShape,
        calibration: Calibration,
        view: View,
        width_px: int,
        height_px: int,
        offset: float,
    ) -> None:
        self._shape = shape
        self._calibration = calibration
        self._view = view
        self._offset = offset
        tilt, azimuth = np.deg2rad(shape.tilt_deg), np.deg2rad(shape.azimuth_deg)
        self._rise = float(np.cos(tilt))
        self._run = np.array([np.cos(azimuth), np.sin(azimuth)]) * np.sin(tilt)
        self._size = (height_px, width_px)
        # One cell of margin on each side, so that strips can be enlarged without a seam.
        self._x = self._cell_centers(width_px)
        self._y = self._cell_centers(height_px)

    def paint(self, scene: ByteArray, tip: StagePoint) -> list[Region]:
        """Paint the occluder over the scene; return what it touched."""
        seen = self._opacity(tip)
        if seen is None:
            return []
        (row0, column0), cells = seen
        _, height, width = cells.shape
        hides = cells[0] < _CLEAR
        # A cell reaches half a cell into its neighbours, also those of the next strip.
        hides = hides[:, :-2] | hides[:, 1:-1] | hides[:, 2:]
        starts = range(0, width - 2, _STRIP_CELLS)
        rows = np.logical_or.reduceat(hides, starts, axis=1)
        firsts, lasts = rows.argmax(axis=0).tolist(), rows[::-1].argmax(axis=0).tolist()
        touched: list[Region] = []
        for index, start in enumerate(starts):
            first, last = max(firsts[index] - 1, 0), min(height - lasts[index] + 1, height)
            if not rows[firsts[index], index]:
                continue
            strip = slice(start, min(start + _STRIP_CELLS + 2, width))
            region = self._region(row0 + first, row0 + last, column0 + start, column0 + strip.stop)
            pixels = scene[region]
            if pixels.size:
                blend(pixels, _enlarge(cells[:, first:last, strip], pixels))
                touched.append(region)
        return touched

    def _heading(self, tip: StagePoint) -> FloatArray:
        """Return how fast a point on the needle's axis moves in the image at the tip, in px per µm."""
        dx, dy, dz = (_PROBE_UM * part for part in (self._run[0], self._run[1], self._rise))
        ends = (
            self._view.tip_in_image(StagePoint(tip.x_um + s * dx, tip.y_um + s * dy, tip.z_um + s * dz))
            for s in (1.0, -1.0)
        )
        (ahead, behind) = ends
        step = np.array([ahead.x_px - behind.x_px, ahead.y_px - behind.y_px])
        return np.asarray(step / (2.0 * _PROBE_UM))

    def _region(self, row0: int, row1: int, column0: int, column1: int) -> Region:
        """Return the pixels that cells show, without their margin; cell 1 is the picture's first."""
        height, width = self._size
        return (
            slice(row0 * _CELL_PX, min((row1 - 2) * _CELL_PX, height)),
            slice(column0 * _CELL_PX, min((column1 - 2) * _CELL_PX, width)),
        )

    def _opacity(self, tip: StagePoint) -> tuple[tuple[int, int], Float32Array] | None:
        """Return the first cell, and the share of light let through and the own gray on cells, 0..255."""
        distance_um = self._calibration.working_distance_um
        height_um = self._calibration.height_um(tip)
        depth_um = distance_um - height_um
        if depth_um < 0.2 * distance_um:
            return None
        origin = self._view.tip_in_image(tip)
        px_per_um = self._view.image_scale(self._calibration.vessel_below(tip)) / self._calibration.um_per_px
        heading = self._heading(tip)
        pace = max(float(np.hypot(*heading)), 1e-9)
        axis = _Axis(
            direction=heading / pace,
            gain_px=pace * depth_um,
            depth_um=depth_um,
            distance_um=distance_um,
            rise=self._rise,
            px_per_um=px_per_um,
            pupil_um=self._shape.pupil_um,
        )
        half_um = self._shape.magnet_length_um / 2.0
        # The needle is followed up to where it is wide, faint and outside the picture.
        top_um = max((0.75 * distance_um - height_um) / max(self._rise, 0.05), 2.0 * half_um)
        columns, rows, reach_px = self._cells_near(origin, axis, -2.0 * half_um, top_um)
        if columns.stop - columns.start < 3 or rows.stop - rows.start < 3:
            return None
        x, y = self._x[None, columns] - np.float32(origin.x_px), self._y[rows, None] - np.float32(origin.y_px)
        cos, sin = np.float32(axis.direction[0]), np.float32(axis.direction[1])
        across = cos * y - sin * x
        cells = np.zeros((2, *across.shape), np.float32)
        cells[0] = 255.0
        along = cos * x + sin * y
        # An oblique needle touches few of the cells around it; the rods cost far more than finding them.
        reach = axis.width_px(along, self._shape.needle_diameter_um)
        foot_px = np.float32(axis.along_px(half_um) + reach_px)
        reach[along < foot_px] = axis.reach_px(half_um, self._shape.magnet_diameter_um)
        near = np.flatnonzero(np.abs(across) < reach)
        across, along = across.ravel()[near], along.ravel()[near]
        magnet, magnet_gray = np.zeros_like(along), np.zeros_like(along)
        end = np.flatnonzero(along < foot_px)
        magnet[end], magnet_gray[end] = axis.rod(
            along[end], across[end], (-half_um, half_um), self._shape.magnet_diameter_um, _NICKEL
        )
        needle, needle_gray = axis.rod(
            along, across, (half_um, top_um), self._shape.needle_diameter_um, _STEEL
        )
        through = (1.0 - magnet) * (1.0 - needle)
        gray: Float32Array = magnet_gray * magnet * (1.0 - needle) + needle_gray * needle
        gray -= np.float32(self._offset) * (1.0 - through)
        cells[0].ravel()[near] = 255.0 * through
        cells[1].ravel()[near] = np.maximum(gray, np.float32(0.0))
        return (rows.start, columns.start), cells

    def _cells_near(
        self, origin: ImagePoint, axis: "_Axis", low_um: float, high_um: float
    ) -> tuple[slice, slice, float]:
        """Return the columns and rows of cells that can be touched at all, and how far from the axis."""
        ends = [axis.along_px(low_um), min(axis.along_px(high_um), 4.0 * max(self._size))]
        xs = [origin.x_px + end * axis.direction[0] for end in ends]
        ys = [origin.y_px + end * axis.direction[1] for end in ends]
        # The widest: the magnet at its own height, or the needle where it leaves the picture.
        reach = max(
            axis.reach_px(0.0, self._shape.magnet_diameter_um),
            axis.reach_px(axis.length_um(float(np.hypot(*self._size))), self._shape.needle_diameter_um),
        )
        return (
            slice(*np.searchsorted(self._x, [min(xs) - reach, max(xs) + reach]).tolist()),
            slice(*np.searchsorted(self._y, [min(ys) - reach, max(ys) + reach]).tolist()),
            reach,
        )

    @staticmethod
    def _cell_centers(extent_px: int) -> Float32Array:
        cells = np.arange(-1, -(-extent_px // _CELL_PX) + 1, dtype=np.float32)
        return (cells + np.float32(0.5)) * np.float32(_CELL_PX) - np.float32(0.5)


@dataclass(frozen=True)
class _Axis:
    """The needle's axis in the image: a length l on it (µm) appears at G·l / (depth - l·rise) pixels."""

    direction: FloatArray
    gain_px: float
    depth_um: float
    distance_um: float
    rise: float
    px_per_um: float
    pupil_um: float

    def along_px(self, length_um: float) -> float:
        return self.gain_px * length_um / max(self.depth_um - length_um * self.rise, 1.0)

    def length_um(self, along_px: float) -> float:
        return along_px * self.depth_um / (self.gain_px + along_px * self.rise)

    def reach_px(self, length_um: float, diameter_um: float) -> float:
        zoom = self.distance_um / max(self.depth_um - length_um * self.rise, 0.2 * self.distance_um)
        return self.px_per_um * (zoom * diameter_um / 2.0 + (zoom - 1.0) * self.pupil_um / 2.0) + 3 * _CELL_PX

    def width_px(self, along: Float32Array, diameter_um: float) -> Float32Array:
        """Return how far a rod reaches to either side, with a cell to spare: its zoom grows evenly."""
        zoom = np.float32(self.distance_um / self.depth_um) * (
            1.0 + along * np.float32(self.rise / self.gain_px)
        )
        spread = np.maximum((zoom - 1.0) * np.float32(0.5 * self.pupil_um * self.px_per_um), 1.5 * _CELL_PX)
        width: Float32Array = spread + zoom * np.float32(0.5 * diameter_um * self.px_per_um) + _CELL_PX
        return width

    def rod(
        self,
        along: Float32Array,
        across: Float32Array,
        ends_um: tuple[float, float],
        diameter_um: float,
        metal: tuple[float, float],
    ) -> tuple[Float32Array, Float32Array]:
        """Return the opacity of a round metal rod between two lengths on the axis, and its gray."""
        low_um, high_um = ends_um
        slope = np.maximum(np.float32(self.gain_px) + along * np.float32(self.rise), np.float32(1e-3))
        length_um = np.clip(
            along * np.float32(self.depth_um) / slope, np.float32(low_um), np.float32(high_um)
        )
        zoom = np.float32(self.distance_um) / (np.float32(self.depth_um) - length_um * np.float32(self.rise))
        half = zoom * np.float32(0.5 * diameter_um * self.px_per_um)
        radius = np.maximum(
            (zoom - 1.0) * np.float32(0.5 * self.pupil_um * self.px_per_um), np.float32(1.5 * _CELL_PX)
        )
        blur = 1.0 / radius
        side = across / half
        cap = half * np.float32(self.rise) * np.sqrt(np.maximum(np.float32(0.0), 1.0 - side * side))
        low, high = np.float32(self.along_px(low_um)), np.float32(self.along_px(high_um))
        # All four edges in one array: so few cells cost less than the calls.
        edges = np.stack([across + half, across - half, along - low + cap, along - high - cap])
        edges *= blur
        left, right, foot, head = _through_pupil(edges)
        opacity = (left - right) * (foot - head)
        # Defocus widens and weakens the sheen as it does the outline.
        spread = np.sqrt(half * half + radius * radius)
        sheen = np.maximum(np.float32(0.0), 1.0 - ((across / spread + 0.25) / np.float32(0.7)) ** 2)
        base, gloss = metal
        gray: Float32Array = np.float32(base) + np.float32(gloss) * sheen * sheen * (half / spread)
        return opacity, gray


def _enlarge(cells: Float32Array, pixels: ByteArray) -> ByteArray:
    """Return cells, shape (2, rows, columns), at the size of the pixels that they show, without margin."""
    # Both pictures at once, one under the other: their margins keep them apart.
    _, rows, columns = cells.shape
    both = cells.reshape(2 * rows, columns)
    large = cv2.resize(both, (columns * _CELL_PX, 2 * rows * _CELL_PX), interpolation=cv2.INTER_LINEAR)
    height, width = pixels.shape[:2]
    sprite = cv2.convertScaleAbs(large).reshape(2, rows * _CELL_PX, columns * _CELL_PX)
    return sprite[:, _CELL_PX : _CELL_PX + height, _CELL_PX : _CELL_PX + width].astype(np.uint8, copy=False)


def _through_pupil(t: Float32Array) -> Float32Array:
    """Return the share of a disc of radius 1 on one side of a line at distance t (a cubic, within 0.02)."""
    t = np.minimum(np.maximum(t, np.float32(-1.0)), np.float32(1.0))
    share: Float32Array = t * t
    share *= np.float32(-0.25)
    share += np.float32(0.75)
    share *= t
    share += np.float32(0.5)
    return share
