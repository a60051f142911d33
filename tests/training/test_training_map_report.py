"""Centre lines of shapes whose length and junctions are known."""

import numpy as np
import pytest

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.map_import import report_notes
from mrnav_server.training.map_preview import draw_preview
from mrnav_server.training.map_report import map_report
from mrnav_server.training.vessels import draw
from mrnav_server.vision.vessel_model import vessel_map

SIZE_PX = 1000


def tubes(*lines: tuple[float, float, float, float], width_px: float = 160) -> ByteArray:
    """Draw straight tubes with flat ends, each (x, y) to (x, y)."""
    y, x = np.mgrid[:SIZE_PX, :SIZE_PX]
    mask = np.zeros((SIZE_PX, SIZE_PX), np.uint8)
    for x0, y0, x1, y1 in lines:
        length = np.hypot(x1 - x0, y1 - y0)
        along = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length
        aside = ((y - y0) * (x1 - x0) - (x - x0) * (y1 - y0)) / length
        mask[(np.abs(aside) < width_px / 2) & (along >= 0) & (along < length)] = 255
    return mask


def vessel(mask: ByteArray) -> VesselMap:
    return vessel_map("shape", mask)


@pytest.mark.parametrize("turn_deg", [0, 17, 45, 90])
def test_a_straight_channel(turn_deg: float) -> None:
    turn = np.radians(turn_deg)
    x, y = 350 * np.cos(turn), 350 * np.sin(turn)
    report = map_report(vessel(tubes((500 - x, 500 - y, 500 + x, 500 + y), width_px=200)))
    assert report.length_um == pytest.approx(7000, rel=0.01)
    assert report.widths_um == pytest.approx((2000, 2000, 2000), abs=40)
    assert (report.junctions, report.line.ends, report.tight) == (0, 2, ())
    assert report.free_fraction == pytest.approx(0.06, rel=0.03)


def test_a_y_has_one_junction() -> None:
    arms = [(500.0, 500.0, 500 + 400 * np.cos(a), 500 + 400 * np.sin(a)) for a in np.radians([90, 210, 330])]
    report = map_report(vessel(tubes(*arms)))
    assert (report.junctions, len(report.line.branches), report.line.ends) == (1, 3, 3)
    assert report.line.junctions_px[0] == pytest.approx((500, 500), abs=20)
    assert report.length_um == pytest.approx(12_000, rel=0.02)


def test_a_crossing_is_one_junction() -> None:
    report = map_report(vessel(tubes((0, 480, 1000, 520), (480, 1000, 520, 0))))
    assert (report.junctions, report.line.ends) == (1, 4)


def test_a_ring_has_none() -> None:
    y, x = np.mgrid[:SIZE_PX, :SIZE_PX]
    ring = np.abs(np.hypot(x - 500, y - 500) - 300) < 80
    report = map_report(vessel(ring.astype(np.uint8)))
    assert (report.junctions, len(report.line.branches), report.line.ends) == (0, 1, 0)
    assert report.length_um == pytest.approx(2 * np.pi * 3000, rel=0.02)


def test_a_disc_and_a_square_have_no_junction() -> None:
    y, x = np.mgrid[:SIZE_PX, :SIZE_PX]
    assert map_report(vessel((np.hypot(x - 500, y - 500) < 300).astype(np.uint8))).junctions == 0
    assert map_report(vessel(tubes((100, 500, 900, 500), width_px=800))).junctions == 0


def test_bumps_and_specks_are_no_branches() -> None:
    mask = tubes((0, 500, 1000, 500), width_px=200)
    mask[370:420, 300:340] = 255
    mask[480:484, 600:604] = 0
    report = map_report(vessel(mask))
    assert (report.junctions, report.line.ends) == (0, 2)


def test_the_drawn_network() -> None:
    report = map_report(vessel(draw("network")))
    assert (report.junctions, report.line.ends, len(report.line.branches)) == (6, 6, 12)
    assert report.tight == ()


def test_a_tight_place_and_what_lies_behind_it() -> None:
    mask = tubes((0, 500, 1000, 500), width_px=200)
    mask[:455, 600:680], mask[545:, 600:680] = 0, 0
    report = map_report(vessel(mask))
    (place,) = report.tight
    assert place.width_um == pytest.approx(900, abs=30)
    assert 600 <= place.x_px <= 680
    # Its corners are nearer than the robot's radius from 22 px before it, and than radius and play until 31
    # px behind it, where the robot does not get.
    assert place.length_um == pytest.approx(1330, abs=50)
    # It reaches the way before the place, but for its own radius at either end.
    assert report.reached_um == pytest.approx(5000, abs=300)
    assert "reaches 5" in report_notes(report)[0]


def test_a_passage_without_play_is_none() -> None:
    wide, narrow = tubes((0, 300, 1000, 300), width_px=200), tubes((0, 700, 1000, 700), width_px=150)
    bridge = tubes((500, 300, 500, 700), width_px=104)
    free = vessel_map("two", wide | narrow | bridge).free
    assert free[300, 500]
    assert not free[600:].any()
    roomy = tubes((500, 300, 500, 700), width_px=124)
    assert vessel_map("two", wide | narrow | roomy).free[700, 500]


def test_the_preview_shows_lumen_and_wall() -> None:
    report = map_report(vessel(tubes((0, 500, 1000, 500), width_px=200)))
    picture = draw_preview(report)
    assert picture.shape == (1040, 1000, 3)
    assert len(np.unique(picture[:1000].reshape(-1, 3), axis=0)) > 3
    assert (picture[100, 500] != picture[435, 500]).any()
