"""Another vessel is put in the present one's place while the world goes on."""

import numpy as np
import pytest

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.vessel import VesselMap
from mrnav_server.sim.world import SimConfig, SimulatedWorld
from mrnav_server.vision.vessel_model import vessel_map

MIDDLE = VesselPoint(900.0, 900.0)


def square(low_px: int, high_px: int) -> VesselMap:
    mask = np.zeros((1800, 1800), np.uint8)
    mask[low_px:high_px, low_px:high_px] = 255
    return vessel_map("square", mask)


@pytest.fixture
def world() -> SimulatedWorld:
    return SimulatedWorld(SimConfig(start=VesselPoint(600.0, 600.0)), square(300, 1500), PictureFormat())


def test_the_tip_and_the_time_go_on_and_the_robot_rests_released(world: SimulatedWorld) -> None:
    world.advance(0.5)
    tip, time_s = world.tip, world.time_s
    world.lay(square(500, 1300), MIDDLE)
    assert (world.tip, world.time_s) == (tip, time_s)
    before = world.robot
    world.advance(0.5)
    assert world.robot == before


def test_the_new_walls_hold_from_then_on(world: SimulatedWorld) -> None:
    world.lay(square(500, 1300), MIDDLE)
    with pytest.raises(ConfigError):
        world.place_robot(VesselPoint(520.0, 900.0))
    world.place_robot(MIDDLE)
    assert world.robot == MIDDLE


def test_a_robot_that_does_not_fit_leaves_everything_as_it_was(world: SimulatedWorld) -> None:
    before = world.snapshot()
    with pytest.raises(ConfigError):
        world.lay(square(500, 1300), VesselPoint(100.0, 100.0))
    assert world.snapshot() == before
    world.place_robot(VesselPoint(400.0, 400.0))
