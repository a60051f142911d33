"""The robot alone, under a magnet that the test moves by hand."""

import math
from functools import cache

import numpy as np
import pytest

from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.vessel import VesselMap
from mrnav_server.sim.magnetics import MagneticForce, Magnets
from mrnav_server.sim.robot import STEP_S, Robot
from mrnav_server.vision.vessel_model import vessel_map

MAGNETS = Magnets(tilt_deg=0.0, ambient_t=(0.0, 0.0, 0.0))
HEIGHT_M = 12e-3
PX_M = 1e-5
MASS_KG = (7500.0 + 0.5 * 998.0) * MAGNETS.robot_volume_m3


@cache
def channel() -> VesselMap:
    """A straight channel of 4 mm, along x."""
    mask = np.zeros((1200, 1200), np.uint8)
    mask[400:800, 50:1150] = 255
    return vessel_map("channel", mask)


def make(friction: float = 0.2, y_px: float = 600.0, x_px: float = 300.0) -> Robot:
    return Robot(
        MAGNETS,
        channel(),
        VesselPoint(x_px, y_px),
        friction=friction,
        static_ratio=1.2,
        drag_factor=4.0,
        viscosity_pa_s=1e-3,
    )


def hold(robot: Robot, x_px: float, y_px: float, seconds: float, height_m: float = HEIGHT_M) -> None:
    for _ in range(round(seconds / STEP_S)):
        robot.step(x_px * PX_M, y_px * PX_M, height_m)


def lag_um(friction: float, speed_um_per_s: float) -> float:
    """Follow a magnet along the channel until the lag is steady."""
    robot = make(friction)
    x_m = 300 * PX_M
    for _ in range(round(7000 / speed_um_per_s / STEP_S)):
        x_m += speed_um_per_s * 1e-6 * STEP_S
        robot.step(x_m, 600 * PX_M, HEIGHT_M)
    return x_m * 1e6 - robot.position.x_px * PX_M * 1e6


@pytest.mark.parametrize(("friction", "expected_um"), [(0.05, 180), (0.1, 320), (0.2, 610), (0.3, 935)])
def test_friction_sets_the_lag(friction: float, expected_um: float) -> None:
    assert lag_um(friction, 2400.0) == pytest.approx(expected_um, rel=0.03)


def test_the_lag_hardly_depends_on_speed() -> None:
    assert lag_um(0.2, 4800.0) / lag_um(0.2, 1200.0) < 1.25


def test_a_robot_that_sticks_does_not_creep() -> None:
    robot = make()
    robot.step(330 * PX_M, 600 * PX_M, HEIGHT_M)
    before = robot.position
    hold(robot, 330, 600, 2.0)
    assert robot.position == before
    assert robot.speed_um_per_s == 0.0


@pytest.mark.parametrize(("excess", "moves"), [(1.15, False), (1.25, True)])
def test_to_break_away_takes_a_fifth_more_than_to_slide(excess: float, moves: bool) -> None:
    pull = MagneticForce(MAGNETS)
    for ahead_um in range(100, 1000):
        fx_n, _, fz_n = pull(-ahead_um * 1e-6, 0.0, -HEIGHT_M)
        if fx_n > excess * 0.2 * (MAGNETS.weight_n - fz_n):
            break
    robot = make()
    hold(robot, 300 + ahead_um / 10, 600, 0.2)
    assert (robot.position.x_px > 300) == moves


def test_a_wall_rubs_in_proportion_to_the_impact() -> None:
    in_the_middle, at_the_wall = make(y_px=600), make(y_px=750)
    for robot in (in_the_middle, at_the_wall):
        robot.held = False
        robot._vx_m_per_s = robot._vy_m_per_s = 0.05
        hold(robot, 0, 0, STEP_S)
    lost = in_the_middle._vx_m_per_s - at_the_wall._vx_m_per_s
    assert lost == pytest.approx(0.2 * in_the_middle._vy_m_per_s)
    assert at_the_wall._vy_m_per_s == 0.0


def test_a_magnet_further_ahead_than_friction_holds_pulls_it_along() -> None:
    robot = make()
    hold(robot, 400, 600, 1.0)
    assert robot.position.x_px > 330
    assert robot.position.y_px == 600


def test_without_friction_it_swings_at_four_hertz_and_rests_below_the_magnet() -> None:
    robot = make(friction=0.0)
    crossings = []
    for step in range(600):
        before = robot.position.x_px
        robot.step(330 * PX_M, 600 * PX_M, HEIGHT_M)
        if (before - 330) * (robot.position.x_px - 330) < 0:
            crossings.append(step * STEP_S)
    assert 1.0 / (2.0 * np.diff(crossings).mean()) == pytest.approx(4.1, abs=0.2)
    hold(robot, 330, 600, 4.0)
    assert robot.position.x_px == pytest.approx(330, abs=0.01)


def test_pressed_against_a_wall_it_counts_once_and_stays_outside() -> None:
    robot = make()
    hold(robot, 300, 850, 2.0)
    assert robot.collisions == 1
    assert 0.0 <= channel().clearance_um(robot.position) < 1.0


def test_a_wall_lets_it_slide_along() -> None:
    robot = make(y_px=740)
    gaps_um = []
    for step in range(2000):
        robot.step((300 + 0.2 * step) * PX_M, 800 * PX_M, HEIGHT_M)
        gaps_um.append(channel().clearance_um(robot.position))
    assert robot.position.x_px > 550
    assert min(gaps_um) >= 0.0
    assert robot.collisions == 1


def test_a_second_contact_counts_only_after_a_gap_and_a_pause() -> None:
    robot = make(friction=0.05, y_px=748)
    hold(robot, 300, 800, 0.3)
    assert robot.collisions == 1
    hold(robot, 300, 600, 0.04)
    assert channel().clearance_um(robot.position) > 50.0
    hold(robot, 300, 900, 0.3)
    assert channel().clearance_um(robot.position) < 1.0
    assert robot.collisions == 1, "a rebound within 0.2 s is the same contact"
    hold(robot, 300, 600, 1.0)
    hold(robot, 300, 900, 1.0)
    assert robot.collisions == 2


def test_a_small_gap_does_not_arm_the_count() -> None:
    robot = make(y_px=748)
    hold(robot, 300, 850, 0.5)
    robot._y_m -= 30e-6
    hold(robot, 300, 748, 0.5)
    assert 20.0 < channel().clearance_um(robot.position) < 50.0
    hold(robot, 300, 850, 0.5)
    assert robot.collisions == 1


def test_a_corner_never_lets_it_in() -> None:
    robot = make(x_px=150.0, friction=0.05)
    for x_px, y_px in [(0, 300), (20, 900), (0, 390), (0, 840)]:
        for _ in range(500):
            robot.step(x_px * PX_M, y_px * PX_M, HEIGHT_M)
            assert channel().clearance_um(robot.position) >= 0.0


def test_below_the_critical_height_it_jumps_to_the_magnet_after_20_ms() -> None:
    robot = make()
    lifted_after_s = None
    for step in range(40):
        robot.step(300 * PX_M, 600 * PX_M, 11.2e-3)
        if robot.lifted and lifted_after_s is None:
            lifted_after_s = step * STEP_S
    assert lifted_after_s == pytest.approx(0.02, abs=0.0015)
    before = robot.position
    hold(robot, 500, 600, 0.5)
    assert robot.position == before


def test_a_brief_dip_does_not_lift_it() -> None:
    robot = make()
    for _ in range(20):
        hold(robot, 300, 600, 0.015, height_m=11.2e-3)
        hold(robot, 300, 600, 0.005, height_m=11.4e-3)
    assert not robot.lifted


def test_a_lost_robot_comes_to_rest() -> None:
    robot = make()
    hold(robot, 450, 600, 0.05)
    assert robot.speed_um_per_s > 100.0
    robot.held = False
    hold(robot, 900, 600, 0.5)
    after = robot.position
    hold(robot, 900, 600, 0.5)
    assert robot.position == after


def test_a_sliding_robot_stops_where_friction_says() -> None:
    """Without a pull it slides a little less than v²m/(2µW): there is drag, too."""
    robot = make()
    robot.held = False
    robot._vx_m_per_s = 0.02
    hold(robot, 0, 0, 0.5)
    dry_um = 0.02**2 * MASS_KG / (2 * 0.2 * MAGNETS.weight_n) * 1e6
    assert 0.7 * dry_um < (robot.position.x_px - 300) * 10 < dry_um


def test_without_friction_drag_stops_it_where_stokes_says() -> None:
    robot = make(friction=0.0)
    robot.held = False
    robot._vx_m_per_s = 1e-4
    hold(robot, 0, 0, 2.0)
    drag_n_s_per_m = 6 * math.pi * 1e-3 * 0.5e-3 * 4.0
    assert (robot.position.x_px - 300) * 10 == pytest.approx(1e-4 * MASS_KG / drag_n_s_per_m * 1e6, rel=0.04)
