"""The simulated camera as a lab has it: tilted, with a lens that distorts, over a surface of water.

Rays are traced exactly, so what is drawn with them follows no calibration's model.
"""

import math
from dataclasses import dataclass, fields
from typing import Protocol, TypeVar

import numpy as np

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.camera_map import FloorMap, TipMap
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import Affine2, Calibration, ImagePoint, StagePoint, VesselPoint
from mrnav_server.core.picture import PictureFormat

ALLOWED = {
    "radial": (-0.1, 0.1),
    "tilt_deg": (0.0, 15.0),
    "tilt_azimuth_deg": (-360.0, 360.0),
    "water_depth_um": (0.0, 10_000.0),
    "water_index": (1.0, 1.6),
}
_NEWTON_ROUNDS = 4
"""Steps towards the ray that meets a point under water; each doubles the digits, from two at the start."""
_Number = TypeVar("_Number", float, FloatArray)
"""One point's coordinate, or that of many: a single point is traced without arrays, ten times as fast."""


@dataclass(frozen=True, slots=True)
class OpticsConfig:
    """How the simulated camera departs from one that looks straight down through a perfect lens.

    Attributes:
        radial: Radial distortion at the picture's corners, -0.1..0.1; -0.01 pulls them in by 1 %.
        tilt_deg: Angle between the optical axis and the vertical, 0..15°.
        tilt_azimuth_deg: Direction in the vessel's plane in which the camera stands off, -180..180°.
        water_depth_um: Water over the robot's centre in µm, 0..10000; 0 is a dry dish.
        water_index: Refractive index of the water, 1..1.6.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    radial: float = 0.0
    tilt_deg: float = 0.0
    tilt_azimuth_deg: float = 35.0
    water_depth_um: float = 0.0
    water_index: float = 1.333

    def __post_init__(self) -> None:
        for field in fields(self):
            low, high = ALLOWED[field.name]
            value = getattr(self, field.name)
            if not low <= value <= high:
                raise ConfigError(f"sim.optics.{field.name} is {value:g}; choose it within {low:g}..{high:g}")

    @property
    def is_plain(self) -> bool:
        """Whether the camera looks straight down, through a perfect lens and no water."""
        return self.radial == 0.0 and self.tilt_deg == 0.0 and self.rise_um == 0.0

    @property
    def rise_um(self) -> float:
        """How far the water lifts the floor for an eye above it: ``d·(1 - 1/n)``."""
        return self.water_depth_um * (1.0 - 1.0 / self.water_index)


class View(Protocol):
    """Where things appear; a calibration is one, the simulated optics are another."""

    def image_point(self, point: VesselPoint) -> ImagePoint:
        """Return where a point on the channel's floor appears."""

    def image_scale(self, point: VesselPoint) -> float:
        """Return how many image pixels a grid pixel spans there."""

    def tip_in_image(self, tip: StagePoint) -> ImagePoint:
        """Return where the magnet appears."""


class Optics:
    """The camera over the bench, in floor coordinates: vessel µm, and z in µm above the robot's centre.

    Args:
        config: Tilt, distortion and water.
        plain: The bench under a camera without them; vessel, stage and heights are taken from it.
        picture: Size of the pictures.
        lies: Where the vessel's grid pixels lie in the plain bench's grid; None is where they belong.
    """

    def __init__(
        self,
        config: OpticsConfig,
        plain: Calibration,
        picture: PictureFormat,
        lies: Affine2 | None = None,
    ) -> None:
        self._lies = lies or Affine2.scale(1.0)
        self._config = config
        self._plain = plain
        self._center = picture.center_px
        self._radius_px = math.hypot(picture.width_px, picture.height_px) / 2.0
        tilt, azimuth = math.radians(config.tilt_deg), math.radians(config.tilt_azimuth_deg)
        seen = plain.vessel_point(ImagePoint(*picture.center_px))
        back = np.array(
            [math.sin(tilt) * math.cos(azimuth), math.sin(tilt) * math.sin(azimuth), math.cos(tilt)]
        )
        aim_um = np.array([seen.x_px * plain.um_per_px, seen.y_px * plain.um_per_px, 0.0])
        distance_um = plain.working_distance_um
        self._camera_um = aim_um + distance_um * back
        # Refocused and zoomed so that the vessel fills the picture as it does without water.
        self._focal_px = (
            (distance_um - config.rise_um) * plain.image_from_vessel.linear_scale / plain.um_per_px
        )
        self._axes = _axes(-back)
        self._rows = self._axes.tolist()
        self._eye_um: tuple[float, float, float] = tuple(self._camera_um.tolist())
        # In units of radius_px, before the distortion; beyond it the picture would run back inwards.
        self._fold = math.sqrt(-1.0 / (3.0 * config.radial)) if config.radial < 0.0 else math.inf

    def image(self, points_um: FloatArray) -> FloatArray:
        """Return where points appear.

        Args:
            points_um: Floor x, y and height, in µm, shape (..., 3); under water those below its surface.

        Returns:
            Shape (..., 2), in pixels.
        """
        x_um, y_um, z_um = np.moveaxis(np.asarray(points_um, np.float64), -1, 0)
        return np.stack(self._traced(x_um, y_um, z_um), axis=-1)

    def refuse_fold(self, size_px: float) -> None:
        """Refuse a distortion that draws a part of the vessel over another one.

        Args:
            size_px: Side of the vessel's grid.

        Raises:
            ConfigError: If the vessel reaches to where the distortion turns back.
        """
        if math.isinf(self._fold):
            return
        corners = [self._lies(x, y) for x in (0.0, size_px) for y in (0.0, size_px)]
        um = self._plain.um_per_px
        farthest = max(self._plain_radius(x_px * um, y_px * um) for x_px, y_px in corners)
        if farthest >= self._fold:
            raise ConfigError(
                f"sim.optics.radial is {self._config.radial:g} and folds the picture over"
                f" {self._fold:.2f} half diagonals from its middle, the vessel reaches to {farthest:.2f}:"
                f" choose it above {-1.0 / (3.0 * farthest**2):.3f}, or a larger sim.image_um_per_px"
            )

    def floor_um(self, image_px: FloatArray) -> FloatArray:
        """Return the floor points that pixels show, in µm, shape (..., 2)."""
        lens = FloorMap(
            (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), self._center, self._config.radial, self._radius_px
        )
        offset = (lens.floor(image_px) - self._center) / self._focal_px
        ray = offset @ self._axes[:2] + self._axes[2]
        slope = ray[..., :2] / -ray[..., 2:]
        depth_um = self._config.water_depth_um
        tangent = np.linalg.norm(slope, axis=-1, keepdims=True)
        bent = slope * (_tan_in_water(tangent, self._config.water_index) / np.maximum(tangent, 1e-12))
        return np.asarray(self._camera_um[:2] + (self._camera_um[2] - depth_um) * slope + depth_um * bent)

    def image_point(self, point: VesselPoint) -> ImagePoint:
        """Return where a point on the channel's floor appears."""
        um, (x_px, y_px) = self._plain.um_per_px, self._lies(point.x_px, point.y_px)
        return ImagePoint(*self._traced(x_px * um, y_px * um, 0.0))

    def image_scale(self, point: VesselPoint) -> float:
        """Return how many image pixels a grid pixel spans on the channel's floor."""
        um, (x_px, y_px) = self._plain.um_per_px, self._lies(point.x_px, point.y_px)
        x_um, y_um = x_px * um, y_px * um
        right, left = self._traced(x_um + um, y_um, 0.0), self._traced(x_um - um, y_um, 0.0)
        below, above = self._traced(x_um, y_um + um, 0.0), self._traced(x_um, y_um - um, 0.0)
        area = (right[0] - left[0]) * (below[1] - above[1]) - (right[1] - left[1]) * (below[0] - above[0])
        return 0.5 * math.sqrt(abs(area))

    def grid_seen_px(self, image_px: FloatArray) -> FloatArray:
        """Return the vessel's grid points that pixels show, shape (..., 2)."""
        rows = np.array(self._lies.inverse().rows())
        return np.asarray(self.floor_um(image_px) / self._plain.um_per_px @ rows[:, :2].T + rows[:, 2])

    def tip_in_image(self, tip: StagePoint) -> ImagePoint:
        """Return where the magnet's centre appears."""
        below, um = self._plain.vessel_below(tip), self._plain.um_per_px
        # A tip at the camera's height has no image; it is kept in front of the camera.
        height_um = min(self._plain.height_um(tip), 0.999 * self._eye_um[2])
        return ImagePoint(*self._traced(below.x_px * um, below.y_px * um, height_um))

    def floor_map(self) -> FloorMap:
        """Return the map of the floor, from µm: exact but for the water, which is paraxial in it."""
        rise_um = self._config.rise_um
        plane = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, rise_um]])
        view = self._axes @ (plane - np.outer(self._camera_um, [0.0, 0.0, 1.0]))
        lens = np.array(
            [
                [self._focal_px, 0.0, self._center[0]],
                [0.0, self._focal_px, self._center[1]],
                [0.0, 0.0, 1.0],
            ]
        )
        whole = lens @ view
        whole /= whole[2, 2]
        return FloorMap(tuple(whole.ravel().tolist()), self._center, self._config.radial, self._radius_px)

    def tip_map(self) -> TipMap:
        """Return the map of a tip above the water, from stage µm to floor µm: paraxial in the water."""
        x_um, y_um, z_um = self._camera_um.tolist()
        seen_from_um = z_um - self._config.rise_um
        camera_z_um = self._plain.floor_z_um + z_um
        floor_from_stage = np.array(self._plain.stage_from_vessel.inverse().rows()) * self._plain.um_per_px
        shrink = seen_from_um / camera_z_um
        apparent_z_um = self._plain.floor_z_um + self._config.rise_um
        offset = shrink * floor_from_stage[:, 2] + np.array([x_um, y_um]) * apparent_z_um / camera_z_um
        lift = (offset - np.array([x_um, y_um])) / camera_z_um
        matrix = np.column_stack([shrink * floor_from_stage[:, :2], lift])
        return TipMap(tuple(matrix.ravel().tolist()), (float(offset[0]), float(offset[1])), camera_z_um)

    def _traced(self, x_um: _Number, y_um: _Number, z_um: _Number) -> tuple[_Number, _Number]:
        """Return where points appear; beyond the fold, outside any picture, without further distortion."""
        x_px, y_px = self._undistorted(x_um, y_um, z_um)
        square = (x_px * x_px + y_px * y_px) / self._radius_px**2
        if self._fold < math.inf:
            # The smaller of two, for numbers and arrays alike.
            fold = self._fold**2
            square = 0.5 * (square + fold - abs(square - fold))
        share = 1.0 + self._config.radial * square
        return self._center[0] + share * x_px, self._center[1] + share * y_px

    def _undistorted(self, x_um: _Number, y_um: _Number, z_um: _Number) -> tuple[_Number, _Number]:
        """Return where points would appear from the optical axis, in px, if the lens were perfect."""
        eye_x_um, eye_y_um, eye_z_um = self._eye_um
        depth_um, index = self._config.water_depth_um, self._config.water_index
        across_x_um, across_y_um = x_um - eye_x_um, y_um - eye_y_um
        # Points above the surface are met directly: no water is between.
        under_um = 0.5 * (depth_um - z_um + abs(depth_um - z_um))
        above_um = eye_z_um - z_um - under_um
        if depth_um > 0.0:
            reach_um = (across_x_um * across_x_um + across_y_um * across_y_um + 1e-24) ** 0.5
            tangent = reach_um / (above_um + under_um / index)
            for _ in range(_NEWTON_ROUNDS):
                square = tangent * tangent
                sine = (square / (1.0 + square)) ** 0.5 / index
                cosine = (1.0 - sine * sine) ** 0.5
                excess_um = above_um * tangent + under_um * sine / cosine - reach_um
                slope_um = above_um + under_um / index * ((1.0 + square) ** 0.5 * cosine) ** -3.0
                tangent = tangent - excess_um / slope_um
            share = above_um * tangent / reach_um
            across_x_um, across_y_um = share * across_x_um, share * across_y_um
        right, down, ahead = (
            row[0] * across_x_um + row[1] * across_y_um - row[2] * above_um for row in self._rows
        )
        return self._focal_px * right / ahead, self._focal_px * down / ahead

    def _plain_radius(self, x_um: float, y_um: float) -> float:
        """Return how far from the optical axis a floor point would appear, in units of radius_px."""
        return math.hypot(*self._undistorted(x_um, y_um, 0.0)) / self._radius_px


def _axes(forward: FloatArray) -> FloatArray:
    """Return the image's right and down, and the view's direction, as rows: no roll about the axis."""
    right = np.array([1.0, 0.0, 0.0]) - forward[0] * forward
    right /= np.linalg.norm(right)
    down = np.array([0.0, 1.0, 0.0]) - forward[1] * forward
    down -= (down @ right) * right
    return np.stack([right, down / np.linalg.norm(down), forward])


def _tan_in_water(tangent: FloatArray, index: float) -> FloatArray:
    """Return the tangent of a ray's angle to the vertical after it entered the water: Snell's law."""
    sine = tangent / np.sqrt(1.0 + tangent**2) / index
    return np.asarray(sine / np.sqrt(1.0 - sine**2))
