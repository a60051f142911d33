"""The calibration file: what is saved comes back, and what must not be used is refused with the reason."""

import json
from pathlib import Path

import numpy as np
import pytest

from mrnav_server.core.camera_map import TipMap
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import StagePoint, VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.vessel import VesselMap
from mrnav_server.vision.calibration_file import (
    CalibrationFile,
    calibration_of,
    finished,
    load_calibration,
    read_calibration,
    save_calibration,
)
from mrnav_server.vision.calibration_parts import CameraPart, Draft, VesselPose, WaterPart
from mrnav_server.vision.vessel_model import vessel_map

FIGURES = {
    "points": 117,
    "rejected": 1,
    "parameters": 9,
    "rms_um": 2.0,
    "max_um": 6.0,
    "leave_one_out_um": 2.2,
    "leave_one_out_max_um": 7.0,
}
# The floor's origin lies below stage (10000, 10000); the camera stands straight above it.
SHARE = 70_000.0 / 72_000.0
TIP = TipMap(
    (SHARE, 0.0, -10_000.0 * SHARE / 72_000.0, 0.0, SHARE, -10_000.0 * SHARE / 72_000.0),
    (-10_000.0 * SHARE, -10_000.0 * SHARE),
    72_000.0,
)
PARTS = {
    "floor": {
        "homography": [1 / 15, 0.0, 800.0, 0.0, 1 / 15, 600.0, 1e-7, 0.0, 1.0],
        "center_px": [799.5, 599.5],
        "radial": -0.01,
        "radius_px": 1000.0,
        "square_um": 1000.0,
        "coverage": 0.22,
        "edge_sigma_um": 2.4,
        "residuals": FIGURES,
    },
    "tip": {
        "matrix": list(TIP.matrix),
        "offset_um": list(TIP.offset),
        "camera_z_um": 72_000.0,
        "heights_z_um": [16_000.0, 12_500.0, 9000.0],
        "residuals": FIGURES | {"points": 27},
        "held_out": {"points": 5, "rms_um": 3.0, "max_um": 5.0},
    },
    "height": {
        "floor_z_um": 2000.0,
        "critical_height_um": 10_675.0,
        "step_um": 50.0,
        "jump_z_um": 12_650.0,
    },
    "magnet": {
        "offset_um": [2040.0, 20.0],
        "friction_lead_um": 350.0,
        "approaches": 4,
        "rms_um": 24.0,
        "height_um": 11_100.0,
    },
}
WHERE = {"camera": {"width_px": 1600, "height_px": 1200}, "water": {"depth_um": 3000.0, "index": 1.333}}


def draft() -> Draft:
    return Draft.model_validate(WHERE | PARTS)


def made(simulated: bool = False) -> CalibrationFile:
    return finished(draft(), made_by="lab", made_at="2026-01-02T03:04:05Z", simulated=simulated)


def vessel() -> VesselMap:
    return vessel_map("plate", np.full((1800, 1800), 255, np.uint8))


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "calibration.json"
    save_calibration(made(), path)
    return path


def changed(path: Path, where: str, value: object, *, seal: bool) -> None:
    """Write another value into a file, with a digest that agrees or not."""
    whole = json.loads(path.read_text())
    part = whole
    *parents, last = where.split(".")
    for key in parents:
        part = part[key]
    part[last] = value
    if seal:
        whole["sha256"] = CalibrationFile.model_validate(whole).digest()
    path.write_text(json.dumps(whole))


def test_what_is_saved_comes_back(saved: Path) -> None:
    assert read_calibration(saved) == made()
    assert list(saved.parent.iterdir()) == [saved]


def test_the_calibration_maps_as_the_file_says(saved: Path) -> None:
    found = load_calibration(saved, PictureFormat(), vessel(), simulated=False)
    floor = made().floor.map
    middle, aside = VesselPoint(900.0, 900.0), VesselPoint(1000.0, 850.0)
    for point, floor_um in ((middle, (0.0, 0.0)), (aside, (1000.0, -500.0))):
        seen = found.image_point(point)
        assert (seen.x_px, seen.y_px) == pytest.approx(tuple(floor.image(np.array(floor_um))))
        assert found.stage_xy_um(point) == pytest.approx((10_000.0 + floor_um[0], 10_000.0 + floor_um[1]))
    assert found.floor_z_um == 2000.0
    assert found.magnet_offset_um == (2040.0, 20.0)
    assert found.critical_height_um == 10_675.0
    assert found.um_per_px == 10.0
    assert found.working_distance_um == pytest.approx(70_000.0)
    # 12 mm up, 1 mm off the axis: magnified by 70/58.
    tip = found.tip_in_image(StagePoint(11_000.0, 10_000.0, 14_000.0))
    expected = floor.image(np.array([1000.0 * 70.0 / 58.0, 0.0]))
    assert (tip.x_px, tip.y_px) == pytest.approx(tuple(expected))
    affine = found.image_from_vessel(900.0, 900.0)
    assert affine == pytest.approx((800.0, 600.0), abs=3.0)


def test_a_vessel_lies_where_its_pose_says() -> None:
    posed = made().model_copy(update={"vessel": VesselPose(x_um=300.0, y_um=-200.0, angle_deg=90.0)})
    there = calibration_of(posed, vessel()).image_point(VesselPoint(1000.0, 900.0))
    expected = posed.floor.map.image(np.array([300.0, -200.0 + 1000.0]))
    assert (there.x_px, there.y_px) == pytest.approx(tuple(expected))


@pytest.mark.parametrize(
    ("where", "value", "said"),
    [
        ("floor.residuals.rms_um", 5.1, "floor.residuals.rms_um is 5.1"),
        ("floor.residuals.points", 20, "floor.residuals.points"),
        ("floor.coverage", 0.05, "floor.coverage"),
        ("floor.radial", 0.9, "radial share"),
        ("tip.residuals.rms_um", 16.0, "tip.residuals.rms_um"),
        ("tip.residuals.max_um", 46.0, "tip.residuals.max_um"),
        ("tip.residuals.points", 3, "tip.residuals.points is 3"),
        ("tip.held_out.max_um", 30.5, "tip.held_out.max_um"),
        ("tip.held_out.points", 0, "tip.held_out.points"),
        ("magnet.approaches", 3, "magnet.approaches"),
        ("magnet.rms_um", 500.0, "magnet.rms_um"),
        ("height.critical_height_um", 9000.0, "contradicts"),
    ],
)
def test_a_calibration_too_bad_to_use_is_refused(saved: Path, where: str, value: object, said: str) -> None:
    changed(saved, where, value, seal=True)
    with pytest.raises(ConfigError, match=said):
        load_calibration(saved, PictureFormat(), vessel(), simulated=False)


@pytest.mark.parametrize(
    ("where", "value", "said"),
    [
        ("height.critical_height_um", 10_675.5, "changed after it was made"),
        ("made_by", "someone else", "changed after it was made"),
        ("version", 2, "version"),
        ("format", "other", "format"),
        ("tip.camera_z_um", "high", "tip.camera_z_um"),
        ("surplus", 1, "surplus"),
    ],
)
def test_a_file_that_was_changed_is_refused(saved: Path, where: str, value: object, said: str) -> None:
    changed(saved, where, value, seal=False)
    with pytest.raises(ConfigError, match=said):
        read_calibration(saved)


def test_a_calibration_for_something_else_is_refused(tmp_path: Path, saved: Path) -> None:
    with pytest.raises(ConfigError, match="1600 x 1200 px, the camera gives 800 x 600"):
        load_calibration(saved, PictureFormat(800, 600), vessel(), simulated=False)
    simulated = tmp_path / "simulated.json"
    save_calibration(made(simulated=True), simulated)
    load_calibration(simulated, PictureFormat(), vessel(), simulated=True)
    with pytest.raises(ConfigError, match="simulated rig"):
        load_calibration(simulated, PictureFormat(), vessel(), simulated=False)
    with pytest.raises(ConfigError, match="cannot be read"):
        read_calibration(tmp_path / "none.json")


def test_a_draft_without_all_parts_is_not_finished() -> None:
    empty = Draft(camera=CameraPart(width_px=1600, height_px=1200), water=WaterPart(depth_um=0.0, index=1.0))
    with pytest.raises(ConfigError, match="lacks floor, tip, height, magnet"):
        finished(empty, made_by="", made_at="", simulated=True)
