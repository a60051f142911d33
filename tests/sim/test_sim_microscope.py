"""The simulated microscope: things appear where the calibration says, and leave no trace."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrnav_server.core.arrays import ByteArray, FloatArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import Affine2, Calibration, StagePoint, VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.vessel import VesselMap
from mrnav_server.sim import occluder
from mrnav_server.sim.magnetics import Magnets
from mrnav_server.sim.microscope import Microscope, MicroscopeConfig
from mrnav_server.vision.vessel_model import vessel_map

HEIGHT_UM = 11_720.0
AWAY = StagePoint(60_000.0, -60_000.0, HEIGHT_UM)
ROBOT = VesselPoint(700.0, 900.0)
NOISY = MicroscopeConfig()
CLEAN = MicroscopeConfig(noise=0.0)
PICTURE = PictureFormat()
MAGNETS = Magnets()


def look_at(
    vessel: VesselMap,
    calibration: Calibration,
    config: MicroscopeConfig = NOISY,
    picture: PictureFormat = PICTURE,
    magnets: Magnets = MAGNETS,
    seed: int = 1,
) -> Microscope:
    return Microscope(config, picture, magnets, vessel, calibration, seed)


@pytest.fixture(scope="module")
def vessel() -> VesselMap:
    mask = np.zeros((1800, 1800), np.uint8)
    mask[500:1300, 200:1600] = 255
    return vessel_map("basin", mask)


@pytest.fixture(scope="module")
def open_water() -> VesselMap:
    """A vessel without walls in sight, so that a shadow falls on an even floor."""
    return vessel_map("open", np.full((1800, 1800), 255, np.uint8))


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return Calibration(
        image_from_vessel=Affine2.scale(10.0 / 15.0, 200.0, 0.0),
        stage_from_vessel=Affine2.scale(10.0, 1000.0, 1000.0),
        um_per_px=10.0,
        floor_z_um=0.0,
        magnet_offset_um=(0.0, 0.0),
        critical_height_um=11_270.0,
    )


@pytest.fixture(scope="module")
def clean(vessel: VesselMap, calibration: Calibration) -> Microscope:
    """A microscope without noise, so that pictures can be subtracted."""
    return look_at(vessel, calibration, CLEAN)


def darkening(clean: Microscope, robot: VesselPoint | None, tip: StagePoint) -> FloatArray:
    """Return how much darker a picture is than the bare floor, shape (height, width)."""
    bare, seen = (
        clean.render(*scene).astype(np.float64).mean(axis=2) for scene in ((None, AWAY), (robot, tip))
    )
    difference: FloatArray = bare - seen
    return difference


def centroid(weight: FloatArray) -> tuple[float, float]:
    y, x = np.mgrid[0 : weight.shape[0], 0 : weight.shape[1]]
    return float((x * weight).sum() / weight.sum()), float((y * weight).sum() / weight.sum())


def test_a_picture_has_the_cameras_format(vessel: VesselMap, calibration: Calibration) -> None:
    picture = look_at(vessel, calibration).render(ROBOT, AWAY)
    assert picture.shape == (1200, 1600, 3)
    assert picture.dtype == np.uint8
    small = look_at(vessel, calibration, picture=PictureFormat(333, 251))
    assert small.render(ROBOT, StagePoint(3000.0, 3000.0, HEIGHT_UM)).shape == (251, 333, 3)


def test_pictures_that_were_handed_out_stay_as_they_are(clean: Microscope) -> None:
    first = clean.render(ROBOT, AWAY)
    copy = first.copy()
    for _ in range(20):
        clean.render(VesselPoint(1000.0, 700.0), AWAY)
    assert np.array_equal(first, copy)


@pytest.mark.parametrize("place", [(700.0, 900.0), (700.4, 900.7), (1011.3, 655.2)])
def test_the_robot_is_a_dark_disc_where_the_calibration_says(
    clean: Microscope, calibration: Calibration, place: tuple[float, float]
) -> None:
    robot = VesselPoint(*place)
    true = calibration.image_point(robot)
    dark = (darkening(clean, robot, AWAY) > 85.0).astype(np.uint8)
    outline, _ = cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    (x_px, y_px), radius_px = cv2.minEnclosingCircle(max(outline, key=len))
    assert (x_px, y_px) == pytest.approx((true.x_px, true.y_px), abs=0.75)
    assert radius_px == pytest.approx(500.0 / 15.0, abs=1.0)


def test_the_robot_moves_by_parts_of_a_pixel(clean: Microscope) -> None:
    left, right = (
        centroid(np.maximum(darkening(clean, VesselPoint(700.0 + x, 900.0), AWAY), 0.0)) for x in (0.0, 0.45)
    )
    assert right[0] - left[0] == pytest.approx(0.3, abs=0.03)
    assert right[1] - left[1] == pytest.approx(0.0, abs=0.03)


@pytest.mark.parametrize("height_um", [9_000.0, HEIGHT_UM, 16_000.0])
@pytest.mark.parametrize("place", [(5_000.0, 5_000.0), (14_000.0, 12_000.0)])
def test_the_magnet_appears_at_its_own_height(
    open_water: VesselMap, calibration: Calibration, place: tuple[float, float], height_um: float
) -> None:
    thin = MicroscopeConfig(noise=0.0, needle_diameter_um=50.0)
    upright = Magnets(tilt_deg=0.0, needle_length_um=100.0)
    microscope = look_at(open_water, calibration, thin, magnets=upright)
    tip = StagePoint(*place, height_um)
    seen = calibration.tip_in_image(tip)
    column, row = round(seen.x_px), round(seen.y_px)
    window = (slice(row - 100, row + 101), slice(column - 100, column + 101))
    difference = np.abs(darkening(microscope, None, tip)[window])
    # The highlight lies on one flank, and the thin needle leans away from the optical axis.
    assert centroid(difference) == pytest.approx((100.0, 100.0), abs=12.0)
    zoom = 70_000.0 / (70_000.0 - height_um)
    across_px = 2.0 * np.sqrt(np.count_nonzero(difference > 0.5 * difference.max()) / np.pi)
    assert across_px == pytest.approx(zoom * 1000.0 / 15.0, rel=0.25)


def test_a_higher_magnet_is_more_blurred(open_water: VesselMap, calibration: Calibration) -> None:
    clean = look_at(open_water, calibration, CLEAN)
    sharpness = []
    for z_um in (7_000.0, 12_000.0, 18_000.0):
        # Smoothed, so that a speck of dust that gets hidden does not count as an edge.
        shadow = cv2.blur(darkening(clean, None, StagePoint(9_000.0, 12_000.0, z_um)), (9, 9))
        sharpness.append(np.abs(np.diff(shadow, axis=0)).max())
    assert sharpness[0] > sharpness[1] > sharpness[2]


@settings(max_examples=40, deadline=None)
@given(
    robot=st.builds(VesselPoint, st.floats(-500, 2500), st.floats(-500, 2500)),
    tip=st.builds(StagePoint, st.floats(-9e3, 29e3), st.floats(-9e3, 29e3), st.floats(0.0, 69e3)),
)
def test_whatever_was_painted_is_gone_in_the_next_picture(
    clean: Microscope, robot: VesselPoint, tip: StagePoint
) -> None:
    bare = clean.render(None, AWAY)
    clean.render(robot, tip)
    assert np.array_equal(clean.render(None, AWAY), bare)


@pytest.mark.parametrize("azimuth_deg", [-15.0, 90.0, 200.0])
@pytest.mark.parametrize("tilt_deg", [0.0, 45.0, 80.0])
def test_any_pose_of_the_needle_can_be_painted(
    vessel: VesselMap, calibration: Calibration, azimuth_deg: float, tilt_deg: float
) -> None:
    picture = PictureFormat(800, 600)
    magnets = Magnets(tilt_deg=tilt_deg, azimuth_deg=azimuth_deg)
    centered = replace(calibration, image_center_px=picture.center_px)
    microscope = look_at(vessel, centered, CLEAN, picture, magnets)
    seen = np.abs(darkening(microscope, None, StagePoint(4_000.0, 5_500.0, HEIGHT_UM))) > 5.0
    heading = np.deg2rad(azimuth_deg)
    assert np.count_nonzero(seen) > 2000
    if tilt_deg == 45.0:
        x_px, y_px = centroid(seen.astype(np.float64))
        tip = centered.tip_in_image(StagePoint(4_000.0, 5_500.0, HEIGHT_UM))
        along = (x_px - tip.x_px) * np.cos(heading) + (y_px - tip.y_px) * np.sin(heading)
        assert along > 20.0


@pytest.mark.parametrize("tilt_deg", [0.0, 3.0, 45.0, 80.0])
def test_painting_only_where_the_needle_is_leaves_out_nothing_of_it(
    vessel: VesselMap, calibration: Calibration, tilt_deg: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = PictureFormat(800, 600)
    centered = replace(calibration, image_center_px=picture.center_px)
    whole = [(column, 0, 75) for column in range(0, 100, occluder._STRIP_CELLS)]
    for azimuth_deg in (-15.0, 90.0, 200.0):
        magnets = Magnets(tilt_deg=tilt_deg, azimuth_deg=azimuth_deg)
        microscope = look_at(vessel, centered, CLEAN, picture, magnets)
        for tip in ((1_200.0, 1_500.0, 2_000.0), (4_000.0, 5_500.0, HEIGHT_UM), (7_000.0, 5_400.0, 30_000.0)):
            strips = microscope.render(None, StagePoint(*tip))
            with monkeypatch.context() as patched:
                patched.setattr(occluder.Occluder, "_strips", lambda *_: whole)
                assert np.array_equal(strips, microscope.render(None, StagePoint(*tip)))


def test_noise_is_fresh_in_every_picture_and_the_same_everywhere(
    vessel: VesselMap, calibration: Calibration
) -> None:
    microscope = look_at(vessel, calibration, MicroscopeConfig(noise=3.0))
    first, second = (microscope.render(ROBOT, AWAY).astype(np.float64) for _ in range(2))
    change = (first - second) / np.sqrt(2.0)
    on_robot, on_floor = change[590:611, 656:677], change[400:500, 700:900]
    assert on_floor.std() == pytest.approx(3.0, rel=0.1)
    assert on_robot.std() == pytest.approx(3.0, rel=0.15)
    assert abs(change.mean()) < 0.05


def test_no_two_pictures_in_a_row_are_the_same(vessel: VesselMap, calibration: Calibration) -> None:
    # A small picture, so that enough of them can be compared: a chance repeat has odds of 1 in 4096.
    microscope = look_at(vessel, calibration, picture=PictureFormat(64, 64))
    before = microscope.render(None, AWAY)
    for _ in range(20_000):
        picture = microscope.render(None, AWAY)
        assert not np.array_equal(picture, before)
        before = picture


def test_a_seed_gives_the_same_pictures_again(vessel: VesselMap, calibration: Calibration) -> None:
    def pictures(seed: int) -> list[ByteArray]:
        microscope = look_at(vessel, calibration, seed=seed)
        return [microscope.render(ROBOT, AWAY) for _ in range(2)]

    first, again, other = pictures(5), pictures(5), pictures(6)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0], other[0])


def test_the_lumen_is_brighter_than_robot_and_wall(clean: Microscope, calibration: Calibration) -> None:
    gray = clean.render(ROBOT, AWAY).mean(axis=2)
    robot, middle, wall = (
        calibration.image_point(VesselPoint(*p)) for p in ((700.0, 900.0), (1000.0, 900.0), (1000.0, 501.0))
    )
    at = [gray[round(p.y_px), round(p.x_px)] for p in (robot, middle, wall)]
    assert at[1] > at[0] + 80.0
    assert at[1] > at[2] + 25.0


@pytest.mark.parametrize(
    ("field", "value"), [("noise", -1.0), ("needle_diameter_um", 10.0), ("pupil_um", float("nan"))]
)
def test_a_setting_out_of_range_names_itself(field: str, value: float) -> None:
    with pytest.raises(ConfigError, match=field):
        replace(NOISY, **{field: value})
