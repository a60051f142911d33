"""Leash, observer and the plane that they live in."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.autonomy.leash import HoldLog
from mrnav_server.autonomy.observer import Coupling, ObserverConfig, observed
from mrnav_server.autonomy.plane import Plane
from mrnav_server.autonomy.watch import RobotWatch
from mrnav_server.core.frames import Affine2, Calibration, StagePoint, VesselPoint
from mrnav_server.core.records import TipReading, Track, TrackState
from mrnav_server.core.vessel import VesselMap

CONFIG = ObserverConfig()
TURNED = Calibration(
    image_from_vessel=Affine2.scale(1.0),
    stage_from_vessel=Affine2(-6.0, 8.0, 8.0, 6.0, 3000.0, 2000.0),  # turned, and mirrored
    um_per_px=10.0,
    floor_z_um=0.0,
    magnet_offset_um=(1500.0, -400.0),
    critical_height_um=10_000.0,
)


def track(taken_s: float, x_um: float, y_um: float) -> Track:
    seen = VesselPoint(x_um / 10.0, y_um / 10.0)
    return Track(taken_s, round(taken_s * 1000), TrackState.TRACKING, None, seen, 1.0, 4.0, 10)


def test_the_hold_point_is_linear_between_readings_and_constant_beyond() -> None:
    log = HoldLog()
    for taken_s, x_um in ((1.0, 100.0), (1.1, 200.0), (1.1, 999.0), (1.3, 300.0)):
        log.record(taken_s, (x_um, -x_um))
    assert log.at(1.05) == pytest.approx((150.0, -150.0))
    assert log.at(1.2) == pytest.approx((250.0, -250.0))
    assert log.at(0.5) == (100.0, -100.0)
    assert log.at(9.0) == (300.0, -300.0)
    assert log.travel_um(0.2) == pytest.approx((100.0, -100.0))


def test_a_stone_is_drawn_to_the_length_of_its_leash() -> None:
    log = HoldLog()
    for i in range(21):
        log.record(0.01 * i, (100.0 * i, 0.0))
    assert log.drawn((0.0, 0.0), 0.0, (0.0, 0.0), 400.0) == pytest.approx((1600.0, 0.0))
    assert log.drawn((0.0, 0.0), 0.0, (0.0, 0.0), 2500.0) == (0.0, 0.0)
    assert log.drawn((0.0, 0.0), 0.0, (300.0, 0.0), 400.0) == pytest.approx((1300.0, 0.0))
    assert log.drawn((7.0, 8.0), 0.5, (0.0, 0.0), 400.0) == (7.0, 8.0)


@given(st.lists(st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4)), min_size=1, max_size=30))
def test_the_stone_is_never_further_than_its_leash(holds_um: list[tuple[float, float]]) -> None:
    log = HoldLog()
    for i, hold_um in enumerate(holds_um, 1):
        log.record(0.01 * i, hold_um)
    stone_um = log.drawn((0.0, 0.0), 0.0, (0.0, 0.0), 400.0)
    assert math.dist(stone_um, holds_um[-1]) <= 400.0 + 1e-6


@given(st.floats(-300.0, 300.0), st.floats(-300.0, 300.0), st.floats(150.0, 900.0), st.integers(0, 1000))
def test_the_observer_finds_offset_error_and_lead(bx: float, by: float, lead_um: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    coupling = Coupling()
    for _ in range(300):
        speed, angle = rng.uniform(1000.0, 4000.0), rng.uniform(0.0, 2.0 * math.pi)
        h = np.array([math.cos(angle), math.sin(angle)])
        a = rng.normal(0.0, 5000.0, 2)
        lag_um = np.array([bx, by]) + (lead_um + 0.022 * speed) * h + 1.67e-3 * a
        coupling = observed(coupling, tuple(lag_um), tuple(speed * h), tuple(a), CONFIG)
    assert coupling.offset_um == pytest.approx((bx, by), abs=1.0)
    assert coupling.lead_um == pytest.approx(lead_um, abs=1.0)


def test_one_frame_moves_the_estimate_by_the_gains() -> None:
    # The innovation is 100 µm along h = (0.6, 0.8), of which 15 % of the offset's gain and all of the
    # lead's gain count, and 50 µm across, along (-0.8, 0.6), of which all of the offset's gain counts.
    along_um = 400.0 + 0.022 * 2000.0 + 100.0
    lag_um = (0.6 * along_um - 0.8 * 50.0, 0.8 * along_um + 0.6 * 50.0)
    after = observed(Coupling(), lag_um, (1200.0, 1600.0), (0.0, 0.0), CONFIG)
    assert after.offset_um == pytest.approx((0.6 * 1.8 - 0.8 * 6.0, 0.8 * 1.8 + 0.6 * 6.0))
    assert after.lead_um == pytest.approx(410.0)


def test_the_estimate_is_bounded() -> None:
    coupling = Coupling()
    for angle in np.linspace(0.0, 60.0, 600):
        h = (2000.0 * math.cos(angle), 2000.0 * math.sin(angle))
        coupling = observed(coupling, (9000.0, 0.0), h, (0.0, 0.0), CONFIG)
    assert math.hypot(*coupling.offset_um) <= 600.0 + 1e-9
    assert 50.0 <= coupling.lead_um <= 1600.0


def test_the_plane_maps_there_and_back_through_a_turned_stage() -> None:
    plane = Plane(TURNED)
    tip = plane.tip_um((5000.0, 7000.0))
    assert plane.hold_um(StagePoint(*tip, 0.0)) == pytest.approx((5000.0, 7000.0))
    later = plane.tip_um((5000.0 + 30.0, 7000.0 - 20.0))
    moved = (later[0] - tip[0], later[1] - tip[1])
    assert plane.tip_velocity_um_per_s((30.0, -20.0)) == pytest.approx(moved)
    # A robot at rest in its middle stands where the calibration puts it.
    assert TURNED.held_point(StagePoint(*tip, 0.0)).x_px == pytest.approx(500.0)


def watch(vessel: VesselMap) -> RobotWatch:
    return RobotWatch(vessel, Plane(TURNED), CONFIG, Coupling(lead_um=400.0))


def at(now_s: float, hold_um: tuple[float, float]) -> TipReading:
    return TipReading(now_s, StagePoint(*Plane(TURNED).tip_um(hold_um), 0.0), moving=True)


def test_the_camera_delay_is_bridged(bifurcation: VesselMap) -> None:
    watching = watch(bifurcation)
    # Hold point at 2 mm/s; the newest frame is 50 ms old and shows the robot 400 µm behind.
    for i in range(40):
        now_s = 0.01 * i
        seen_s = now_s - 0.05
        watching.take(
            track(seen_s, 8900.0, 2000.0 * seen_s + 9000.0), at(now_s, (8900.0, 2000.0 * now_s + 9400.0))
        )
    assert watching.robot_now_um() == pytest.approx((8900.0, 2000.0 * 0.39 + 9000.0), abs=15.0)


def test_rest_takes_both_camera_and_manipulator(bifurcation: VesselMap) -> None:
    still, dragged = watch(bifurcation), watch(bifurcation)
    rng = np.random.default_rng(1)
    for i in range(60):
        now_s = 0.01 * i
        seen = track(now_s, 8900.0 + rng.normal(0, 4), 9000.0 + rng.normal(0, 4))
        still.take(seen, at(now_s, (8900.0, 9300.0)))
        dragged.take(seen, at(now_s, (8900.0, 9300.0 + 2.0 * i)))
    assert still.at_rest(0.15, 25.0)
    assert not dragged.at_rest(0.1, 15.0)
    still.take(track(0.61, 8900.0, 9040.0), at(0.61, (8900.0, 9300.0)))
    assert not still.at_rest(0.15, 25.0)


def test_nothing_is_learnt_on_the_wall_or_from_a_resting_robot(bifurcation: VesselMap) -> None:
    rows = np.nonzero(bifurcation.free[:, 893])[0]
    edge_um = 10.0 * float(rows.max())
    watching = watch(bifurcation)
    for i in range(30):
        seen = track(0.03 * i, 8800.0 + 60.0 * i, edge_um)
        watching.take(seen, at(0.03 * i, (9900.0, edge_um + 500.0)))
    assert watching.coupling == Coupling(lead_um=400.0)
    for i in range(30, 60):
        watching.take(track(0.03 * i, 8900.0, 9000.0), at(0.03 * i, (9900.0, 9500.0)))
    assert watching.coupling == Coupling(lead_um=400.0)
