"""The robot slides on the channel's floor: pull, drag, Coulomb friction, walls.

Everything inside is in SI units, in the vessel's plane: the stage's axes, with the origin at the centre of
the vessel grid's first pixel. The motion is semi-implicit Euler at 1 ms (0.56 µm RMS against 10 µs).
"""

import math

from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.vessel import VesselMap
from mrnav_server.sim.magnetics import MagneticForce, Magnets

STEP_S = 0.001
"""The integration step."""
STRIBECK_M_PER_S = 1e-4
"""Speed over which static friction gives way to kinetic friction."""
LIFT_S = 0.02
"""A pull above the weight for longer than this lifts the robot off: it has jumped to the magnet."""
REARM_GAP_M = 50e-6
REARM_S = 0.2
"""A collision counts again once the gap was this wide and this much time has passed since."""
PROJECTIONS = 4
"""Pushes out of a wall in one step: two walls that meet take more than one."""


class Robot:
    """The robot's dynamics.

    Args:
        magnets: The magnets and the ambient field.
        vessel: The walls.
        start: Where the robot's centre is at rest, in the vessel's grid.
        friction: Kinetic friction coefficient against floor and walls.
        static_ratio: Static over kinetic friction.
        drag_factor: Stokes drag near the floor over that in free fluid.
        viscosity_pa_s: Viscosity of the fluid.

    Attributes:
        collisions: Onsets of wall contact so far.
        lifted: True once the robot jumped to the magnet; it moves no more.
        held: Whether the magnet pulls; false simulates a robot that was lost.
    """

    def __init__(
        self,
        magnets: Magnets,
        vessel: VesselMap,
        start: VesselPoint,
        *,
        friction: float,
        static_ratio: float,
        drag_factor: float,
        viscosity_pa_s: float,
    ) -> None:
        self._force = MagneticForce(magnets)
        self._vessel = vessel
        self._px_m = vessel.um_per_px * 1e-6
        self._radius_m = magnets.robot_radius_um * 1e-6
        self._weight_n = magnets.weight_n
        density_kg_per_m3 = magnets.robot_density_kg_per_m3 + 0.5 * magnets.fluid_density_kg_per_m3
        self._mass_kg = density_kg_per_m3 * magnets.robot_volume_m3  # with the fluid that it carries along
        self._friction = friction
        self._static_excess = (static_ratio - 1.0) * friction
        self._drag_n_s_per_m = 6.0 * math.pi * viscosity_pa_s * self._radius_m * drag_factor
        self._reynolds_s_per_m = 2.0 * self._radius_m * magnets.fluid_density_kg_per_m3 / viscosity_pa_s
        self.collisions = 0
        self.held = True
        self.place(start)

    def place(self, point: VesselPoint) -> None:
        """Put the robot down at rest; it lies on the floor again."""
        self._x_m, self._y_m = point.x_px * self._px_m, point.y_px * self._px_m
        self._vx_m_per_s = self._vy_m_per_s = 0.0
        self._touching = False
        self._rearm_s = 0.0
        self._lifting_s = 0.0
        self.lifted = False

    @property
    def position(self) -> VesselPoint:
        """The robot's centre in the vessel's grid."""
        return VesselPoint(self._x_m / self._px_m, self._y_m / self._px_m)

    @property
    def speed_um_per_s(self) -> float:
        """How fast the robot slides, in µm/s."""
        return math.hypot(self._vx_m_per_s, self._vy_m_per_s) * 1e6

    def step(self, magnet_x_m: float, magnet_y_m: float, height_m: float) -> None:
        """Advance by ``STEP_S`` with the magnet at a place in the vessel's plane and a height above it."""
        if self.lifted:
            return
        fx_n = fy_n = fz_n = 0.0
        if self.held:
            fx_n, fy_n, fz_n = self._force(self._x_m - magnet_x_m, self._y_m - magnet_y_m, -height_m)
        self._lifting_s = self._lifting_s + STEP_S if fz_n > self._weight_n else 0.0
        if self._lifting_s > LIFT_S:
            self.lifted = True
            self._vx_m_per_s = self._vy_m_per_s = 0.0
            return
        self._slide(fx_n, fy_n, max(0.0, self._weight_n - fz_n))

    def _slide(self, fx_n: float, fy_n: float, normal_n: float) -> None:
        """Drag is implicit; friction is a projection of the velocity, so that sticking is exact."""
        speed = math.hypot(self._vx_m_per_s, self._vy_m_per_s)
        drag = self._drag_n_s_per_m * (1.0 + 0.15 * (self._reynolds_s_per_m * speed) ** 0.687)
        per_mass = STEP_S / self._mass_kg
        damping = 1.0 / (1.0 + drag * per_mass)
        vx = (self._vx_m_per_s + per_mass * fx_n) * damping
        vy = (self._vy_m_per_s + per_mass * fy_n) * damping
        friction = self._friction + self._static_excess * math.exp(-speed / STRIBECK_M_PER_S)
        lost = friction * normal_n * per_mass * damping
        driven = math.hypot(vx, vy)
        kept = 1.0 - lost / driven if driven > lost else 0.0
        self._move(vx * kept, vy * kept)

    def _move(self, vx: float, vy: float) -> None:
        x, y = self._x_m + STEP_S * vx, self._y_m + STEP_S * vy
        gap_m = self._gap_m(x, y)
        if gap_m < 0.0:
            x, y, vx, vy = self._pushed_out(x, y, vx, vy, gap_m)
        elif gap_m > REARM_GAP_M:
            self._touching = False
        if not self._touching and self._rearm_s > 0.0:
            self._rearm_s -= STEP_S
        self._x_m, self._y_m, self._vx_m_per_s, self._vy_m_per_s = x, y, vx, vy

    def _pushed_out(
        self, x: float, y: float, vx: float, vy: float, gap_m: float
    ) -> tuple[float, float, float, float]:
        """Put the robot back on the wall, drop its speed into it, and let the wall rub."""
        if not self._touching and self._rearm_s <= 0.0:
            self.collisions += 1
        self._touching, self._rearm_s = True, REARM_S
        for _ in range(PROJECTIONS):
            nx, ny = self._vessel.wall_gradient(x / self._px_m, y / self._px_m)
            x, y = x - gap_m * nx, y - gap_m * ny
            into = min(0.0, vx * nx + vy * ny)
            vx, vy = vx - into * nx, vy - into * ny
            along = math.hypot(vx, vy)
            rubbed = -self._friction * into
            kept = 1.0 - rubbed / along if along > rubbed else 0.0
            vx, vy = vx * kept, vy * kept
            gap_m = self._gap_m(x, y)
            if gap_m >= 0.0:
                return x, y, vx, vy
        return self._x_m, self._y_m, 0.0, 0.0  # wedged: where it was is free

    def _gap_m(self, x: float, y: float) -> float:
        """Gap between the robot's rim and the wall, negative when it overlaps."""
        return self._vessel.wall_distance_px(x / self._px_m, y / self._px_m) * self._px_m - self._radius_m
