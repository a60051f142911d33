"""The simulated bench follows the settings: one picture for camera, calibration and twin, and one needle."""

from dataclasses import replace

import numpy as np
import pytest

from mrnav_server.app.bench import Bench, build_bench
from mrnav_server.app.rig import Rig
from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.frames import VesselPoint
from mrnav_server.settings import CameraConfig, Settings
from mrnav_server.sim.microscope import MicroscopeConfig
from mrnav_server.sim.world import SimConfig

SETTINGS = Settings(
    camera=CameraConfig(width_px=400, height_px=300, fps=20.0),
    sim=SimConfig(camera_latency_ms=0.0, image_um_per_px=60.0),
    microscope=MicroscopeConfig(noise=0.0),
)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig(SETTINGS.with_tokens())


def test_the_camera_delivers_the_pictures_that_the_twin_announces(rig: Rig) -> None:
    now_s = 5.0
    camera = build_bench(SETTINGS, rig.vessel, lambda: now_s).camera
    camera.open()
    announced = rig.snapshot("s1", "viewer")["camera"]
    assert announced == {"width_px": 400, "height_px": 300, "fps": 20.0, "format": ""}
    assert camera.read(1.0).image.shape == (announced["height_px"], announced["width_px"], 3)
    now_s += 3.0 / announced["fps"]
    assert camera.read(1.0).number == 3


def test_the_vessel_and_the_optical_axis_lie_in_the_middle_of_the_picture(rig: Rig) -> None:
    middle_px = rig.vessel.size_px / 2.0
    seen = rig.calibration.image_point(VesselPoint(middle_px, middle_px))
    assert (seen.x_px, seen.y_px) == pytest.approx((200.0, 150.0))
    assert rig.calibration.image_center_px == (199.5, 149.5)


def test_the_needle_is_drawn_as_the_magnets_lie(rig: Rig) -> None:
    def picture(azimuth_deg: float) -> tuple[Bench, FloatArray]:
        magnets = replace(SETTINGS.sim.magnets, azimuth_deg=azimuth_deg)
        sim = replace(SETTINGS.sim, magnets=magnets)
        bench = build_bench(SETTINGS.model_copy(update={"sim": sim}), rig.vessel, lambda: 0.0)
        bench.camera.open()
        return bench, bench.camera.read(1.0).image.mean(axis=2)

    bench, rightwards = picture(0.0)
    _, leftwards = picture(180.0)
    assert bench.world is not None
    tip = bench.calibration.tip_in_image(bench.world.tip)
    row, columns = round(tip.y_px), np.arange(400) - tip.x_px
    darker = leftwards[row] - rightwards[row]
    # Over the vessel: farther out the needle passes walls, some of them darker than its steel.
    assert darker[(columns > 60.0) & (columns < 100.0)].mean() > 10.0
    assert darker[(columns > -100.0) & (columns < -60.0)].mean() < -10.0
