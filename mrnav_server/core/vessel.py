"""The vessel model as arrays that are looked up (vision computes them once, with OpenCV)."""

from dataclasses import dataclass, field

import numpy as np

from mrnav_server.core.arrays import BoolArray, Float32Array
from mrnav_server.core.frames import VesselPoint


@dataclass(frozen=True)
class VesselMap:
    """A vessel's lumen on a square grid.

    Attributes:
        name: The model's folder name under policies/.
        lumen: True inside the vessel, shape (size, size), indexed [y, x].
        distance_px: Signed distance to the wall in grid pixels, positive inside, shape (size, size).
        um_per_px: Size of a grid pixel in µm.
        robot_radius_px: Radius of the robot's disc in grid pixels.
        digest: sha256 of the mask's pixels; policies are bound to it.
        free: Where the robot's centre may be: the largest connected part of ``distance > radius``, without
            passages in which it has hardly any play.
        suggested_areas: Suggested critical areas (thrombus sites).
    """

    name: str
    lumen: BoolArray
    distance_px: Float32Array
    um_per_px: float
    robot_radius_px: float
    digest: str
    free: BoolArray
    suggested_areas: tuple[VesselPoint, ...] = field(default=())

    @property
    def size_px(self) -> int:
        """Side of the grid in pixels."""
        return int(self.lumen.shape[0])

    def wall_distance_px(self, x_px: float, y_px: float) -> float:
        """Return the bilinear signed distance to the wall, in grid pixels; positive inside."""
        top = self.size_px - 1
        x, y = min(max(x_px, 0.0), top - 1e-6), min(max(y_px, 0.0), top - 1e-6)
        i, j = int(x), int(y)
        u, v = x - i, y - j
        d = self.distance_px
        upper = d[j, i] * (1 - u) + d[j, i + 1] * u
        lower = d[j + 1, i] * (1 - u) + d[j + 1, i + 1] * u
        return float(upper * (1 - v) + lower * v)

    def wall_gradient(self, x_px: float, y_px: float) -> tuple[float, float]:
        """Return the direction away from the wall (unit length where it is defined, else zero)."""
        gx = self.wall_distance_px(x_px + 1, y_px) - self.wall_distance_px(x_px - 1, y_px)
        gy = self.wall_distance_px(x_px, y_px + 1) - self.wall_distance_px(x_px, y_px - 1)
        length = float(np.hypot(gx, gy))
        return (gx / length, gy / length) if length > 1e-9 else (0.0, 0.0)

    def clearance_um(self, point: VesselPoint) -> float:
        """Return the gap between the robot's rim and the wall, in µm; negative when it overlaps."""
        return (self.wall_distance_px(point.x_px, point.y_px) - self.robot_radius_px) * self.um_per_px

    def is_free(self, x_px: float, y_px: float) -> bool:
        """Tell whether the robot's centre fits at the nearest grid pixel."""
        i, j = round(x_px), round(y_px)
        return 0 <= i < self.size_px and 0 <= j < self.size_px and bool(self.free[j, i])
