"""The magnet in the live picture, against the simulator's truth."""

from dataclasses import replace

import numpy as np
import pytest

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import ImagePoint, StagePoint, VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.sim.magnetics import Magnets
from mrnav_server.sim.microscope import Microscope, MicroscopeConfig
from mrnav_server.vision.tip import TipFinder, TipLook
from mrnav_server.vision.vessel_model import vessel_map
from tests.vision.rendered_bench import Bench

ROBOT = VesselPoint(700.0, 900.0)
RADIUS_PX = 500.0 / 15.0
PLACES = [(3e3, 3e3), (17e3, 3e3), (3e3, 17e3), (17e3, 17e3), (10e3, 10e3), (3e3, 10e3), (17e3, 10e3)]


class Stand:
    """A microscope with a needle, and a finder that has seen the tip at several places."""

    def __init__(self, tilt_deg: float) -> None:
        bench = Bench(15.0)
        self.calibration = bench.calibration
        magnets = replace(Magnets(), tilt_deg=tilt_deg)
        mask = np.zeros((1800, 1800), np.uint8)
        mask[760:1040, 200:1600] = 255
        vessel = vessel_map("channel", mask)
        self.microscope = Microscope(
            MicroscopeConfig(), PictureFormat(), magnets, vessel, self.calibration, seed=3
        )
        self.finder = TipFinder(TipLook(tilt_deg=tilt_deg, azimuth_deg=magnets.azimuth_deg), self.calibration)
        self.rng = np.random.default_rng(8)
        for x_um, y_um in PLACES:
            tip = StagePoint(x_um, y_um, Bench.HEIGHT_UM)
            self.finder.learn(self.microscope.render(ROBOT, tip), tip)

    def somewhere(self) -> StagePoint:
        x_um, y_um = self.rng.uniform(6e3, 14e3, 2)
        return StagePoint(float(x_um), float(y_um), Bench.HEIGHT_UM + float(self.rng.uniform(-300.0, 1500.0)))

    def errors(self, shift_um: float = 0.0) -> list[tuple[float, float, float]]:
        """Return error in µm, error in sigma and how far off the tip seemed, of what was found."""
        found = []
        robot = self.calibration.image_point(ROBOT)
        for _ in range(30):
            told = self.somewhere()
            true = replace(told, x_um=told.x_um + shift_um)
            seen = self.finder.find(self.microscope.render(ROBOT, true), told, robot, RADIUS_PX)
            if seen is None:
                continue
            place = self.calibration.tip_in_image(true)
            off_px = float(np.hypot(seen.image.x_px - place.x_px, seen.image.y_px - place.y_px))
            found.append((off_px * seen.um_per_px, off_px / seen.sigma_px, seen.off_um))
        return found


@pytest.fixture(scope="module")
def oblique() -> Stand:
    return Stand(45.0)


@pytest.fixture(scope="module")
def upright() -> Stand:
    return Stand(0.0)


def test_an_oblique_magnet_is_located_to_a_few_hundredths_of_a_millimetre(oblique: Stand) -> None:
    found = oblique.errors()
    assert len(found) >= 20
    errors_um = np.array([error for error, _, _ in found])
    assert np.sqrt(np.mean(errors_um**2)) < 80.0
    assert max(sigma for _, sigma, _ in found) < 4.0


def test_a_tip_that_is_not_where_the_manipulator_says_is_told(oblique: Stand) -> None:
    off_um = [off for _, _, off in oblique.errors(400.0)]
    assert len(off_um) >= 15
    assert np.median(off_um) == pytest.approx(400.0, abs=60.0)


def test_an_upright_magnet_is_located_or_refused(upright: Stand) -> None:
    found = upright.errors()
    assert len(found) >= 3
    assert max(error for error, _, _ in found) < 200.0


def test_a_tip_that_is_not_there_is_not_found(oblique: Stand) -> None:
    for _ in range(10):
        told = oblique.somewhere()
        assert oblique.finder.find(oblique.microscope.render(ROBOT, Bench.AWAY), told) is None


def test_a_tip_at_the_picture_s_edge_is_none(oblique: Stand) -> None:
    tip = StagePoint(-2_000.0, 10_000.0, Bench.HEIGHT_UM)
    assert oblique.finder.find(oblique.microscope.render(ROBOT, tip), tip) is None


def test_nothing_is_found_before_the_floor_was_seen() -> None:
    bench = Bench(15.0)
    finder = TipFinder(TipLook(), bench.calibration)
    tip = StagePoint(9_000.0, 9_000.0, Bench.HEIGHT_UM)
    picture = bench.microscope.render(ROBOT, tip)
    for _ in range(10):
        finder.learn(picture, tip)
    assert not finder.is_ready
    assert finder.find(picture, tip, ImagePoint(1.0, 1.0), 3.0) is None


def test_a_look_out_of_range_names_the_field() -> None:
    with pytest.raises(ConfigError, match="tilt_deg"):
        TipLook(tilt_deg=90.0)
