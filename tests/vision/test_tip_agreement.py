"""A tip that is not where the calibration puts it is told after several looks, and not for less."""

from dataclasses import replace

import numpy as np
import pytest

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import StagePoint, VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.sim.magnetics import Magnets
from mrnav_server.sim.microscope import Microscope, MicroscopeConfig
from mrnav_server.vision.tip import TipLook
from mrnav_server.vision.tip_agreement import TipAgreement, TipWatchConfig
from mrnav_server.vision.vessel_model import vessel_map
from tests.vision.rendered_bench import Bench

ROBOT = VesselPoint(700.0, 900.0)
RADIUS_PX = 500.0 / 15.0
LEARNED = [(3e3, 3e3), (17e3, 3e3), (3e3, 17e3), (17e3, 17e3), (10e3, 10e3), (3e3, 10e3), (17e3, 10e3)]
LOOKS = [
    (9e3, 7e3),
    (12e3, 8e3),
    (8e3, 12e3),
    (11e3, 11e3),
    (13e3, 12e3),
    (10e3, 8e3),
    (7e3, 9e3),
    (12e3, 6e3),
]


class Watched:
    """A microscope over a plain channel, and an agreement that has seen the tip at several places."""

    def __init__(self) -> None:
        bench = Bench(15.0)
        self.calibration = bench.calibration
        mask = np.zeros((1800, 1800), np.uint8)
        mask[760:1040, 200:1600] = 255
        self.microscope = Microscope(
            MicroscopeConfig(),
            PictureFormat(),
            Magnets(),
            vessel_map("channel", mask),
            self.calibration,
            seed=3,
        )
        self.agreement = TipAgreement(TipWatchConfig(), TipLook(), self.calibration)
        for x_um, y_um in LEARNED:
            self.look(x_um, y_um, resting=False)

    def look(self, x_um: float, y_um: float, bump_um: float = 0.0, *, resting: bool = True) -> str:
        told = StagePoint(x_um, y_um, Bench.HEIGHT_UM)
        image = self.microscope.render(ROBOT, replace(told, x_um=x_um + bump_um))
        robot = self.calibration.image_point(ROBOT)
        return self.agreement.look(image, told, robot, RADIUS_PX, resting=resting).warning


@pytest.fixture(scope="module")
def watched() -> Watched:
    return Watched()


@pytest.fixture
def looks(watched: Watched) -> Watched:
    watched.agreement._looks.clear()
    watched.agreement._warning = ""
    return watched


def test_a_tip_in_its_place_is_seen_and_nothing_is_told(looks: Watched) -> None:
    off_um = []
    for x_um, y_um in LOOKS:
        assert looks.look(x_um, y_um) == ""
        if looks.agreement.seen.off_um is not None:
            assert looks.agreement.seen.image is not None
            off_um.append(looks.agreement.seen.off_um)
    assert len(off_um) >= 5
    assert max(off_um) < 120.0


def test_a_bumped_needle_is_told_after_several_looks_and_no_longer_once_mended(looks: Watched) -> None:
    warnings = [looks.look(x_um, y_um, 250.0) for x_um, y_um in LOOKS]
    assert warnings[:4] == [""] * 4
    assert "the needle was bumped" in warnings[-1]
    assert [looks.look(x_um, y_um) for x_um, y_um in LOOKS][-1] == ""


def test_many_looks_at_one_place_are_one(looks: Watched) -> None:
    assert [looks.look(9e3, 7e3, 250.0) for _ in range(8)] == [""] * 8


def test_a_moving_tip_is_not_judged(looks: Watched) -> None:
    assert not any(looks.look(x_um, y_um, 250.0, resting=False) for x_um, y_um in LOOKS)
    assert looks.agreement.seen.image is None


def test_a_bound_out_of_range_names_the_field() -> None:
    with pytest.raises(ConfigError, match=r"tip_watch\.warn_um"):
        TipWatchConfig(warn_um=1.0)
