"""What lies under the simulated microscope while a running server is calibrated."""

from functools import cache

import numpy as np

from mrnav_server.app.calibration_scene import SimulatedScene
from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.vessel import VesselMap
from mrnav_server.settings import CameraConfig, Settings
from mrnav_server.sim.world import SimConfig, SimulatedWorld
from mrnav_server.vision.charuco import SheetConfig
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model

SETTINGS = Settings(camera=CameraConfig(width_px=400, height_px=300), sim=SimConfig(image_um_per_px=60.0))
SHEET = SheetConfig()
AWAY = StagePoint(60_000.0, -60_000.0, 12_000.0)


@cache
def vessel() -> VesselMap:
    return load_vessel_model(find_model(SETTINGS.rig.vessel))


class Bench:
    def __init__(self) -> None:
        self.world = SimulatedWorld(SETTINGS.sim, vessel(), SETTINGS.camera)
        self.world.set_time(0.0)
        self.scene = SimulatedScene(SETTINGS, vessel(), self.world)

    def seen(self, tip: StagePoint = AWAY) -> ByteArray:
        return self.scene.render(self.world.robot, tip)


def even(picture: ByteArray) -> bool:
    """Whether nothing but noise is seen."""
    return float(picture.std()) < 5.0


async def test_sheet_plate_and_robot_are_laid_as_asked_and_the_vessel_is_put_back() -> None:
    bench = Bench()
    before, start = bench.seen(), bench.world.robot
    assert start is not None
    await bench.scene.lay("sheet", SHEET)
    sheet = bench.seen()
    assert sheet.std() > 30.0
    # The needle is out of the way of the sheet wherever the tip is.
    assert abs(bench.seen(bench.world.tip).astype(float) - sheet).mean() < 5.0
    await bench.scene.lay("plate", SHEET)
    assert even(bench.seen())
    assert not even(bench.seen(bench.world.tip))
    await bench.scene.lay("robot", SHEET)
    dark = np.argwhere(bench.seen().mean(axis=2) < 120.0)
    assert np.allclose(dark.mean(axis=0), (150.0, 200.0), atol=2.0)
    bench.scene.put_back()
    assert bench.world.robot == start
    assert abs(bench.seen().astype(float) - before).mean() < 5.0


async def test_putting_back_what_was_never_taken_away_changes_nothing() -> None:
    bench = Bench()
    start = bench.world.robot
    bench.scene.put_back()
    assert bench.world.robot == start
