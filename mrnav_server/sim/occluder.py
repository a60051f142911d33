"""What hides the robot in the simulated picture: the magnet on its tilted needle, high over the floor."""

import math
from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray, Float32Array, FloatArray
from mrnav_server.core.frames import Calibration, ImagePoint, StagePoint
from mrnav_server.sim.optics import View
from mrnav_server.sim.sprites import Region, blend

_Cell = TypeVar("_Cell", float, FloatArray)
_CELL_PX = 8
"""The occluder is out of focus over tens of pixels, so its opacity is computed on cells of this side."""
_HalfPlane = tuple[float, float, float]
"""(p, q, r): where ``p·y < q + r·x``, in pixels from the magnet."""
_NICKEL = (44.0, 88.0)
"""Gray of the magnet, and how much its sheen adds."""
_STEEL = (78.0, 150.0)
_PROBE_UM = 50.0
"""Length of axis from which its direction in the image is taken."""
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
        tilt, azimuth = math.radians(shape.tilt_deg), math.radians(shape.azimuth_deg)
        self._rise = math.cos(tilt)
        self._run = (math.cos(azimuth) * math.sin(tilt), math.sin(azimuth) * math.sin(tilt))
        self._size = (height_px, width_px)

    def paint(self, scene: ByteArray, tip: StagePoint) -> list[Region]:
        """Paint the occluder over the scene; return what it touched."""
        axis = self._axis(tip)
        strips = [] if axis is None else self._strips(axis)
        if axis is None or not strips:
            return []
        cells = self._cells(axis, strips)
        touched: list[Region] = []
        above = 0
        for column, first, last in strips:
            region = (
                slice(first * _CELL_PX, min(last * _CELL_PX, self._size[0])),
                slice(column * _CELL_PX, min((column + _STRIP_CELLS) * _CELL_PX, self._size[1])),
            )
            pixels = scene[region]
            below = above + last - first + 2
            blend(pixels, _enlarge(cells[:, above:below], pixels))
            touched.append(region)
            above = below
        return touched

    def _axis(self, tip: StagePoint) -> "_Axis | None":
        """Return how the needle appears; None when it is so near to the camera that nothing is seen."""
        distance_um = self._calibration.working_distance_um
        height_um = self._calibration.height_um(tip)
        depth_um = distance_um - height_um
        if depth_um < 0.2 * distance_um:
            return None
        x_px_per_um, y_px_per_um = self._heading(tip)
        pace = max(math.hypot(x_px_per_um, y_px_per_um), 1e-9)
        um_per_px = self._calibration.um_per_px
        half_um = self._shape.magnet_length_um / 2.0
        return _Axis(
            origin=self._view.tip_in_image(tip),
            direction=(x_px_per_um / pace, y_px_per_um / pace),
            gain_px=pace * depth_um,
            depth_um=depth_um,
            distance_um=distance_um,
            rise=self._rise,
            px_per_um=self._view.image_scale(self._calibration.vessel_below(tip)) / um_per_px,
            pupil_um=self._shape.pupil_um,
            magnet=(-half_um, half_um, self._shape.magnet_diameter_um),
            # The needle is followed up to where it is wide, faint and outside the picture.
            needle=(
                half_um,
                max((0.75 * distance_um - height_um) / max(self._rise, 0.05), 2.0 * half_um),
                self._shape.needle_diameter_um,
            ),
        )

    def _heading(self, tip: StagePoint) -> tuple[float, float]:
        """Return how fast a point on the needle's axis moves in the image at the tip, in px per µm."""
        dx, dy, dz = (_PROBE_UM * part for part in (*self._run, self._rise))
        ahead, behind = (
            self._view.tip_in_image(StagePoint(tip.x_um + s * dx, tip.y_um + s * dy, tip.z_um + s * dz))
            for s in (1.0, -1.0)
        )
        return (ahead.x_px - behind.x_px) / (2.0 * _PROBE_UM), (ahead.y_px - behind.y_px) / (2.0 * _PROBE_UM)

    def _strips(self, axis: "_Axis") -> list[tuple[int, int, int]]:
        """Return the strips that are touched: their first column, first row and last row, of cells."""
        height, width = self._size
        rows = -(-height // _CELL_PX)
        columns: FloatArray = np.arange(0.0, -(-width // _CELL_PX), _STRIP_CELLS)
        left_px = _center_px(columns - 1.0) - axis.origin.x_px
        right_px = left_px + (_STRIP_CELLS + 1) * _CELL_PX
        outlines = np.array([axis.outline(axis.magnet), axis.outline(axis.needle)])
        p, q, r = np.moveaxis(outlines, -1, 0)[..., None]
        # The largest y of a half plane lies on one side of the strip; upside down, the smallest.
        bound_px = (q + np.maximum(r * left_px, r * right_px)) / np.where(np.abs(p) < 1e-6, 1e-6, p)
        high_px = np.where(p > 0.0, bound_px, np.inf).min(axis=1)
        low_px = np.where(p > 0.0, -np.inf, bound_px).max(axis=1)
        nothing = low_px >= high_px
        high_px[nothing], low_px[nothing] = -np.inf, np.inf
        # A cell reaches half a cell into its neighbours.
        edges_px = np.stack([low_px.min(axis=0), high_px.max(axis=0)]) + axis.origin.y_px - _center_px(0.0)
        cells = np.clip(np.floor(edges_px / _CELL_PX) + np.array([[0.0], [2.0]]), 0, rows).astype(int)
        starts = columns.astype(int).tolist()
        return [strip for strip in zip(starts, *cells.tolist(), strict=True) if strip[1] < strip[2]]

    def _cells(self, axis: "_Axis", strips: list[tuple[int, int, int]]) -> Float32Array:
        """Return the share of light let through and the own gray, 0..255, of all strips one under the other.

        Every strip has a margin of one cell on each side. Shape (2, rows, columns).
        """
        cos, sin = axis.direction
        rows = np.concatenate([np.arange(first - 1, last + 1) for _, first, last in strips])
        starts = np.repeat(
            [column - 1.0 for column, _, _ in strips], [last - first + 2 for _, first, last in strips]
        )
        x, y = _center_px(starts) - axis.origin.x_px, _center_px(rows) - axis.origin.y_px
        step = np.arange(_STRIP_CELLS + 2) * _CELL_PX
        along = np.add.outer((cos * x + sin * y).astype(np.float32), (cos * step).astype(np.float32))
        across = np.add.outer((cos * y - sin * x).astype(np.float32), (-sin * step).astype(np.float32))
        needle, gray = axis.rod(axis.needle, along, across, _STEEL)
        gray *= needle
        clear = np.subtract(np.float32(1.0), needle, out=needle)
        reach_px, end_px = axis.reach_px(axis.magnet), axis.ends_px(axis.magnet)[1]
        end = np.flatnonzero((np.abs(along) < end_px) & (np.abs(across) < reach_px))
        magnet, magnet_gray = axis.rod(axis.magnet, along.ravel()[end], across.ravel()[end], _NICKEL)
        beside = clear.ravel()[end]
        gray.ravel()[end] += magnet_gray * magnet * beside
        clear.ravel()[end] = beside * (1.0 - magnet)
        cells = np.empty((2, *along.shape), np.float32)
        np.multiply(clear, np.float32(255.0), out=cells[0])
        gray -= np.float32(self._offset) * (1.0 - clear)
        np.maximum(gray, np.float32(0.0), out=cells[1])
        return cells


@dataclass(frozen=True)
class _Axis:
    """The needle's axis in the image: a length l on it (µm) appears at G·l / (depth - l·rise) pixels.

    A rod is two ends on the axis, and a diameter, in µm.
    """

    origin: ImagePoint
    direction: tuple[float, float]
    gain_px: float
    depth_um: float
    distance_um: float
    rise: float
    px_per_um: float
    pupil_um: float
    magnet: tuple[float, float, float]
    needle: tuple[float, float, float]

    @property
    def growth(self) -> float:
        """By how much the magnification grows per pixel along the axis."""
        return self.distance_um / self.depth_um * self.rise / self.gain_px

    def along_px(self, length_um: float) -> float:
        return self.gain_px * length_um / max(self.depth_um - length_um * self.rise, 1.0)

    def zoom(self, length_um: float) -> float:
        return self.distance_um / max(self.depth_um - length_um * self.rise, 1.0)

    def blur_px(self, length_um: float) -> float:
        return max((self.zoom(length_um) - 1.0) * 0.5 * self.pupil_um * self.px_per_um, 1.5 * _CELL_PX)

    def reach_px(self, rod: tuple[float, float, float]) -> float:
        """Return how far a rod and its blur reach to either side: at its upper end, where it is widest."""
        _, high_um, diameter_um = rod
        return self.zoom(high_um) * 0.5 * diameter_um * self.px_per_um + self.blur_px(high_um)

    def ends_px(self, rod: tuple[float, float, float]) -> tuple[float, float]:
        """Return where a rod and its blur begin and end along the axis."""
        low_um, high_um, diameter_um = rod
        cap_px = 0.5 * diameter_um * self.px_per_um * self.rise
        return (
            self.along_px(low_um) - self.zoom(low_um) * cap_px - self.blur_px(low_um),
            self.along_px(high_um) + self.zoom(high_um) * cap_px + self.blur_px(high_um),
        )

    def outline(self, rod: tuple[float, float, float]) -> tuple[_HalfPlane, ...]:
        """Return half planes whose common part holds a rod and its blur."""
        cos, sin = self.direction
        low_um, _, diameter_um = rod
        foot_px, head_px = self.ends_px(rod)
        # Half its width grows evenly along the axis, from its lower end on.
        slope = self.growth * 0.5 * (diameter_um + self.pupil_um) * self.px_per_um
        least_px = self.zoom(low_um) * 0.5 * diameter_um * self.px_per_um + self.blur_px(low_um)
        least_px -= slope * foot_px
        widest_px = self.reach_px(rod)
        return (
            (cos - slope * sin, least_px, sin + slope * cos),
            (-cos - slope * sin, least_px, -sin + slope * cos),
            (cos, widest_px, sin),
            (-cos, widest_px, -sin),
            (-sin, -foot_px, cos),
            (sin, head_px, -cos),
        )

    def rod(
        self,
        rod: tuple[float, float, float],
        along: Float32Array,
        across: Float32Array,
        metal: tuple[float, float],
    ) -> tuple[Float32Array, Float32Array]:
        """Return a rod's opacity, and its gray."""
        low_um, high_um, diameter_um = rod
        zoom = along * np.float32(self.growth)
        zoom += np.float32(self.distance_um / self.depth_um)
        lowest, highest = np.float32(self.zoom(low_um)), np.float32(self.zoom(high_um))
        np.minimum(np.maximum(zoom, lowest, out=zoom), highest, out=zoom)
        half = zoom * np.float32(0.5 * diameter_um * self.px_per_um)
        radius = zoom * np.float32(0.5 * self.pupil_um * self.px_per_um)
        radius -= np.float32(0.5 * self.pupil_um * self.px_per_um)
        np.maximum(radius, np.float32(1.5 * _CELL_PX), out=radius)
        square = across / half
        square *= square
        cap = np.sqrt(np.maximum(np.float32(0.0), 1.0 - square))
        cap *= half
        cap *= np.float32(self.rise)
        # All four edges in one array: so few cells cost less than the calls.
        edges = np.empty((4, *along.shape), np.float32)
        np.add(across, half, out=edges[0])
        np.subtract(across, half, out=edges[1])
        np.subtract(along, np.float32(self.along_px(low_um)), out=edges[2])
        edges[2] += cap
        np.subtract(along, np.float32(self.along_px(high_um)), out=edges[3])
        edges[3] -= cap
        edges /= radius
        left, right, foot, head = _through_pupil(edges)
        left -= right
        foot -= head
        left *= foot
        # Defocus widens and weakens the sheen as it does the outline.
        spread = np.sqrt(half * half + radius * radius)
        sheen = across / spread
        sheen += np.float32(0.25)
        sheen *= sheen
        sheen *= np.float32(-(0.7**-2))
        sheen += np.float32(1.0)
        np.maximum(sheen, np.float32(0.0), out=sheen)
        sheen *= sheen
        sheen *= half
        sheen /= spread
        base, gloss = metal
        sheen *= np.float32(gloss)
        sheen += np.float32(base)
        return left, sheen


def _center_px(cell: _Cell) -> _Cell:
    """Return where a cell's centre lies in the picture."""
    return cell * _CELL_PX + (0.5 * _CELL_PX - 0.5)


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
    t = np.minimum(np.maximum(t, np.float32(-1.0), out=t), np.float32(1.0), out=t)
    share: Float32Array = t * t
    share *= np.float32(-0.25)
    share += np.float32(0.75)
    share *= t
    share += np.float32(0.5)
    return share
