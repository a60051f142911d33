"""The needle's cylinder magnet pulls the robot's sphere magnet: force, rest position, critical height.

Two point dipoles on the cylinder's axis reproduce its field to 0.13 % from 3 mm on, where one dipole is
25 % wrong; a uniformly magnetised sphere is a point dipole exactly.
"""

import math
from dataclasses import dataclass

import numpy as np

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.errors import ConfigError

MU0_T_M_PER_A = 4e-7 * math.pi
GRAVITY_M_PER_S2 = 9.81
FLATTEST_WITH_TWO_DIPOLES = math.sqrt(3.0) / 2.0
"""Length over diameter of the cylinder that a single dipole describes best; a flatter one gets one, too."""
SEARCHED_HEIGHT_UM = (5_000.0, 25_000.0)
"""Where the critical height is looked for."""
ALLOWED = {
    "needle_diameter_um": (100.0, 5000.0),
    "needle_length_um": (100.0, 10_000.0),
    "tilt_deg": (0.0, 80.0),
    "azimuth_deg": (-360.0, 360.0),
}
"""What can be computed and drawn; the ranges in ``Magnets`` are those of the bench."""


@dataclass(frozen=True, slots=True)
class Magnets:
    """The needle's magnet, the robot, and the ambient field.

    Attributes:
        needle_remanence_t: Remanence of the needle's magnet (N42), 1.17..1.45 T.
        needle_diameter_um: Its diameter in µm, 500..2000.
        needle_length_um: Its length in µm, 1000..5000.
        robot_remanence_t: Remanence of the robot's sphere, 1.17..1.45 T.
        robot_radius_um: Radius of the robot in µm; the vessel model must be made for the same robot.
        robot_density_kg_per_m3: Density of the robot, 7300..7700.
        fluid_density_kg_per_m3: Density of the fluid, about 1000.
        tilt_deg: The needle's tilt from the vertical, 0..60°.
        azimuth_deg: Where the tilt points in the stage's x-y plane, -180..180°.
        ambient_t: Uniform ambient field in the stage's axes, in T (Earth: 49 µT, dip 66°).
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    needle_remanence_t: float = 1.30
    needle_diameter_um: float = 1000.0
    needle_length_um: float = 2000.0
    robot_remanence_t: float = 1.30
    robot_radius_um: float = 500.0
    robot_density_kg_per_m3: float = 7500.0
    fluid_density_kg_per_m3: float = 998.0
    tilt_deg: float = 45.0
    azimuth_deg: float = -15.0
    ambient_t: tuple[float, float, float] = (15e-6, 12.5e-6, -45e-6)

    def __post_init__(self) -> None:
        for name, (low, high) in ALLOWED.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigError(f"sim.magnets.{name} is {value:g}; choose it within {low:g}..{high:g}")

    @property
    def needle_moment_a_m2(self) -> float:
        """Magnetic moment of the needle's cylinder, in A·m²."""
        area_m2 = math.pi * (self.needle_diameter_um * 0.5e-6) ** 2
        return self.needle_remanence_t / MU0_T_M_PER_A * area_m2 * self.needle_length_um * 1e-6

    @property
    def robot_volume_m3(self) -> float:
        """Volume of the robot, in m³."""
        return 4.0 / 3.0 * math.pi * (self.robot_radius_um * 1e-6) ** 3

    @property
    def robot_moment_a_m2(self) -> float:
        """Magnetic moment of the robot's sphere, in A·m²."""
        return self.robot_remanence_t / MU0_T_M_PER_A * self.robot_volume_m3

    @property
    def weight_n(self) -> float:
        """The robot's weight less buoyancy, in N."""
        excess = self.robot_density_kg_per_m3 - self.fluid_density_kg_per_m3
        return excess * self.robot_volume_m3 * GRAVITY_M_PER_S2

    @property
    def direction(self) -> tuple[float, float, float]:
        """Unit vector of the needle magnet's moment in the stage's axes."""
        tilt, azimuth = math.radians(self.tilt_deg), math.radians(self.azimuth_deg)
        return math.sin(tilt) * math.cos(azimuth), math.sin(tilt) * math.sin(azimuth), math.cos(tilt)

    @property
    def dipole_offset_m(self) -> float:
        """Distance of each dipole from the cylinder's centre, in m; 0 for a cylinder that one describes.

        ``√(L²/12 − R²/4)`` matches the cylinder's second moment along its axis less that across it.
        """
        if self.needle_length_um <= FLATTEST_WITH_TWO_DIPOLES * self.needle_diameter_um:
            return 0.0
        return math.sqrt(self.needle_length_um**2 / 12.0 - self.needle_diameter_um**2 / 16.0) * 1e-6


class MagneticForce:
    """The force on the robot, its moment aligned with the total field, ``F = (m·∇)B``.

    Plain floats, because the robot's dynamics call it every millisecond.
    """

    def __init__(self, magnets: Magnets) -> None:
        self._direction = magnets.direction
        self._ambient_t = magnets.ambient_t
        self._robot_moment_a_m2 = magnets.robot_moment_a_m2
        offset_m = magnets.dipole_offset_m
        self._dipoles_m = (offset_m, -offset_m) if offset_m else (0.0,)
        self._strength_t_m3 = 1e-7 * magnets.needle_moment_a_m2 / len(self._dipoles_m)

    def __call__(self, x_m: float, y_m: float, z_m: float) -> tuple[float, float, float]:
        """Return the force on the robot in N, in the stage's axes.

        Args:
            x_m: The robot's centre less the magnet's centre along x, in m.
            y_m: The same along y.
            z_m: The same along z; negative, for the robot is below.

        Source: ``B = B0 + Σ k(3(u·ρ)ρ − uρ²)/ρ⁵`` and its analytic gradient.
        """
        ux, uy, uz = self._direction
        bx, by, bz = self._ambient_t
        strength = self._strength_t_m3
        gxx = gxy = gxz = gyy = gyz = gzz = 0.0
        for offset in self._dipoles_m:
            rx, ry, rz = x_m - offset * ux, y_m - offset * uy, z_m - offset * uz
            r2 = rx * rx + ry * ry + rz * rz
            k = strength / (r2 * r2 * math.sqrt(r2))
            ur = ux * rx + uy * ry + uz * rz
            bx += k * (3.0 * ur * rx - ux * r2)
            by += k * (3.0 * ur * ry - uy * r2)
            bz += k * (3.0 * ur * rz - uz * r2)
            g = 3.0 * k
            w = 5.0 * ur / r2
            gxx += g * (2.0 * ux * rx + ur - w * rx * rx)
            gyy += g * (2.0 * uy * ry + ur - w * ry * ry)
            gzz += g * (2.0 * uz * rz + ur - w * rz * rz)
            gxy += g * (ux * ry + uy * rx - w * rx * ry)
            gxz += g * (ux * rz + uz * rx - w * rx * rz)
            gyz += g * (uy * rz + uz * ry - w * ry * rz)
        m = self._robot_moment_a_m2 / math.sqrt(bx * bx + by * by + bz * bz)
        return (
            m * (gxx * bx + gxy * by + gxz * bz),
            m * (gxy * bx + gyy * by + gyz * bz),
            m * (gxz * bx + gyz * by + gzz * bz),
        )


def equilibrium_offset_um(magnets: Magnets, height_um: float) -> tuple[float, float]:
    """Return where the tip stands relative to a frictionless robot at rest below it, stage x, y in µm.

    Args:
        magnets: The magnets and the ambient field.
        height_um: The magnet's height above the robot's centre, in µm.

    Raises:
        ConfigError: If the robot rests nowhere near the needle (high up, the ambient field prevails).
    """
    offset_um = _rest_um(MagneticForce(magnets), magnets, height_um)
    if offset_um is None:
        raise ConfigError(
            f"magnets: the robot has no rest position {height_um * 1e-3:.1f} mm below the needle;"
            " check tilt_deg (0..60) and ambient_t"
        )
    return offset_um


def critical_height_um(magnets: Magnets) -> float:
    """Return h*, the height in µm at which the pull on a robot at rest equals its weight.

    Below it the robot jumps to the magnet. Found by bisection along the rest positions.

    Raises:
        ConfigError: If it lies outside the heights that are searched.
    """
    force = MagneticForce(magnets)

    def lifts(height_um: float) -> bool:
        rest_um = _rest_um(force, magnets, height_um)
        return rest_um is not None and _pull_n(force, rest_um, height_um) > magnets.weight_n

    low_um, high_um = SEARCHED_HEIGHT_UM
    if not lifts(low_um) or lifts(high_um):
        raise ConfigError(
            f"magnets: the critical height is not within {low_um / 1e3:.0f}..{high_um / 1e3:.0f} mm;"
            " check the remanences and sizes"
        )
    while high_um - low_um > 1e-3:
        middle_um = 0.5 * (low_um + high_um)
        low_um, high_um = (middle_um, high_um) if lifts(middle_um) else (low_um, middle_um)
    return 0.5 * (low_um + high_um)


def _rest_um(force: MagneticForce, magnets: Magnets, height_um: float) -> tuple[float, float] | None:
    """Return the tip's offset from a robot at rest, or None where the needle holds it nowhere."""
    from scipy.optimize import root

    def lateral_un(offset_mm: FloatArray, /) -> FloatArray:
        x_m, y_m = float(offset_mm[0]) * 1e-3, float(offset_mm[1]) * 1e-3
        return np.array(force(-x_m, -y_m, -height_um * 1e-6)[:2]) * 1e6

    guess_mm = np.array(magnets.direction[:2]) * 0.2e-3 * height_um
    # The solver's steps are in proportion to the guess: one of 1e-16 (cos 90°) would leave it none.
    guess_mm[np.abs(guess_mm) < 1e-9] = 0.0
    found = root(lateral_un, guess_mm)
    rest_um = float(found.x[0]) * 1e3, float(found.x[1]) * 1e3
    # High up the ambient field turns the robot over: what balances there is pushed, not held.
    held = found.success and math.hypot(*rest_um) < height_um and _pull_n(force, rest_um, height_um) > 0.0
    return rest_um if held else None


def _pull_n(force: MagneticForce, offset_um: tuple[float, float], height_um: float) -> float:
    """Return the upward pull on a robot with the tip at an offset from it, in N."""
    return force(-offset_um[0] * 1e-6, -offset_um[1] * 1e-6, -height_um * 1e-6)[2]
