"""The simulated camera with tilt, distortion and water: exact rays, their maps, the pictures."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import StagePoint, VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.vessel import VesselMap
from mrnav_server.sim.microscope import Microscope, MicroscopeConfig, floor_seen_um
from mrnav_server.sim.optics import Optics, OpticsConfig
from mrnav_server.sim.sheet import sheet_picture
from mrnav_server.sim.world import SimConfig, SimulatedWorld, optics, true_calibration
from mrnav_server.vision.vessel_model import vessel_map

PICTURE = PictureFormat(800, 600)
DRY = OpticsConfig(radial=-0.02, tilt_deg=2.0)
WET = replace(DRY, water_depth_um=3000.0)
AWAY = StagePoint(60_000.0, -60_000.0, 11_720.0)
grid = st.builds(VesselPoint, st.floats(0, 1800), st.floats(0, 1800))


@cache
def vessel() -> VesselMap:
    mask = np.zeros((1800, 1800), np.uint8)
    mask[500:1300, 200:1600] = 255
    return vessel_map("basin", mask)


def rig(config: OpticsConfig) -> SimConfig:
    return SimConfig(optics=config, image_um_per_px=30.0, start=VesselPoint(900.0, 900.0))


@cache
def made(config: OpticsConfig) -> Optics:
    found = optics(rig(config), vessel(), PICTURE)
    assert found is not None
    return found


def test_plain_optics_are_none_and_leave_the_calibration_affine() -> None:
    world = SimulatedWorld(rig(OpticsConfig()), vessel(), PICTURE)
    assert world.optics is None
    assert world.true_calibration.floor is None
    assert world.true_calibration.tip is None


@given(point=grid, x_um=st.floats(2000, 18_000), y_um=st.floats(2000, 18_000), z_um=st.floats(6000, 18_000))
@settings(max_examples=50, deadline=None)
def test_in_the_dry_the_maps_are_exact(point: VesselPoint, x_um: float, y_um: float, z_um: float) -> None:
    true, exact = true_calibration(rig(DRY), vessel(), PICTURE), made(DRY)
    tip = StagePoint(x_um, y_um, z_um)
    for told, seen in (
        (true.image_point(point), exact.image_point(point)),
        (true.tip_in_image(tip), exact.tip_in_image(tip)),
    ):
        assert (told.x_px, told.y_px) == pytest.approx((seen.x_px, seen.y_px), abs=1e-6)
    assert true.image_scale(point) == pytest.approx(exact.image_scale(point), rel=1e-5)


@given(point=grid)
@settings(max_examples=50, deadline=None)
def test_in_water_they_are_off_by_less_than_six_um(point: VesselPoint) -> None:
    true, exact = true_calibration(rig(WET), vessel(), PICTURE), made(WET)
    told, seen = true.vessel_point(exact.image_point(point)), point
    assert 10.0 * told.distance_px(seen) < 6.0


@given(point=grid)
@settings(max_examples=50, deadline=None)
def test_a_pixel_shows_the_floor_point_that_appears_in_it(point: VesselPoint) -> None:
    at_um = np.array([10.0 * point.x_px, 10.0 * point.y_px, 0.0])
    for config in (DRY, WET, OpticsConfig(water_depth_um=9000.0)):
        exact = made(config)
        assert exact.floor_um(exact.image(at_um)) == pytest.approx(at_um[:2], abs=1e-3)


def test_water_lifts_the_floor_by_snells_law() -> None:
    still = OpticsConfig(water_depth_um=4000.0, water_index=4.0 / 3.0)
    assert still.rise_um == pytest.approx(1000.0)
    exact = made(still)
    # Near the axis the floor under 4 mm of water appears as near as 3 mm of air would leave it.
    x_um, y_um = exact.floor_um(np.array(PICTURE.center_px)) + np.array([500.0, 0.0])
    under, over = (exact.image(np.array([x_um, y_um, height_um])) for height_um in (0.0, 4000.0))
    apparent_um = 70_000.0 - 1000.0
    assert (under - PICTURE.center_px)[0] == pytest.approx(
        (over - PICTURE.center_px)[0] * 66_000.0 / apparent_um, rel=1e-4
    )


def test_the_robot_and_the_floor_are_drawn_through_the_optics() -> None:
    config = MicroscopeConfig(noise=0.0)
    true, exact = true_calibration(rig(WET), vessel(), PICTURE), made(WET)
    microscope = Microscope(config, PICTURE, rig(WET).magnets, vessel(), true, 1, exact)
    robot = VesselPoint(1500.0, 600.0)
    bare, seen = (microscope.render(r, AWAY).astype(np.float64).mean(axis=2) for r in (None, robot))
    dark = ((bare - seen) > 85.0).astype(np.uint8)
    outline, _ = cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    (x_px, y_px), radius_px = cv2.minEnclosingCircle(max(outline, key=len))
    expected = exact.image_point(robot)
    assert (x_px, y_px) == pytest.approx((expected.x_px, expected.y_px), abs=0.8)
    assert radius_px == pytest.approx(50.0 * exact.image_scale(robot), abs=1.0)
    # The wall's dark line lies where the optics show the mask's edge.
    edge = exact.image_point(VesselPoint(900.0, 499.5))
    column = bare[:, round(edge.x_px)]
    near = column[round(edge.y_px) - 12 : round(edge.y_px) + 13]
    assert abs(int(np.argmin(near)) - 12) <= 2


def test_the_sheet_lies_where_it_was_laid() -> None:
    exact = made(WET)
    board = np.full((20, 20), 255, np.uint8)
    board[:10, :10] = 0
    seen_um = floor_seen_um(exact, PICTURE.width_px, PICTURE.height_px)
    picture = sheet_picture(board, 400.0, seen_um, (9200.0, 8900.0), 30.0)
    gray = picture[..., 0].astype(np.float64)
    turn = np.deg2rad(30.0)
    for along, across, black in ((-500.0, -500.0, True), (500.0, -500.0, False), (-500.0, 500.0, False)):
        x_um = 9200.0 + np.cos(turn) * along - np.sin(turn) * across
        y_um = 8900.0 + np.sin(turn) * along + np.cos(turn) * across
        x_px, y_px = exact.image(np.array([x_um, y_um, 0.0]))
        assert bool(gray[round(y_px), round(x_px)] < 100.0) is black


@pytest.mark.parametrize(
    ("field", "value"),
    [("radial", 0.5), ("tilt_deg", -1.0), ("water_index", 0.9), ("water_depth_um", float("nan"))],
)
def test_a_setting_out_of_range_names_itself(field: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"sim.optics.{field}"):
        replace(OpticsConfig(), **{field: value})


def test_a_distortion_that_folds_the_vessel_over_is_refused() -> None:
    # At 10 µm a pixel the vessel's corners lie 2.5 half diagonals off the axis; -0.1 turns back at 1.83.
    near = SimConfig(optics=OpticsConfig(radial=-0.1), image_um_per_px=10.0, start=VesselPoint(900.0, 900.0))
    for config, picture, folds in (
        (near, PICTURE, True),
        (replace(near, image_um_per_px=30.0), PICTURE, False),
        (replace(near, optics=OpticsConfig(radial=-0.02)), PICTURE, False),
        (replace(near, optics=OpticsConfig(radial=0.1)), PICTURE, False),
        (near, PictureFormat(400, 300), True),
    ):
        found, told = optics(config, vessel(), picture), true_calibration(config, vessel(), picture)
        magnets = config.magnets
        if not folds:
            Microscope(MicroscopeConfig(), picture, magnets, vessel(), told, 1, found)
            continue
        with pytest.raises(ConfigError, match=r"sim\.optics\.radial is -0\.1.*choose it above -0\.\d+"):
            Microscope(MicroscopeConfig(), picture, magnets, vessel(), told, 1, found)


@given(reach=st.floats(0.0, 6.0), angle=st.floats(0.0, 6.28))
@settings(max_examples=50, deadline=None)
def test_what_lies_further_out_never_appears_further_in(reach: float, angle: float) -> None:
    exact = made(OpticsConfig(radial=-0.1))
    center = np.array(PICTURE.center_px)
    away = 500.0 * 30.0 * np.array([np.cos(angle), np.sin(angle)])
    middle_um = exact.floor_um(center)
    at = [np.append(middle_um + share * away, 0.0) for share in (reach, reach + 0.05)]
    near, far = (np.linalg.norm(exact.image(point) - center) for point in at)
    assert far > near


def test_one_point_and_many_are_traced_alike() -> None:
    exact = made(WET)
    points = [(9000.0, 9000.0, 0.0), (2000.0, 15_000.0, 1000.0), (12_000.0, 4000.0, 12_000.0)]
    together = exact.image(np.array(points))
    for point, seen in zip(points, together, strict=True):
        assert exact.image(np.array(point)) == pytest.approx(seen, abs=1e-9)
    floor = exact.image_point(VesselPoint(900.0, 900.0))
    assert (floor.x_px, floor.y_px) == pytest.approx(together[0], abs=1e-9)
