"""A vessel that lies elsewhere than the server is told: physics and picture follow the truth."""

from functools import cache

import numpy as np
import pytest

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import StagePoint, VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.vessel import VesselMap
from mrnav_server.sim.magnetics import Magnets
from mrnav_server.sim.microscope import Microscope, MicroscopeConfig
from mrnav_server.sim.optics import OpticsConfig
from mrnav_server.sim.world import SimConfig, SimulatedWorld
from mrnav_server.vision.vessel_model import vessel_map

PICTURE = PictureFormat()
MIDDLE = VesselPoint(900.0, 900.0)


@cache
def dish() -> VesselMap:
    """A wide dish, so that no wall is in the way."""
    mask = np.zeros((1800, 1800), np.uint8)
    mask[200:1600, 200:1600] = 255
    return vessel_map("dish", mask)


def world(
    shift_um: tuple[float, float] = (0.0, 0.0), turn_deg: float = 0.0, optics: OpticsConfig | None = None
) -> SimulatedWorld:
    config = SimConfig(
        start=MIDDLE, vessel_shift_um=shift_um, vessel_turn_deg=turn_deg, optics=optics or OpticsConfig()
    )
    return SimulatedWorld(config, dish(), PICTURE)


def driven_um(rig: SimulatedWorld) -> FloatArray:
    """Return the robot's way on the stage while the tip goes a crooked way, relative to its start."""
    places = [rig.true_calibration.stage_xy_um(rig.robot)]
    for dx_um, dy_um in ((1500.0, 400.0), (-600.0, 1200.0), (200.0, -900.0)):
        tip = rig.tip
        rig.set_target(StagePoint(tip.x_um + dx_um, tip.y_um + dy_um, tip.z_um), 2000.0)
        for _ in range(10):
            rig.advance(0.1)
            places.append(rig.true_calibration.stage_xy_um(rig.robot))
    return np.array(places) - places[0]


@pytest.mark.parametrize(
    ("shift_um", "turn_deg"), [((1200.0, -700.0), 0.0), ((0.0, 0.0), 20.0), ((-500.0, 900.0), -7.0)]
)
def test_on_the_stage_the_robot_goes_as_if_the_vessel_lay_where_it_belongs(
    shift_um: tuple[float, float], turn_deg: float
) -> None:
    assert driven_um(world(shift_um, turn_deg)) == pytest.approx(driven_um(world()), abs=1e-3)


def test_the_server_is_told_that_the_vessel_lies_where_it_belongs() -> None:
    displaced, plain = world((1200.0, -700.0), 5.0), world()
    assert displaced.calibration == plain.calibration
    x_um, y_um = plain.true_calibration.stage_xy_um(MIDDLE)
    assert displaced.true_calibration.stage_xy_um(MIDDLE) == pytest.approx((x_um + 1200.0, y_um - 700.0))


@pytest.mark.parametrize("optics", [None, OpticsConfig(radial=-0.02, tilt_deg=4.0, water_depth_um=3000.0)])
def test_the_picture_shows_walls_and_robot_where_they_are(optics: OpticsConfig | None) -> None:
    rig = world((1200.0, -700.0), 5.0, optics)
    true = rig.true_calibration
    microscope = Microscope(MicroscopeConfig(noise=0.0), PICTURE, Magnets(), dish(), true, 0, rig.optics)
    away = StagePoint(30_000.0, -30_000.0, rig.tip.z_um)
    bare, seen = (microscope.render(robot, away).astype(float) for robot in (None, MIDDLE))
    # The robot covers its place, and nothing two radii from it.
    at = true.image_point(MIDDLE)
    rows, columns = np.nonzero(np.abs(seen - bare).max(axis=2) > 60.0)
    assert (columns.mean(), rows.mean()) == pytest.approx((at.x_px, at.y_px), abs=2.0)
    # Across the upper wall the picture goes from tissue to lumen.
    tissue, lumen = (true.image_point(VesselPoint(900.0, y_px)) for y_px in (170.0, 260.0))
    levels = [bare[round(point.y_px), round(point.x_px)].mean() for point in (tissue, lumen)]
    assert levels[1] > levels[0] + 15.0


@pytest.mark.parametrize(
    ("field", "value"),
    [("vessel_shift_um", (6000.0, 0.0)), ("vessel_turn_deg", 40.0), ("vessel_turn_deg", float("nan"))],
)
def test_a_vessel_too_far_off_is_refused(field: str, value: object) -> None:
    with pytest.raises(ConfigError, match=field):
        SimConfig(**{field: value})  # type: ignore[arg-type]
