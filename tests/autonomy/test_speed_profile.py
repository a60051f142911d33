"""Speed limits along a path."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.autonomy.profile import SpeedConfig, speed_limits_um_per_s
from mrnav_server.core.arrays import FloatArray

CONFIG = SpeedConfig()
LEAD_UM = 400.0


def straight(length_um: float) -> tuple[FloatArray, FloatArray]:
    x_um = np.arange(0.0, length_um + 1.0, 10.0)
    return np.stack([x_um, np.zeros_like(x_um)], axis=1), np.tile([1.0, 0.0], (len(x_um), 1))


def roomy(points_um: FloatArray) -> FloatArray:
    return np.full(len(points_um), 500.0)


def test_a_long_straight_path_is_driven_at_cruise_and_ended_slowly() -> None:
    points_um, tangents = straight(10_000.0)
    limit = speed_limits_um_per_s(points_um, tangents, roomy(points_um), LEAD_UM, CONFIG)
    assert limit[300] == 3600.0
    assert limit[-1] == 800.0
    # v² = v_end² + 2·a·s, 300 µm before the end.
    assert limit[-31] == pytest.approx(math.sqrt(800.0**2 + 2 * 9000.0 * 300.0), rel=1e-9)


def test_a_short_path_is_driven_gently() -> None:
    points_um, tangents = straight(1400.0)
    limit = speed_limits_um_per_s(points_um, tangents, roomy(points_um), LEAD_UM, CONFIG)
    assert limit.max() == 1500.0


def test_it_brakes_gently_before_the_operator_takes_over() -> None:
    points_um, tangents = straight(10_000.0)
    limit = speed_limits_um_per_s(points_um, tangents, roomy(points_um), LEAD_UM, CONFIG, handover_um=2500.0)
    assert limit[-251:-100] == pytest.approx(1200.0)
    before = limit[-470:-420]
    assert -np.diff(before**2) / (2 * 10.0) == pytest.approx(CONFIG.handover_along_um_per_s2, rel=1e-9)


def test_near_the_wall_the_robot_slows_down() -> None:
    points_um, tangents = straight(10_000.0)
    limit = speed_limits_um_per_s(points_um, tangents, np.full(len(points_um), 40.0), LEAD_UM, CONFIG)
    assert limit[500] == pytest.approx(1500.0 + 0.5 * (3600.0 - 1500.0))


@pytest.mark.parametrize(("radius_um", "lead_um"), [(600.0, 400.0), (1500.0, 400.0), (600.0, 1200.0)])
def test_in_a_bend_the_magnet_bounds_the_speed(radius_um: float, lead_um: float) -> None:
    angle = np.arange(0.0, 9.0, 10.0 / radius_um)
    points_um = radius_um * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    tangents = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    limit = speed_limits_um_per_s(points_um, tangents, roomy(points_um), lead_um, CONFIG)
    # The magnet runs on a circle of radius hypot(R, L + swing), as often round as the robot.
    wider = math.hypot(radius_um, lead_um + CONFIG.swing_um) / radius_um
    expected = min(4700.0 / wider, math.sqrt(18_000.0 * radius_um / wider), 3600.0)
    assert limit[len(limit) // 2] == pytest.approx(max(expected, 1200.0), rel=0.01)


@given(st.integers(0, 10_000), st.floats(50.0, 1500.0))
def test_speed_never_changes_faster_than_allowed(seed: int, lead_um: float) -> None:
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.normal(0.0, 0.05, 500))
    tangents = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    points_um = np.cumsum(10.0 * tangents, axis=0)
    limit = speed_limits_um_per_s(points_um, tangents, rng.uniform(-20.0, 300.0, 500), lead_um, CONFIG)
    assert np.abs(np.diff(limit**2)).max() <= 2.0 * 9000.0 * 10.0 * (1 + 1e-6)
    assert limit.min() >= 800.0 - 1e-6
    assert limit.max() <= 3600.0


def test_a_path_without_length_has_limits() -> None:
    points_um, tangents = np.zeros((2, 2)), np.zeros((2, 2))
    assert np.isfinite(speed_limits_um_per_s(points_um, tangents, roomy(points_um), LEAD_UM, CONFIG)).all()
