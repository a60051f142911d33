"""The tip by its outline on a plain background: near the truth, steady, never invented."""

from functools import cache

import numpy as np
import pytest

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.sim.magnetics import Magnets
from mrnav_server.sim.microscope import Microscope, MicroscopeConfig
from mrnav_server.sim.world import SimConfig, true_calibration
from mrnav_server.vision.tip_silhouette import locate_tip, plain_background
from mrnav_server.vision.vessel_model import vessel_map

PICTURE = PictureFormat()
PLAIN = np.full((1200, 1600), 196, np.uint8)


@cache
def look(azimuth_deg: float) -> tuple[Microscope, SimConfig]:
    sim = SimConfig(magnets=Magnets(azimuth_deg=azimuth_deg))
    vessel = vessel_map("open", np.full((1800, 1800), 255, np.uint8))
    truth = true_calibration(sim, vessel, PICTURE)
    microscope = Microscope(MicroscopeConfig(noise=2.0), PICTURE, sim.magnets, vessel, truth, 1)
    microscope.lay(np.full((1200, 1600, 3), 196, np.uint8))
    return microscope, sim


def gray(azimuth_deg: float, tip: StagePoint) -> ByteArray:
    microscope, _ = look(azimuth_deg)
    return np.asarray(
        np.mean([microscope.render(None, tip).mean(axis=2) for _ in range(3)], axis=0), np.uint8
    )


@pytest.mark.parametrize("azimuth_deg", [-15.0, 75.0, 100.0, 170.0, -95.0])
def test_the_centre_is_found_and_its_bias_is_steady(azimuth_deg: float) -> None:
    _, sim = look(azimuth_deg)
    vessel = vessel_map("open", np.full((1800, 1800), 255, np.uint8))
    truth = true_calibration(sim, vessel, PICTURE)
    off = []
    for x_um, y_um, z_um in (
        (8000, 9000, 12_500),
        (11_500, 11_000, 12_500),
        (10_000, 8000, 13_500),
        (9000, 11_500, 11_500),
    ):
        tip = StagePoint(x_um, y_um, z_um)
        found = locate_tip(gray(azimuth_deg, tip), PLAIN)
        assert found is not None
        true = truth.tip_in_image(tip)
        off.append((found.x_px - true.x_px, found.y_px - true.y_px))
    misses_um = 15.0 * np.array(off)
    assert np.linalg.norm(misses_um, axis=1).max() < 35.0
    assert np.linalg.norm(misses_um - misses_um.mean(axis=0), axis=1).max() < 12.0


def test_nothing_is_found_where_nothing_is() -> None:
    noisy = (PLAIN + np.random.default_rng(0).normal(0.0, 3.0, PLAIN.shape)).astype(np.uint8)
    assert locate_tip(noisy, PLAIN) is None
    assert locate_tip(PLAIN, PLAIN) is None


def test_a_magnet_that_is_cut_off_is_not_found() -> None:
    for x_um in (-2000.0, 20_000.0):
        assert locate_tip(gray(-15.0, StagePoint(x_um, 10_000.0, 16_000.0)), PLAIN) is None


def test_the_background_is_what_lies_behind_the_tips() -> None:
    places = [StagePoint(x, y, 13_000.0) for x in (7000.0, 12_000.0) for y in (7000.0, 10_000.0, 13_000.0)]
    behind = plain_background([gray(-15.0, place) for place in places])
    assert np.abs(behind.astype(int) - 196).max() < 12
