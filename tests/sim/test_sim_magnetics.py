import math
from typing import Any

import magpylib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.sim.magnetics import (
    MU0_T_M_PER_A,
    MagneticForce,
    Magnets,
    critical_height_um,
    equilibrium_offset_um,
)

NO_AMBIENT = (0.0, 0.0, 0.0)
VERTICAL = Magnets(tilt_deg=0.0, ambient_t=NO_AMBIENT)
magpy: Any = magpylib  # it has no types


def exact_cylinder(magnets: Magnets) -> Any:  # noqa: ANN401
    cylinder = magpy.magnet.Cylinder(
        polarization=(0.0, 0.0, magnets.needle_remanence_t),
        dimension=(magnets.needle_diameter_um * 1e-6, magnets.needle_length_um * 1e-6),
    )
    return cylinder.rotate_from_angax(magnets.tilt_deg, "y").rotate_from_angax(magnets.azimuth_deg, "z")


def exact_field_t(magnets: Magnets, point_m: FloatArray) -> FloatArray:
    field_t: FloatArray = exact_cylinder(magnets).getB(point_m)
    return field_t


def exact_force_n(magnets: Magnets, robot_m: FloatArray) -> FloatArray:
    field_t = exact_field_t(magnets, robot_m)
    sphere = magpy.magnet.Sphere(
        position=robot_m,
        diameter=2e-6 * magnets.robot_radius_um,
        polarization=magnets.robot_remanence_t * field_t / np.linalg.norm(field_t),
    )
    force_n: FloatArray = magpy.getFT(exact_cylinder(magnets), sphere)[0]
    return force_n


@pytest.mark.parametrize("tilt_deg", [0.0, 45.0])
@pytest.mark.parametrize("height_mm", [3.0, 5.0, 8.0, 12.0, 15.0])
@pytest.mark.parametrize("side_mm", [0.0, 1.0, 4.0])
def test_the_force_is_that_of_the_exact_magnets(tilt_deg: float, height_mm: float, side_mm: float) -> None:
    magnets = Magnets(tilt_deg=tilt_deg, ambient_t=NO_AMBIENT)
    robot_m = np.array([-side_mm * 0.8, side_mm * 0.6, -height_mm]) * 1e-3
    exact_n = exact_force_n(magnets, robot_m)
    error_n = np.array(MagneticForce(magnets)(*robot_m.tolist())) - exact_n
    assert np.linalg.norm(error_n) < 0.005 * np.linalg.norm(exact_n)


def test_an_ambient_field_turns_the_robots_moment() -> None:
    magnets = Magnets()
    robot_m = np.array([-2e-3, 0.3e-3, -11e-3])
    total_t = exact_field_t(magnets, robot_m) + np.array(magnets.ambient_t)
    moment = magnets.robot_moment_a_m2 * total_t / np.linalg.norm(total_t)
    step_m = 1e-5
    exact_n = [
        moment
        @ (exact_field_t(magnets, robot_m + axis) - exact_field_t(magnets, robot_m - axis))
        / (2 * step_m)
        for axis in np.eye(3) * step_m
    ]
    force_n = MagneticForce(magnets)(*robot_m.tolist())
    assert force_n == pytest.approx(exact_n, abs=0.005 * float(np.linalg.norm(exact_n)))
    without_n = MagneticForce(Magnets(ambient_t=NO_AMBIENT))(*robot_m.tolist())
    assert math.dist(force_n, without_n) > 0.05 * float(np.linalg.norm(exact_n))


@given(
    st.floats(0.0, 60.0),
    st.floats(-180.0, 180.0),
    *[st.floats(-8e-3, 8e-3)] * 2,
    st.floats(-15e-3, -3e-3),
)
def test_turning_the_whole_rig_turns_the_force(
    tilt_deg: float, azimuth_deg: float, x_m: float, y_m: float, z_m: float
) -> None:
    straight = MagneticForce(Magnets(tilt_deg=tilt_deg, azimuth_deg=0.0, ambient_t=NO_AMBIENT))(x_m, y_m, z_m)
    c, s = math.cos(math.radians(azimuth_deg)), math.sin(math.radians(azimuth_deg))
    turned = MagneticForce(Magnets(tilt_deg=tilt_deg, azimuth_deg=azimuth_deg, ambient_t=NO_AMBIENT))(
        c * x_m - s * y_m, s * x_m + c * y_m, z_m
    )
    expected = (c * straight[0] - s * straight[1], s * straight[0] + c * straight[1], straight[2])
    assert turned == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_the_robot_is_as_heavy_and_as_magnetic_as_the_steel_says() -> None:
    magnets = Magnets()
    assert magnets.weight_n == pytest.approx(33.4e-6, rel=2e-3)
    assert magnets.robot_moment_a_m2 == pytest.approx(5.42e-4, rel=2e-3)
    assert magnets.needle_moment_a_m2 == pytest.approx(1.63e-3, rel=5e-3)


@pytest.mark.parametrize(
    ("length_um", "height_mm"), [(1000.0, 9.44), (2000.0, 11.27), (3000.0, 12.55), (5000.0, 14.45)]
)
def test_critical_height_of_a_vertical_needle(length_um: float, height_mm: float) -> None:
    magnets = Magnets(needle_length_um=length_um, tilt_deg=0.0, ambient_t=NO_AMBIENT)
    assert critical_height_um(magnets) == pytest.approx(height_mm * 1e3, abs=10.0)


def test_critical_height_of_two_dipoles_in_closed_form() -> None:
    flat = Magnets(needle_length_um=800.0, tilt_deg=0.0, ambient_t=NO_AMBIENT)
    pull_n_m4 = 3.0 * MU0_T_M_PER_A / (2.0 * math.pi) * flat.needle_moment_a_m2 * flat.robot_moment_a_m2
    expected_um = (pull_n_m4 / flat.weight_n) ** 0.25 * 1e6
    assert critical_height_um(flat) == pytest.approx(expected_um, abs=0.01)


def test_a_tilted_needle_has_a_lower_critical_height() -> None:
    assert critical_height_um(Magnets()) == pytest.approx(10_700.0, abs=50.0)


def test_magnets_that_cannot_lift_the_robot_are_refused() -> None:
    with pytest.raises(ConfigError, match="critical height"):
        critical_height_um(Magnets(needle_remanence_t=0.01))


def test_a_vertical_needle_holds_the_robot_right_below() -> None:
    assert equilibrium_offset_um(VERTICAL, 12_000.0) == pytest.approx((0.0, 0.0), abs=0.01)


def test_a_tilted_needle_holds_the_robot_where_no_force_is_left() -> None:
    magnets = Magnets()
    height_um = 1.04 * critical_height_um(magnets)
    x_um, y_um = equilibrium_offset_um(magnets, height_um)
    assert 1300.0 < math.hypot(x_um, y_um) < 2100.0
    fx_n, fy_n, _ = MagneticForce(magnets)(-x_um * 1e-6, -y_um * 1e-6, -height_um * 1e-6)
    assert math.hypot(fx_n, fy_n) < 1e-6 * magnets.weight_n


def test_without_an_ambient_field_the_offset_points_along_the_tilt() -> None:
    magnets = Magnets(ambient_t=NO_AMBIENT)
    x_um, y_um = equilibrium_offset_um(magnets, 11_000.0)
    assert math.degrees(math.atan2(y_um, x_um)) == pytest.approx(magnets.azimuth_deg, abs=1e-3)
    assert math.hypot(x_um, y_um) == pytest.approx(0.165 * 11_000.0, rel=0.03)


@pytest.mark.parametrize("azimuth_deg", [-180.0, -90.0, 90.0, 180.0])
def test_a_needle_tilted_along_an_axis_of_the_stage_holds_the_robot_as_well(azimuth_deg: float) -> None:
    straight = Magnets(azimuth_deg=0.0)
    c, s = math.cos(math.radians(azimuth_deg)), math.sin(math.radians(azimuth_deg))
    x_t, y_t, z_t = straight.ambient_t
    ambient_t = (c * x_t - s * y_t, s * x_t + c * y_t, z_t)
    turned = Magnets(azimuth_deg=azimuth_deg, ambient_t=ambient_t)
    x_um, y_um = equilibrium_offset_um(straight, 11_000.0)
    offset_um = equilibrium_offset_um(turned, 11_000.0)
    assert offset_um == pytest.approx((c * x_um - s * y_um, s * x_um + c * y_um), abs=0.01)
    assert critical_height_um(turned) == pytest.approx(critical_height_um(straight), abs=0.01)


def test_too_high_the_needle_holds_nothing() -> None:
    with pytest.raises(ConfigError, match="no rest position"):
        equilibrium_offset_um(Magnets(), 19_000.0)


@pytest.mark.parametrize(
    ("name", "value"), [("tilt_deg", 90.0), ("azimuth_deg", math.nan), ("needle_length_um", 0.0)]
)
def test_a_needle_out_of_range_is_named(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"sim.magnets.{name}"):
        TypeAdapter(Magnets).validate_python({name: value})
