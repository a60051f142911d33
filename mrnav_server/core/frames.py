"""Points and transforms as types: which frame a number lives in is part of its type.

Frames:
    image: camera pixels, x right, y down, origin at the centre of the top-left pixel.
    vessel: grid pixels of the vessel model, x right, y down (10 µm a pixel on the models that ship).
    floor: the channel's floor (at the height of the robot's centre) in µm; a calibration sheet lay there.
    stage: the manipulator's axes in µm; z grows upwards.
    hand: the operator's fingertip in metres, right-handed, x right, y up, z towards the operator.

Maps read backwards: ``image = image_from_vessel(vessel)``.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.camera_map import FloorMap, TipMap


@dataclass(frozen=True, slots=True)
class ImagePoint:
    """A point in the camera image, in pixels."""

    x_px: float
    y_px: float


@dataclass(frozen=True, slots=True)
class VesselPoint:
    """A point in the vessel model's grid, in grid pixels."""

    x_px: float
    y_px: float

    def distance_px(self, other: "VesselPoint") -> float:
        """Return the Euclidean distance to another point, in grid pixels."""
        return float(np.hypot(self.x_px - other.x_px, self.y_px - other.y_px))


@dataclass(frozen=True, slots=True)
class StagePoint:
    """A position of the manipulator's tip (the magnet's centre), in µm."""

    x_um: float
    y_um: float
    z_um: float

    def array(self) -> FloatArray:
        """Return ``[x, y, z]`` in µm, shape (3,)."""
        return np.array([self.x_um, self.y_um, self.z_um])

    @classmethod
    def of(cls, xyz_um: FloatArray) -> Self:
        """Build a point from an array of shape (3,), in µm."""
        return cls(float(xyz_um[0]), float(xyz_um[1]), float(xyz_um[2]))


@dataclass(frozen=True, slots=True)
class HandPoint:
    """A fingertip position, in metres, right-handed (x right, y up, z towards the operator)."""

    x_m: float
    y_m: float
    z_m: float


@dataclass(frozen=True, slots=True)
class Affine2:
    """A planar affine map ``out = matrix @ in + offset``.

    Attributes:
        a, b, c, d: The matrix ``[[a, b], [c, d]]``.
        tx, ty: The offset, in units of the output frame.
    """

    a: float
    b: float
    c: float
    d: float
    tx: float
    ty: float

    @classmethod
    def scale(cls, factor: float, tx: float = 0.0, ty: float = 0.0) -> Self:
        """Return a uniform scaling followed by a translation."""
        return cls(factor, 0.0, 0.0, factor, tx, ty)

    def __call__(self, x: float, y: float) -> tuple[float, float]:
        """Map one point."""
        return self.a * x + self.b * y + self.tx, self.c * x + self.d * y + self.ty

    def inverse(self) -> "Affine2":
        """Return the inverse map.

        Raises:
            ValueError: If the matrix is singular.
        """
        det = self.a * self.d - self.b * self.c
        if abs(det) < 1e-12:
            raise ValueError("a singular transform has no inverse")
        a, b, c, d = self.d / det, -self.b / det, -self.c / det, self.a / det
        return Affine2(a, b, c, d, -(a * self.tx + b * self.ty), -(c * self.tx + d * self.ty))

    def after(self, first: "Affine2") -> "Affine2":
        """Return the map that applies another one first."""
        a, c = self.a * first.a + self.b * first.c, self.c * first.a + self.d * first.c
        b, d = self.a * first.b + self.b * first.d, self.c * first.b + self.d * first.d
        return Affine2(a, b, c, d, *self(first.tx, first.ty))

    @classmethod
    def of_rows(cls, rows: FloatArray | list[list[float]]) -> Self:
        """Return the map with two rows ``[a, b, tx], [c, d, ty]``."""
        (a, b, tx), (c, d, ty) = ([float(value) for value in row] for row in rows)
        return cls(a, b, c, d, tx, ty)

    @property
    def linear_scale(self) -> float:
        """How many output units one input unit spans: the root of the determinant."""
        return float(np.sqrt(abs(self.a * self.d - self.b * self.c)))

    def rows(self) -> list[list[float]]:
        """Return the map as two rows ``[a, b, tx], [c, d, ty]`` for JSON and OpenCV."""
        return [[self.a, self.b, self.tx], [self.c, self.d, self.ty]]


@dataclass(frozen=True, slots=True)
class Calibration:
    """How the camera, the vessel model and the manipulator see each other.

    Without the two maps the camera looks straight down through a lens without distortion, and affine maps
    say it all; so it is on the simulated rig unless its optics are switched on. With them the maps are the
    truth, and ``image_from_vessel`` is the affine nearest to it, for drawing.

    Attributes:
        image_from_vessel: Grid pixels to image pixels, on the channel's floor; affine.
        stage_from_vessel: Grid pixels to the manipulator's x, y in µm.
        um_per_px: Size of a grid pixel in µm.
        floor_z_um: Stage z at which the magnet's centre would touch the robot's centre.
        magnet_offset_um: Where the tip stands relative to a robot at rest below it, stage x, y in µm
            (needle tilt and Earth's field; found by approaches from four directions).
        critical_height_um: Height of the magnet above the robot at which the robot jumps, h*, in µm.
        working_distance_um: Camera's entrance pupil above the channel's floor, in µm (parallax of the tip).
        image_center_px: Where the optical axis meets the image, in pixels.
        floor: Grid pixels to image pixels, with perspective and distortion; None is ``image_from_vessel``.
        tip: Stage µm to the grid pixels that the tip hides; None is the parallax of a camera straight above.
    """

    image_from_vessel: Affine2
    stage_from_vessel: Affine2
    um_per_px: float
    floor_z_um: float
    magnet_offset_um: tuple[float, float]
    critical_height_um: float
    working_distance_um: float = 70_000.0
    image_center_px: tuple[float, float] = (799.5, 599.5)
    floor: FloorMap | None = None
    tip: TipMap | None = None

    def image_point(self, point: VesselPoint) -> ImagePoint:
        """Return where a point on the channel's floor appears in the image."""
        if self.floor is None:
            return ImagePoint(*self.image_from_vessel(point.x_px, point.y_px))
        x_px, y_px = self.floor.image(np.array([point.x_px, point.y_px]))
        return ImagePoint(float(x_px), float(y_px))

    def vessel_point(self, point: ImagePoint) -> VesselPoint:
        """Return the point on the channel's floor that an image pixel shows."""
        if self.floor is None:
            return VesselPoint(*self.image_from_vessel.inverse()(point.x_px, point.y_px))
        x_px, y_px = self.floor.floor(np.array([point.x_px, point.y_px]))
        return VesselPoint(float(x_px), float(y_px))

    def image_scale(self, point: VesselPoint) -> float:
        """Return how many image pixels a grid pixel spans at a point on the channel's floor."""
        if self.floor is None:
            return self.image_from_vessel.linear_scale
        return float(self.floor.scale(np.array([point.x_px, point.y_px])))

    def stage_xy_um(self, point: VesselPoint) -> tuple[float, float]:
        """Return stage x, y in µm right above a vessel point."""
        return self.stage_from_vessel(point.x_px, point.y_px)

    def vessel_below(self, tip: StagePoint) -> VesselPoint:
        """Return the vessel point right below the tip (no magnetic offset)."""
        return VesselPoint(*self.stage_from_vessel.inverse()(tip.x_um, tip.y_um))

    def held_point(self, tip: StagePoint) -> VesselPoint:
        """Return the vessel point at which a frictionless robot rests under the tip."""
        x_um, y_um = tip.x_um - self.magnet_offset_um[0], tip.y_um - self.magnet_offset_um[1]
        return VesselPoint(*self.stage_from_vessel.inverse()(x_um, y_um))

    def height_um(self, tip: StagePoint) -> float:
        """Return the magnet's height above the robot's centre, in µm."""
        return tip.z_um - self.floor_z_um

    def tip_in_image(self, tip: StagePoint) -> ImagePoint:
        """Return where the magnet appears: the image of the floor point that it hides."""
        if self.tip is not None:
            x_px, y_px = self.tip.floor(tip.array())
            return self.image_point(VesselPoint(float(x_px), float(y_px)))
        flat = self.image_point(self.vessel_below(tip))
        zoom = self.working_distance_um / max(self.working_distance_um - self.height_um(tip), 1.0)
        cx, cy = self.image_center_px
        return ImagePoint(cx + (flat.x_px - cx) * zoom, cy + (flat.y_px - cy) * zoom)

    def registered(self, old_from_new: Affine2) -> "Calibration":
        """Return the calibration for a vessel model that lies elsewhere on the floor.

        Args:
            old_from_new: Grid pixels as they were from grid pixels as they are.
        """
        return replace(
            self,
            image_from_vessel=self.image_from_vessel.after(old_from_new),
            stage_from_vessel=self.stage_from_vessel.after(old_from_new),
            floor=self.floor and self.floor.after(np.array(old_from_new.rows())),
            tip=self.tip and self.tip.then(np.array(old_from_new.inverse().rows())),
        )
