"""Points and transforms as types: which frame a number lives in is part of its type.

Frames:
    image: camera pixels, x right, y down, origin at the centre of the top-left pixel.
    vessel: grid pixels of the vessel model, x right, y down (10 µm a pixel on the models that ship).
    stage: the manipulator's axes in µm; z grows upwards.
    hand: the operator's fingertip in metres, right-handed, x right, y up, z towards the operator.

Maps read backwards: ``image = image_from_vessel(vessel)``.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from mrnav_server.core.arrays import FloatArray


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

    def rows(self) -> list[list[float]]:
        """Return the map as two rows ``[a, b, tx], [c, d, ty]`` for JSON and OpenCV."""
        return [[self.a, self.b, self.tx], [self.c, self.d, self.ty]]


@dataclass(frozen=True, slots=True)
class Calibration:
    """How the camera, the vessel model and the manipulator see each other.

    Attributes:
        image_from_vessel: Grid pixels to image pixels, on the channel's floor.
        stage_from_vessel: Grid pixels to the manipulator's x, y in µm.
        um_per_px: Size of a grid pixel in µm.
        floor_z_um: Stage z at which the magnet's centre would touch the robot's centre.
        magnet_offset_um: Where the tip stands relative to a robot at rest below it, stage x, y in µm
            (needle tilt and Earth's field; found by approaches from four directions).
        critical_height_um: Height of the magnet above the robot at which the robot jumps, h*, in µm.
        working_distance_um: Camera's entrance pupil above the channel's floor, in µm (parallax of the tip).
        image_center_px: Where the optical axis meets the image, in pixels.
    """

    image_from_vessel: Affine2
    stage_from_vessel: Affine2
    um_per_px: float
    floor_z_um: float
    magnet_offset_um: tuple[float, float]
    critical_height_um: float
    working_distance_um: float = 70_000.0
    image_center_px: tuple[float, float] = (799.5, 599.5)

    def image_point(self, point: VesselPoint) -> ImagePoint:
        """Return where a point on the channel's floor appears in the image."""
        return ImagePoint(*self.image_from_vessel(point.x_px, point.y_px))

    def vessel_point(self, point: ImagePoint) -> VesselPoint:
        """Return the point on the channel's floor that an image pixel shows."""
        return VesselPoint(*self.image_from_vessel.inverse()(point.x_px, point.y_px))

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
        """Return where the magnet appears: its floor projection, magnified by its height."""
        flat = self.image_point(self.vessel_below(tip))
        zoom = self.working_distance_um / max(self.working_distance_um - self.height_um(tip), 1.0)
        cx, cy = self.image_center_px
        return ImagePoint(cx + (flat.x_px - cx) * zoom, cy + (flat.y_px - cy) * zoom)
