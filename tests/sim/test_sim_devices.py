import math
from functools import cache

import numpy as np
import pytest

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import DeviceError, DeviceTimeoutError
from mrnav_server.core.frames import StagePoint, VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.vessel import VesselMap
from mrnav_server.devices.base import Camera, Manipulator
from mrnav_server.sim.devices import SimulatedCamera, SimulatedManipulator
from mrnav_server.sim.world import SimConfig, SimulatedWorld
from mrnav_server.vision.vessel_model import vessel_map

START_S = 50.0


@cache
def vessel() -> VesselMap:
    mask = np.zeros((1200, 1200), np.uint8)
    mask[400:800, 50:1150] = 255
    return vessel_map("channel", mask)


class Bench:
    """World, clock and devices in simulated time: sleeping advances the world."""

    def __init__(self, latency_ms: float = 5.0) -> None:
        config = SimConfig(start=VesselPoint(300.0, 600.0), camera_latency_ms=latency_ms)
        self.now_s = START_S
        picture = PictureFormat()
        self.world = SimulatedWorld(config, vessel(), picture)
        self.world.set_time(self.now_s)
        self.manipulator = SimulatedManipulator(self.world)
        self.camera = SimulatedCamera(
            config, picture, self.world.snapshot, draw, lambda: self.now_s, self.sleep
        )
        self.camera.open()

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds
        self.world.advance(seconds)


def draw(robot: VesselPoint | None, tip: StagePoint) -> ByteArray:
    """Write the world into a picture, so that a test can read it again."""
    return np.array([[[robot.x_px // 8 if robot else 0, tip.x_um // 100, 255]]], np.uint8)


def away(bench: Bench) -> StagePoint:
    tip = bench.world.tip
    return StagePoint(tip.x_um + 3000.0, tip.y_um, tip.z_um)


async def test_the_manipulator_moves_and_reads() -> None:
    bench = Bench()
    manipulator: Manipulator = bench.manipulator
    await manipulator.open()
    target = away(bench)
    command = manipulator.move_to(target, 3000.0, bench.now_s)
    assert (command.sent_s, command.target, command.speed_um_per_s) == (START_S, target, 3000.0)
    bench.sleep(0.1)
    reading = manipulator.tip()
    assert reading.moving
    assert reading.taken_s == pytest.approx(bench.now_s, abs=0.0011)
    assert reading.position == bench.world.tip
    manipulator.stop()
    bench.sleep(0.1)
    assert not manipulator.tip().moving
    await manipulator.close()
    await manipulator.close()


async def test_it_reports_what_was_really_sent() -> None:
    bench = Bench()
    await bench.manipulator.open()
    command = bench.manipulator.move_to(StagePoint(-5.0, 30_000.0, 7.0), 0.0, 1.0)
    assert command.target == StagePoint(0.0, 20_000.0, 7.0)
    assert command.speed_um_per_s == 1.0
    assert bench.manipulator.move_to(away(bench), 1e9, 1.0).speed_um_per_s == 5000.0


@pytest.mark.parametrize("bad", [math.nan, math.inf])
async def test_what_is_not_finite_moves_nothing(bad: float) -> None:
    bench = Bench()
    await bench.manipulator.open()
    for target, speed in [(StagePoint(1.0, bad, 1.0), 10.0), (away(bench), bad)]:
        with pytest.raises(DeviceError, match="not finite"):
            bench.manipulator.move_to(target, speed, 1.0)
    assert not bench.world.moving


async def test_an_unopened_manipulator_refuses() -> None:
    bench = Bench()
    with pytest.raises(DeviceError, match="not open"):
        bench.manipulator.tip()
    with pytest.raises(DeviceError, match="not open"):
        bench.manipulator.move_to(away(bench), 10.0, 1.0)


async def test_closing_stops_it() -> None:
    bench = Bench()
    await bench.manipulator.open()
    bench.manipulator.move_to(away(bench), 3000.0, 1.0)
    bench.sleep(0.1)
    await bench.manipulator.close()
    assert not bench.world.moving


async def test_a_failed_manipulator_raises_but_still_stops() -> None:
    bench = Bench()
    await bench.manipulator.open()
    bench.manipulator.move_to(away(bench), 3000.0, 1.0)
    bench.sleep(0.1)
    bench.manipulator.fail()
    with pytest.raises(DeviceError, match="failed"):
        bench.manipulator.tip()
    with pytest.raises(DeviceError, match="failed"):
        bench.manipulator.move_to(away(bench), 10.0, 1.0)
    with pytest.raises(DeviceError, match="failed"):
        await bench.manipulator.open()
    assert bench.world.moving
    bench.manipulator.stop()
    stopped = bench.world.tip
    bench.sleep(0.1)
    bench.manipulator.recover()
    reading = bench.manipulator.tip()
    assert (reading.position, reading.moving) == (stopped, False)


async def test_a_mute_line_ages_and_loses_commands() -> None:
    bench = Bench()
    await bench.manipulator.open()
    bench.manipulator.mute()
    last = bench.manipulator.tip()
    bench.manipulator.move_to(away(bench), 3000.0, bench.now_s)
    bench.sleep(0.2)
    assert bench.manipulator.tip() == last
    assert bench.world.tip == last.position
    bench.manipulator.recover()
    bench.manipulator.move_to(away(bench), 3000.0, bench.now_s)
    bench.sleep(0.2)
    bench.manipulator.mute()
    bench.manipulator.stop()
    assert bench.world.moving, "a stop does not reach it either"


def test_frames_come_on_an_absolute_schedule() -> None:
    bench = Bench()
    camera: Camera = bench.camera
    for number in range(60):
        frame = camera.read(1.0)
        assert frame.number == number
        assert frame.taken_s == pytest.approx(START_S + number / 30, abs=0.0011)
        assert bench.now_s == pytest.approx(START_S + number / 30 + 0.005)


def test_a_frame_shows_the_world_at_capture() -> None:
    bench = Bench(latency_ms=100.0)
    bench.world.set_target(away(bench), 5000.0)
    bench.camera.read(1.0)
    frame = bench.camera.read(1.0)
    shown_um = float(frame.image[0, 0, 1]) * 100.0
    assert bench.world.tip.x_um - shown_um > 400.0


def test_slots_that_were_missed_are_gaps() -> None:
    bench = Bench()
    assert bench.camera.read(1.0).number == 0
    bench.sleep(0.1)
    frame = bench.camera.read(1.0)
    assert frame.number == 3
    assert frame.taken_s == pytest.approx(bench.now_s - 0.005, abs=0.0011)
    assert bench.camera.read(1.0).number == 4


def test_a_frame_that_comes_too_late_is_a_timeout() -> None:
    bench = Bench()
    bench.camera.slow_down(0.5)
    with pytest.raises(DeviceTimeoutError, match=r"within 0\.2 s"):
        bench.camera.read(0.2)
    assert bench.now_s == pytest.approx(START_S + 0.2)
    bench.camera.recover()
    assert bench.camera.read(0.2).number > 0


def test_a_slow_camera_drops_frames() -> None:
    bench = Bench()
    bench.camera.slow_down(0.05)
    numbers = [bench.camera.read(1.0).number for _ in range(10)]
    assert numbers[-1] > 12
    assert len(set(numbers)) == 10


def test_a_frozen_camera_repeats_its_picture_with_new_times() -> None:
    bench = Bench()
    bench.camera.freeze()
    bench.world.set_target(away(bench), 5000.0)
    frames = [bench.camera.read(1.0) for _ in range(10)]
    assert all(np.array_equal(frame.image, frames[0].image) for frame in frames)
    assert frames[9].taken_s > frames[0].taken_s
    bench.camera.recover()
    assert not np.array_equal(bench.camera.read(1.0).image, frames[0].image)


def test_a_black_camera_sees_nothing() -> None:
    bench = Bench()
    bench.camera.black_out()
    assert not bench.camera.read(1.0).image.any()
    bench.camera.recover()
    assert bench.camera.read(1.0).image.any()


def test_an_unplugged_camera_raises_until_it_is_plugged_in() -> None:
    bench = Bench()
    bench.camera.unplug()
    with pytest.raises(DeviceError, match="unplugged"):
        bench.camera.read(1.0)
    bench.camera.close()
    with pytest.raises(DeviceError, match="unplugged"):
        bench.camera.open()
    bench.camera.recover()
    with pytest.raises(DeviceError, match="not open"):
        bench.camera.read(1.0)
    bench.camera.open()
    assert bench.camera.read(1.0).number == 0


def test_the_picture_shows_a_bumped_needle() -> None:
    bench = Bench()
    before = bench.camera.read(1.0).image
    bench.world.bump_needle(500.0, 0.0)
    assert bench.camera.read(1.0).image[0, 0, 1] == before[0, 0, 1] + 5


def test_a_robot_that_jumped_to_the_magnet_is_gone_from_the_floor() -> None:
    bench = Bench()
    assert bench.camera.read(1.0).image[0, 0, 0] == 300 // 8
    tip = bench.world.tip
    bench.world.set_target(StagePoint(tip.x_um, tip.y_um, tip.z_um - 1000.0), 5000.0)
    bench.sleep(1.0)
    assert bench.camera.read(1.0).image[0, 0, 0] == 0
