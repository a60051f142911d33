"""The vessel model onto the simulated picture: accuracy against the truth, and every reason to refuse."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.vision.calibration_parts import VesselPose
from mrnav_server.vision.registration import (
    RegistrationConfig,
    judge,
    outline_px,
    register,
    registered,
    still,
)
from tests.vision.registration_scenes import LENS, Scene, drawn, shipped

CONFIG = RegistrationConfig()


@pytest.mark.parametrize(
    ("model", "shift_um", "turn_deg"),
    [
        ("bifurcation", (0.0, 0.0), 0.0),
        ("bifurcation", (1990.0, 0.0), 4.9),
        ("network", (-1400.0, 1400.0), -5.0),
        ("serpentine", (600.0, -1900.0), 2.3),
    ],
)
def test_a_displaced_vessel_is_found_with_robot_and_needle_in_view(
    model: str, shift_um: tuple[float, float], turn_deg: float
) -> None:
    scene = Scene.of(shipped(model), shift_um, turn_deg)
    found = register(scene.picture(), scene.told, scene.vessel, CONFIG)
    assert found.accepted, found.reason
    assert scene.error_um(found.pose) < 30.0
    assert found.overlap > 0.9
    assert found.overlap_by == "lumen"
    assert found.wall_share > 0.9
    assert found.residual_um < 10.0
    assert found.scale == 1.0


def test_a_lens_a_tilted_camera_and_water_change_nothing() -> None:
    scene = Scene.of(shipped("bifurcation"), (1200.0, -900.0), 3.0, LENS)
    found = register(scene.picture(), scene.told, scene.vessel, CONFIG)
    assert found.accepted, found.reason
    assert scene.error_um(found.pose) < 30.0


def test_dark_lumen_on_bright_tissue_is_found_too() -> None:
    scene = Scene.of(shipped("bifurcation"), (-800.0, 500.0), -2.0)
    found = register(255 - scene.picture(), scene.told, scene.vessel, CONFIG)
    assert found.accepted, found.reason
    assert scene.error_um(found.pose) < 30.0


def test_a_straight_tube_without_ends_says_along_which_direction_it_may_slide() -> None:
    scene = Scene.of(drawn(((-300, 900), (2100, 900))), turn_deg=4.0)
    found = register(scene.picture(), scene.told, scene.vessel, CONFIG)
    assert not found.accepted
    assert "slide along itself" in found.reason
    assert "along 4°" in found.reason or "along 3°" in found.reason or "along 5°" in found.reason


def test_a_lattice_says_where_else_it_may_lie() -> None:
    step = 170
    lines = [((k * step, -300), (k * step, 2100)) for k in range(11)]
    lines += [((-300, k * step), (2100, k * step)) for k in range(11)]
    # Half a period off: two poses explain the picture alike.
    scene = Scene.of(drawn(*lines, width_px=115), (850.0, 0.0))
    found = register(scene.picture(), scene.told, scene.vessel, CONFIG)
    assert not found.accepted
    assert "may as well lie 1.7 mm" in found.reason


def test_another_vessel_is_refused() -> None:
    scene = Scene.of(shipped("network"))
    found = register(scene.picture(), scene.told, shipped("bifurcation"), CONFIG)
    assert not found.accepted
    assert "is it this vessel" in found.reason


def test_an_empty_dish_is_refused() -> None:
    scene = Scene.of(shipped("bifurcation"))
    noise = np.random.default_rng(1).integers(80, 90, (1200, 1600, 3), dtype=np.uint8)
    found = register(noise, scene.told, scene.vessel, CONFIG)
    assert not found.accepted
    assert found.reason


def test_a_vessel_out_of_reach_is_refused() -> None:
    scene = Scene.of(shipped("bifurcation"), (2500.0, 0.0))
    found = register(scene.picture(), scene.told, scene.vessel, replace(CONFIG, reach_um=1000.0))
    assert not found.accepted


def test_the_size_of_the_model_is_found_if_it_is_asked_for() -> None:
    scene = Scene.of(shipped("bifurcation"))
    larger = cv2.resize(scene.picture(), None, fx=1.015, fy=1.015).astype(np.uint8)[:1200, :1600]
    found = register(larger, scene.told, scene.vessel, CONFIG, scales=(0.98, 0.99, 1.0, 1.01, 1.02))
    assert found.accepted, found.reason
    assert found.scale == pytest.approx(1.015, abs=0.002)


def test_the_overlap_of_a_pose_by_hand_falls_with_its_error() -> None:
    scene = Scene.of(shipped("bifurcation"))
    picture = scene.picture()
    figures = [
        judge(picture, scene.told, scene.vessel, VesselPose(x_um=x_um))[0] for x_um in (0.0, 200.0, 800.0)
    ]
    assert figures[0] > figures[1] + 0.03
    assert figures[1] > figures[2] + 0.05


def test_walls_alone_judge_a_pose_where_lumen_and_tissue_look_alike() -> None:
    scene = Scene.of(shipped("bifurcation"))
    outline = np.full((1200, 1600), 150, np.uint8)
    lines = [np.rint(line).astype(np.int32) for line in outline_px(scene.told, scene.vessel, 50.0)]
    cv2.polylines(outline, lines, True, 60, 3, cv2.LINE_AA)
    found = register(outline, scene.told, scene.vessel, CONFIG)
    assert found.accepted, found.reason
    assert found.overlap_by == "wall"
    assert scene.error_um(found.pose) < 30.0


def test_a_registered_calibration_sees_the_vessel_where_it_lies() -> None:
    scene = Scene.of(shipped("bifurcation"), (1000.0, -500.0), 3.0)
    found = registered(scene.told, scene.vessel, VesselPose(x_um=1000.0, y_um=-500.0, angle_deg=3.0))
    for point in (VesselPoint(100.0, 200.0), VesselPoint(900.0, 900.0), VesselPoint(1700.0, 300.0)):
        at = scene.true.image_point(point)
        assert found.vessel_point(at).distance_px(point) < 1e-6
        assert found.stage_xy_um(point) == pytest.approx(scene.true.stage_xy_um(point))


def test_the_median_of_frames_forgets_what_moves() -> None:
    scene = Scene.of(shipped("bifurcation"))
    y, x = np.nonzero(scene.vessel.free)
    places = [VesselPoint(float(x[k]), float(y[k])) for k in np.linspace(0, len(x) - 1, 7, dtype=int)]
    frames = [scene.over(place) for place in places]
    bare = scene.microscope.render(None, replace(scene.world.tip, x_um=60_000.0, y_um=-60_000.0))
    rest = cv2.absdiff(still(frames), bare)
    single = cv2.absdiff(frames[0], bare)
    assert (rest > 30).mean() < 0.2 * (single > 30).mean()


@pytest.mark.parametrize("field", ["reach_um", "turn_deg", "overlap_min", "wall_share_min"])
def test_bounds_that_make_no_sense_are_refused(field: str) -> None:
    with pytest.raises(ConfigError, match=field):
        RegistrationConfig(**{field: -1.0})
