"""A calibration with the camera's full maps: affine is the same, and a vessel can be moved."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.core.camera_map import FloorMap, TipMap
from mrnav_server.core.frames import Affine2, Calibration, ImagePoint, StagePoint, VesselPoint
from mrnav_server.core.wire_twin import calibration_fields

PLAIN = Calibration(
    image_from_vessel=Affine2.scale(10 / 15, 200.0, 0.0),
    stage_from_vessel=Affine2.scale(10.0, 1000.0, 2000.0),
    um_per_px=10.0,
    floor_z_um=2000.0,
    magnet_offset_um=(0.0, 0.0),
    critical_height_um=11_000.0,
)
BENT = FloorMap((0.67, -0.002, 198.0, 0.003, 0.66, 1.0, 4e-6, 3e-6, 1.0), (799.5, 599.5), -0.02, 1000.0)
TIP = TipMap((0.095, 0.001, -0.003, 0.0, 0.096, 0.004), (-90.0, -170.0), 72_000.0)
FULL = replace(PLAIN, floor=BENT, tip=TIP)
grid = st.builds(VesselPoint, st.floats(0, 1800), st.floats(0, 1800))


@given(point=grid)
def test_an_affine_full_map_changes_nothing(point: VesselPoint) -> None:
    same = replace(PLAIN, floor=FloorMap.affine(np.array(PLAIN.image_from_vessel.rows())))
    plain, full = PLAIN.image_point(point), same.image_point(point)
    assert (full.x_px, full.y_px) == pytest.approx((plain.x_px, plain.y_px))
    assert same.image_scale(point) == pytest.approx(PLAIN.image_scale(point)) == pytest.approx(10 / 15)
    back = same.vessel_point(plain)
    assert (back.x_px, back.y_px) == pytest.approx((point.x_px, point.y_px))


@given(point=grid)
def test_the_full_map_is_what_points_go_through(point: VesselPoint) -> None:
    seen = FULL.image_point(point)
    assert (seen.x_px, seen.y_px) == pytest.approx(tuple(BENT.image(np.array([point.x_px, point.y_px]))))
    back = FULL.vessel_point(seen)
    assert (back.x_px, back.y_px) == pytest.approx((point.x_px, point.y_px), abs=1e-6)


def test_the_tip_is_seen_where_it_hides_the_floor() -> None:
    tip = StagePoint(9000.0, 8000.0, 13_000.0)
    hidden = VesselPoint(*TIP.floor(tip.array()).tolist())
    assert FULL.tip_in_image(tip) == FULL.image_point(hidden)


@given(point=grid, angle=st.floats(-0.3, 0.3))
def test_a_vessel_that_was_moved_is_seen_where_it_lies(point: VesselPoint, angle: float) -> None:
    cos, sin = np.cos(angle), np.sin(angle)
    moved = Affine2(cos, -sin, sin, cos, 12.0, -7.0)
    was = VesselPoint(*moved(point.x_px, point.y_px))
    for before in (PLAIN, FULL):
        after = before.registered(moved)
        seen, expected = after.image_point(point), before.image_point(was)
        assert (seen.x_px, seen.y_px) == pytest.approx((expected.x_px, expected.y_px))
        assert after.stage_xy_um(point) == pytest.approx(before.stage_xy_um(was))
        tip = StagePoint(9000.0, 8000.0, 13_000.0)
        here, there = after.tip_in_image(tip), before.tip_in_image(tip)
        assert (here.x_px, here.y_px) == pytest.approx((there.x_px, there.y_px))


def test_maps_are_composed_and_read_from_rows() -> None:
    first, second = Affine2(1.0, 2.0, -3.0, 4.0, 5.0, 6.0), Affine2(0.5, 0.1, 0.2, 0.7, -1.0, 2.0)
    assert second.after(first)(3.0, -2.0) == pytest.approx(second(*first(3.0, -2.0)))
    assert Affine2.of_rows(first.rows()) == first


def test_the_twin_gets_the_full_map_beside_the_affine_one() -> None:
    assert calibration_fields(PLAIN)["floor_map"] is None
    fields = calibration_fields(FULL)
    assert fields["image_from_vessel"] == PLAIN.image_from_vessel.rows()
    assert fields["floor_map"] == {
        "homography": [[0.67, -0.002, 198.0], [0.003, 0.66, 1.0], [4e-6, 3e-6, 1.0]],
        "center_px": [799.5, 599.5],
        "radial": -0.02,
        "radius_px": 1000.0,
    }


def test_a_click_outside_the_fold_is_still_a_point() -> None:
    assert np.isfinite(FULL.vessel_point(ImagePoint(1e6, -1e6)).x_px)
