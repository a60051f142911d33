"""The guided calibration on the distorted, tilted, wet simulated rig: the whole of it, and its refusals."""

import asyncio
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from mrnav_server.app.calibration_bench import SimulatedBench
from mrnav_server.app.calibration_run import (
    calibrate_simulated,
    check_simulated,
    distorted,
    load_draft,
    run_check,
    save_draft,
    simulated_plan,
)
from mrnav_server.core.errors import ConfigError, DeviceTimeoutError, RefusedError
from mrnav_server.core.frames import ImagePoint, StagePoint, VesselPoint
from mrnav_server.core.limits import Limits
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Frame
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.calibration_host import CalibrationHost
from mrnav_server.settings import CameraConfig, Settings
from mrnav_server.sim.microscope import Microscope
from mrnav_server.sim.world import SimConfig
from mrnav_server.vision.calibration_file import CalibrationFile, calibration_of, finished
from mrnav_server.vision.calibration_looks import held_out_points, raster_points
from mrnav_server.vision.calibration_parts import Draft
from mrnav_server.vision.calibration_plan import (
    CalibrationConfig,
    MoveTip,
    Pictures,
    Prepare,
    Step,
)
from mrnav_server.vision.calibration_procedure import Procedure
from mrnav_server.vision.charuco import SheetConfig
from mrnav_server.vision.tracker import Tracker, TrackerConfig
from mrnav_server.vision.vessel_model import vessel_map

# A quarter of the pixels, so that it is over in seconds.
SMALL = distorted(
    Settings(camera=CameraConfig(width_px=800, height_px=600), sim=SimConfig(image_um_per_px=30.0))
)
PLAN = simulated_plan(SMALL, CalibrationConfig(descent_step_um=100.0, pictures=2, sheet_pictures=4))


@cache
def vessel() -> VesselMap:
    return vessel_map("open", np.full((1800, 1800), 255, np.uint8))


@cache
def calibrated() -> tuple[SimulatedBench, CalibrationFile, list[Step]]:
    procedure = Procedure(PLAN, SMALL.camera, SMALL.tracker)
    steps: list[Step] = []
    bench = asyncio.run(calibrate_simulated(SMALL, vessel(), procedure, PLAN.sheet, steps.append))
    return bench, finished(procedure.draft, made_by="test", made_at="now", simulated=True), steps


def test_the_whole_calibration_is_near_the_truth() -> None:
    bench, file, _ = calibrated()
    errors = bench.true_errors(file, vessel(), PLAN.height_factor)
    assert errors.floor_rms_um <= 5.0
    assert file.floor.residuals.rms_um <= 5.0
    assert file.tip.held_out.rms_um <= 10.0
    assert errors.tip_steady_um <= 10.0
    assert errors.offset_um <= 50.0
    assert errors.held_um <= 50.0
    assert errors.critical_height_share <= 0.02
    assert abs(file.height.floor_z_um - 2000.0) < 50.0
    # The lens and the height of the camera are found, too: -1 % at the corners, 70 mm over the floor.
    assert file.floor.radial == pytest.approx(-0.01, abs=0.003)
    assert file.tip.camera_z_um - 2000.0 == pytest.approx(70_000.0, rel=0.01)


def test_the_tip_travels_high_and_dives_only_straight_down() -> None:
    _, _, steps = calibrated()
    before: StagePoint | None = None
    approaching = False
    for step in steps:
        if not isinstance(step, MoveTip):
            continue
        approaching = step.text.startswith("Approach")
        if before is not None and not approaching:
            across = np.hypot(step.target.x_um - before.x_um, step.target.y_um - before.y_um)
            high = min(step.target.z_um, before.z_um) >= PLAN.travel_z_um
            assert across < 1e-6 or high
        before = step.target
    # No robot is laid down but with the magnet high and aside.
    last = StagePoint(0.0, 0.0, 0.0)
    for step in steps:
        if isinstance(step, MoveTip):
            last = step.target
        if isinstance(step, Prepare) and step.scene == "robot":
            assert last.z_um == PLAN.travel_z_um
            assert abs(last.x_um - PLAN.raster_center_um[0]) > 3000.0


def test_a_session_checks_the_calibration_and_notices_a_bumped_needle() -> None:
    _, file, _ = calibrated()
    assert asyncio.run(check_simulated(SMALL, vessel(), file, PLAN)).max_um <= 20.0

    async def bumped() -> float:
        bench = SimulatedBench(SMALL, 1800, 10.0, PLAN.sheet)
        bench.world.bump_needle(120.0, -50.0)
        await bench.manipulator.open()
        bench.camera.open()
        host = CalibrationHost(
            bench.manipulator, bench.camera, SMALL.limits, bench.prepare, bench.clock, bench.sleep
        )
        return (await run_check(file, PLAN, host)).max_um

    assert asyncio.run(bumped()) > 100.0


def test_the_robot_is_tracked_true_by_a_measured_calibration() -> None:
    bench, file, _ = calibrated()
    truth, sim = bench.world.true_calibration, SMALL.sim
    microscope = Microscope(
        SMALL.microscope, SMALL.camera, sim.magnets, vessel(), truth, 5, bench.world.optics
    )
    tracker = Tracker(SMALL.tracker, calibration_of(file, vessel()))
    away = StagePoint(60_000.0, -60_000.0, 13_000.0)
    for place in (VesselPoint(200.0, 300.0), VesselPoint(1600.0, 1500.0), VesselPoint(900.0, 950.0)):
        tracker.reset()
        for number in range(12):
            track = tracker.update(Frame(number, number / 30.0, microscope.render(place, away)))
        assert track.vessel is not None
        assert 10.0 * track.vessel.distance_px(place) < 25.0
    # The affine map alone, as good as one can be, is off by far more.
    corner = VesselPoint(0.0, 0.0)
    x_px, y_px = truth.image_from_vessel(corner.x_px, corner.y_px)
    assert 10.0 * truth.vessel_point(ImagePoint(x_px, y_px)).distance_px(corner) > 50.0


def test_an_interrupted_calibration_goes_on_where_it_was(tmp_path: Path) -> None:
    _, file, _ = calibrated()
    path = tmp_path / "calibration.json.draft"
    assert load_draft(path) is None
    half = Draft(camera=file.camera, water=file.water, floor=file.floor, tip=file.tip)
    save_draft(half, path)
    again = Procedure(PLAN, SMALL.camera, SMALL.tracker, load_draft(path))
    assert again.draft == half
    assert again.step is not None
    assert again.step.stage == "height"
    # Another camera's draft is of no use.
    assert Procedure(PLAN, PictureFormat(), SMALL.tracker, half).draft.floor is None
    larger = replace(PLAN, sheet=SheetConfig(square_um=1010.0))
    assert Procedure(larger, SMALL.camera, SMALL.tracker, half).draft.floor is None
    path.write_text("{}")
    with pytest.raises(ConfigError, match="no calibration draft"):
        load_draft(path)


def asked(procedure: Procedure) -> str:
    return type(procedure.step).__name__


def test_a_refused_stage_begins_again() -> None:
    procedure = Procedure(PLAN, SMALL.camera, SMALL.tracker)
    procedure.told(None)
    assert asked(procedure) == "TakePictures"
    dark = Pictures((Frame(0, 0.0, np.zeros((600, 800, 3), np.uint8)),), None)
    with pytest.raises(RefusedError, match="0 of 117 corners"):
        procedure.told(dark)
    assert asked(procedure) == "Prepare"
    assert procedure.draft.floor is None


def test_a_tip_out_of_view_is_refused() -> None:
    _, file, _ = calibrated()
    far = replace(PLAN, raster_center_um=(16_400.0, 10_000.0))
    half = Draft(camera=file.camera, water=file.water, floor=file.floor)
    procedure = Procedure(far, SMALL.camera, SMALL.tracker, half)
    with pytest.raises(RefusedError, match=r"the tip was not seen at stage|µm RMS"):
        asyncio.run(calibrate_simulated(SMALL, vessel(), procedure, PLAN.sheet, lambda _: None))


def test_a_bad_sheet_is_refused() -> None:
    procedure = Procedure(PLAN, SMALL.camera, SMALL.tracker)
    other = SheetConfig(columns=6, rows=5)
    with pytest.raises(RefusedError, match="corners"):
        asyncio.run(calibrate_simulated(SMALL, vessel(), procedure, other, lambda _: None))


def test_no_robot_on_the_plate_is_refused() -> None:
    _, file, _ = calibrated()
    half = Draft(camera=file.camera, water=file.water, floor=file.floor, tip=file.tip)
    procedure = Procedure(PLAN, SMALL.camera, TrackerConfig(robot_radius_um=900.0), half)
    with pytest.raises(RefusedError, match="no robot was seen"):
        asyncio.run(calibrate_simulated(SMALL, vessel(), procedure, PLAN.sheet, lambda _: None))


def test_the_host_moves_within_the_travel_and_says_when_the_tip_does_not_arrive() -> None:
    async def perform(step: Step, stuck: bool) -> None:
        bench = SimulatedBench(SMALL, 1800, 10.0, PLAN.sheet)
        await bench.manipulator.open()
        if stuck:
            bench.manipulator.mute()
        host = CalibrationHost(
            bench.manipulator, bench.camera, Limits(), bench.prepare, bench.clock, bench.sleep
        )
        await host.perform(step)
        assert bench.world.tip.x_um == pytest.approx(12_000.0, abs=2.0)

    there = MoveTip("tip", "", 0.0, StagePoint(12_000.0, 10_000.0, 15_000.0), 2000.0)
    asyncio.run(perform(there, stuck=False))
    with pytest.raises(DeviceTimeoutError, match="did not arrive"):
        asyncio.run(perform(there, stuck=True))
    with pytest.raises(RefusedError, match="outside its travel"):
        asyncio.run(perform(replace(there, target=StagePoint(21_000.0, 0.0, 0.0)), stuck=False))


def test_a_tip_that_rises_goes_up_before_it_goes_across() -> None:
    async def heights() -> list[tuple[float, float]]:
        bench = SimulatedBench(SMALL, 1800, 10.0, PLAN.sheet)
        bench.world.place_tip(StagePoint(6000.0, 6000.0, 9000.0))
        await bench.manipulator.open()
        seen: list[tuple[float, float]] = []

        async def sleep(duration_s: float) -> None:
            await bench.sleep(duration_s)
            seen.append((bench.world.tip.x_um, bench.world.tip.z_um))

        host = CalibrationHost(bench.manipulator, bench.camera, Limits(), bench.prepare, bench.clock, sleep)
        await host.perform(MoveTip("tip", "", 0.0, StagePoint(13_000.0, 6000.0, 16_000.0), 2000.0))
        return seen

    way = asyncio.run(heights())
    assert all(z_um > 15_990.0 for x_um, z_um in way if x_um > 6010.0)
    assert way[-1] == pytest.approx((13_000.0, 16_000.0), abs=2.0)


def test_the_raster_leaves_out_what_is_held_out() -> None:
    raster = np.array([point.array() for point in raster_points(PLAN)])
    held_out = np.array([point.array() for point in held_out_points(PLAN)])
    assert raster.shape == (27, 3)
    assert np.all(np.diff(raster[:, 2]) <= 0.0)
    nearest = np.linalg.norm(held_out[:, None] - raster[None], axis=2).min(axis=1)
    assert nearest.min() > 500.0
    assert np.abs(held_out[:, 2] - 12_500.0).max() == 1000.0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"raster_z_um": (12_000.0,)}, "two or more heights"),
        ({"raster_z_um": (9000.0, 12_000.0)}, "the highest first"),
        ({"travel_z_um": 10_000.0}, "travel_z_um"),
        ({"approaches": 3}, "approaches"),
    ],
)
def test_a_plan_that_cannot_work_names_the_setting(change: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        replace(PLAN, **change)  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("azimuth_deg", [-15.0, 100.0])
def test_full_size_pictures_and_other_needles(seed: int, azimuth_deg: float) -> None:
    base = distorted(Settings())
    magnets = replace(base.sim.magnets, azimuth_deg=azimuth_deg)
    settings = base.model_copy(update={"sim": replace(base.sim, seed=seed, magnets=magnets)})
    turn = np.deg2rad(azimuth_deg)
    rough = (float(1900.0 * np.cos(turn)), float(1900.0 * np.sin(turn)))
    plan = simulated_plan(settings, CalibrationConfig(rough_offset_um=rough))
    procedure = Procedure(plan, settings.camera, settings.tracker)
    bench = asyncio.run(calibrate_simulated(settings, vessel(), procedure, plan.sheet, lambda _: None))
    file = finished(procedure.draft, made_by="", made_at="", simulated=True)
    errors = bench.true_errors(file, vessel(), plan.height_factor)
    assert errors.floor_rms_um <= 5.0
    assert file.tip.held_out.max_um <= 10.0
    assert errors.tip_steady_um <= 10.0
    assert errors.offset_um <= 50.0
    assert errors.critical_height_share <= 0.02
