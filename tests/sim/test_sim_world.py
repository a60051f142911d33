import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import StagePoint, VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.vessel import VesselMap
from mrnav_server.sim.magnetics import Magnets
from mrnav_server.sim.world import SimConfig, SimulatedWorld, start_near_an_end
from mrnav_server.vision.vessel_model import vessel_map


@cache
def vessel(*areas: tuple[float, float]) -> VesselMap:
    """A straight channel, 6 mm wide and 16 mm long."""
    mask = np.zeros((1800, 1800), np.uint8)
    mask[600:1200, 100:1700] = 255
    return vessel_map("channel", mask, suggested_areas=tuple(VesselPoint(*area) for area in areas))


CONFIG = SimConfig(start=VesselPoint(300.0, 900.0))


def make(config: SimConfig = CONFIG) -> SimulatedWorld:
    return SimulatedWorld(config, vessel(), PictureFormat())


def go(world: SimulatedWorld, dx_um: float, dy_um: float, dz_um: float, speed_um_per_s: float) -> None:
    tip = world.tip
    target = StagePoint(tip.x_um + dx_um, tip.y_um + dy_um, tip.z_um + dz_um)
    world.set_target(target, speed_um_per_s)


def test_it_begins_at_rest_under_the_tip_at_the_working_height() -> None:
    world = make()
    start = world.snapshot()
    assert start.robot == CONFIG.start
    assert world.true_calibration.held_point(world.tip).distance_px(world.robot) < 1e-9
    height_um = world.true_calibration.height_um(world.tip)
    assert height_um == pytest.approx(1.04 * world.true_calibration.critical_height_um)
    world.advance(1.0)
    assert replace(start, time_s=1.0) == world.snapshot()
    assert not world.moving


def test_the_image_and_the_travel_are_centred_on_the_vessel() -> None:
    world = make()
    true = world.true_calibration
    corner = true.image_point(VesselPoint(0.0, 0.0))
    assert (corner.x_px, corner.y_px) == pytest.approx((200.0, 0.0))
    x_um, y_um = true.stage_xy_um(VesselPoint(900.0, 900.0))
    held_um = x_um + true.magnet_offset_um[0], y_um + true.magnet_offset_um[1]
    assert held_um == pytest.approx((10_000.0, 10_000.0))


def test_the_told_offset_is_wrong_by_the_stated_error_in_a_seeded_direction() -> None:
    worlds = [SimulatedWorld(CONFIG, vessel(), PictureFormat(), seed) for seed in range(4)]
    told = {world.calibration.magnet_offset_um for world in worlds}
    true_um = make().true_calibration.magnet_offset_um
    assert len(told) == 4
    assert [math.dist(offset_um, true_um) for offset_um in told] == pytest.approx([100.0] * 4)
    exact = make(replace(CONFIG, offset_error_um=0.0))
    assert exact.calibration == exact.true_calibration


def test_the_robot_follows_the_tip() -> None:
    world = make()
    go(world, 5000.0, 0.0, 0.0, 3000.0)
    world.advance(4.0)
    behind = world.true_calibration.held_point(world.tip).x_px - world.robot.x_px
    assert 0.0 < behind * 10.0 < 600.0


def test_many_small_steps_are_one_long_step() -> None:
    worlds = make(), make()
    for world in worlds:
        go(world, 3000.0, 1500.0, 0.0, 2400.0)
    worlds[0].advance(1.0)
    for _ in range(1000):
        worlds[1].advance(0.001)
    assert worlds[0].snapshot() == worlds[1].snapshot()


def test_what_is_less_than_a_step_is_kept() -> None:
    world = make()
    for _ in range(40):
        world.advance(0.0003)
    assert world.time_s == pytest.approx(0.012)


@pytest.mark.parametrize("dt_s", [-0.001, math.nan, math.inf])
def test_time_only_advances(dt_s: float) -> None:
    with pytest.raises(ValueError, match="dt_s"):
        make().advance(dt_s)


def test_its_time_can_be_put_on_a_clock() -> None:
    world = make()
    world.set_time(1234.5)
    world.advance(0.25)
    assert world.snapshot().time_s == pytest.approx(1234.75)


def test_the_same_seed_gives_the_same_world() -> None:
    def run(seed: int) -> SimulatedWorld:
        world = SimulatedWorld(CONFIG, vessel(), PictureFormat(), seed)
        go(world, 2000.0, 4000.0, 0.0, 3000.0)
        world.advance(2.0)
        return world

    assert run(3).snapshot() == run(3).snapshot()
    assert run(3).calibration == run(3).calibration


def test_the_tip_lags_a_ramp_by_speed_times_lag() -> None:
    world = make()
    start_um = world.tip.x_um
    for tick in range(100):
        go_to = StagePoint(start_um + 30.0 * tick, world.tip.y_um, world.tip.z_um)
        world.set_target(go_to, 5000.0)
        world.advance(0.01)
    assert start_um + 30.0 * 100 - world.tip.x_um == pytest.approx(60.0, abs=20.0)


def test_a_stream_of_setpoints_gives_a_smooth_motion() -> None:
    world = make()
    start_um = world.tip.x_um
    speeds = []
    for tick in range(100):
        world.set_target(StagePoint(start_um + 30.0 * tick, world.tip.y_um, world.tip.z_um), 5000.0)
        for _ in range(10):
            before_um = world.tip.x_um
            world.advance(0.001)
            speeds.append((world.tip.x_um - before_um) / 0.001)
    assert min(speeds[300:]) > 2000.0
    assert max(speeds[300:]) < 4000.0


def test_the_tip_keeps_the_commanded_speed_and_arrives() -> None:
    world = make()
    begin = world.tip
    go(world, 300.0, 400.0, 1200.0, 1000.0)
    world.advance(1.0)
    assert math.dist(begin.array(), world.tip.array()) == pytest.approx(1000.0, abs=1.0)
    assert world.moving
    world.advance(1.0)
    assert math.dist(begin.array(), world.tip.array()) == pytest.approx(1300.0, abs=0.1)
    assert not world.moving


def test_the_newest_target_replaces_the_one_before() -> None:
    world = make()
    begin = world.tip
    go(world, 3000.0, 0.0, 0.0, 3000.0)
    world.set_target(StagePoint(begin.x_um, begin.y_um + 100.0, begin.z_um), 3000.0)
    world.advance(1.0)
    assert world.tip.array() == pytest.approx([begin.x_um, begin.y_um + 100.0, begin.z_um], abs=0.1)


def test_the_tip_stops_at_the_ends_of_its_travel() -> None:
    world = make()
    for far_um, end_um in [(1e9, [20_000.0, 0.0, 20_000.0]), (-1e9, [0.0, 20_000.0, 0.0])]:
        world.set_target(StagePoint(far_um, -far_um, far_um), 5000.0)
        world.advance(8.0)
        assert world.tip.array() == pytest.approx(end_um, abs=0.1)


def test_stop_holds_the_tip() -> None:
    world = make()
    go(world, 5000.0, 0.0, 0.0, 5000.0)
    world.advance(0.2)
    world.stop()
    stopped = world.tip
    world.advance(0.5)
    assert world.tip == stopped
    assert not world.moving


def test_lowering_the_magnet_past_the_critical_height_lifts_the_robot() -> None:
    world = make()
    true = world.true_calibration
    margin_um = true.height_um(world.tip) - true.critical_height_um
    go(world, 0.0, 0.0, -0.9 * margin_um, 1000.0)
    world.advance(3.0)
    assert not world.lifted
    go(world, 0.0, 0.0, -0.2 * margin_um, 1000.0)
    world.advance(3.0)
    assert world.snapshot().lifted
    world.place_robot(VesselPoint(300.0, 900.0))
    assert not world.lifted


def test_a_dropped_robot_stays_behind_until_it_is_placed_again() -> None:
    world = make()
    world.drop_robot()
    go(world, 5000.0, 0.0, 0.0, 3000.0)
    world.advance(3.0)
    assert world.robot == CONFIG.start
    world.place_robot(VesselPoint(800.0, 900.0))
    go(world, 4000.0, 0.0, 0.0, 3000.0)
    world.advance(3.0)
    assert world.robot.x_px > 1000.0


def test_a_bump_of_the_needle_moves_the_magnet_but_not_the_reading() -> None:
    world = make()
    tip = world.tip
    world.bump_needle(1000.0, 0.0)
    world.advance(1.0)
    assert world.tip == tip
    assert world.snapshot().magnet.x_um == tip.x_um + 1000.0
    assert world.robot.x_px > 330.0


def test_the_start_is_near_an_end_and_far_from_the_critical_areas() -> None:
    for model in (vessel(), vessel((1600.0, 900.0))):
        start = start_near_an_end(model)
        assert start.x_px < 400.0
        assert model.clearance_um(start) > 500.0
    assert start_near_an_end(vessel((200.0, 900.0))).x_px > 1400.0


def test_a_start_inside_the_wall_is_refused() -> None:
    with pytest.raises(ConfigError, match="does not fit"):
        make(SimConfig(start=VesselPoint(300.0, 620.0)))
    with pytest.raises(ConfigError, match="does not fit"):
        make().place_robot(VesselPoint(-5.0, 900.0))


def test_a_vessel_for_another_robot_is_refused() -> None:
    with pytest.raises(ConfigError, match="robot_radius_um"):
        make(SimConfig(magnets=Magnets(robot_radius_um=400.0)))


def test_a_needle_beyond_the_travel_is_refused() -> None:
    with pytest.raises(ConfigError, match="outside the manipulator"):
        make(replace(CONFIG, floor_z_um=12_000.0))


@pytest.mark.parametrize(
    ("name", "value"),
    [("friction", -0.1), ("friction", math.nan), ("camera_latency_ms", -1.0), ("drag_factor", 0.5)],
)
def test_a_setting_out_of_range_is_named(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"sim.{name}"):
        TypeAdapter(SimConfig).validate_python({name: value})


def test_settings_refuse_unknown_keys() -> None:
    read = TypeAdapter(SimConfig).validate_python(
        {"start": {"x_px": 3, "y_px": 4}, "magnets": {"tilt_deg": 5}}
    )
    assert read == SimConfig(start=VesselPoint(3, 4), magnets=Magnets(tilt_deg=5))
    with pytest.raises(ValidationError):
        TypeAdapter(SimConfig).validate_python({"magnets": {"tilt": 5}})


ANYWHERE = st.floats(-1e5, 1e5)


@given(
    st.lists(st.tuples(ANYWHERE, ANYWHERE, ANYWHERE, st.floats(-10.0, 1e6)), min_size=1, max_size=4),
    st.lists(st.tuples(*[st.floats(0.0, 20_000.0)] * 2), min_size=1, max_size=4),
)
@settings(max_examples=25, deadline=None)
def test_whatever_is_asked_the_tip_stays_in_its_travel_and_the_robot_off_the_wall(
    wild: list[tuple[float, float, float, float]], near: list[tuple[float, float]]
) -> None:
    world = make(replace(CONFIG, friction=0.05))
    height_um = world.tip.z_um
    asked = [(x, y, height_um, 5000.0) for x, y in near] + wild
    for x_um, y_um, z_um, speed_um_per_s in asked:
        world.set_target(StagePoint(x_um, y_um, z_um), speed_um_per_s)
        for _ in range(20):
            world.advance(0.02)
            assert all(0.0 <= axis_um <= 20_000.0 for axis_um in world.tip.array())
            assert vessel().clearance_um(world.robot) >= 0.0
