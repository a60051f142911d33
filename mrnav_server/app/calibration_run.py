"""Runs the guided calibration, by hand on real devices and by itself on the simulated rig."""

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Generator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

from mrnav_server.app.bench import build_camera, build_manipulator
from mrnav_server.app.calibration_bench import SimulatedBench
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.vessel import VesselMap
from mrnav_server.devices.base import Camera, Manipulator
from mrnav_server.devices.micromanager.shared_core import SharedCore
from mrnav_server.loops.calibration_host import CalibrationHost
from mrnav_server.settings import Settings
from mrnav_server.sim.optics import OpticsConfig
from mrnav_server.vision.calibration_check import check_tip
from mrnav_server.vision.calibration_file import CalibrationFile
from mrnav_server.vision.calibration_parts import Draft, HeldOut
from mrnav_server.vision.calibration_plan import Answer, CalibrationConfig, Prepare, Step
from mrnav_server.vision.calibration_procedure import Procedure
from mrnav_server.vision.charuco import SheetConfig

Told = Callable[[Step], None]
Ask = Callable[[Prepare], Awaitable[None]]


async def run_procedure(
    procedure: Procedure, host: CalibrationHost, told: Told, draft_path: Path | None = None
) -> None:
    """Perform every step; keep the draft after each stage, so that an interrupted run goes on from there.

    Raises:
        RefusedError: If a stage is not good enough.
        DeviceError: If a device fails.
    """
    stage = ""
    while procedure.step is not None:
        step = procedure.step
        if draft_path is not None and stage not in ("", step.stage):
            save_draft(procedure.draft, draft_path)
        stage = step.stage
        told(step)
        # In a thread: drivers that the event loop keeps in touch would seem silent after long sums.
        await asyncio.to_thread(procedure.told, await host.perform(step))
    if draft_path is not None:
        save_draft(procedure.draft, draft_path)


def save_draft(draft: Draft, path: Path) -> None:
    """Keep what was measured."""
    path.write_text(draft.model_dump_json(indent=2) + "\n")


def load_draft(path: Path) -> Draft | None:
    """Return what was measured before; None if there is none.

    Raises:
        ConfigError: If the file is not a draft.
    """
    if not path.is_file():
        return None
    try:
        return Draft.model_validate_json(path.read_bytes())
    except ValueError as error:
        raise ConfigError(f"{path} is no calibration draft ({error}): remove it to begin afresh") from None


def distorted(settings: Settings) -> Settings:
    """Return the simulated rig with a lens that distorts, a camera that is tilted, and water on the plate."""
    optics = OpticsConfig(radial=-0.01, tilt_deg=2.0, water_depth_um=3000.0)
    return settings.model_copy(update={"sim": replace(settings.sim, optics=optics)})


def simulated_plan(settings: Settings, plan: CalibrationConfig) -> CalibrationConfig:
    """Return a plan with the simulated rig's own water."""
    optics = settings.sim.optics
    return replace(plan, water_depth_um=optics.water_depth_um, water_index=optics.water_index)


async def calibrate_simulated(
    settings: Settings,
    vessel: VesselMap,
    procedure: Procedure,
    sheet: SheetConfig,
    told: Told,
    draft_path: Path | None = None,
) -> SimulatedBench:
    """Run the whole procedure on the simulated rig, which prepares itself; return its bench."""
    bench = await asyncio.to_thread(SimulatedBench, settings, vessel.size_px, vessel.um_per_px, sheet)
    async with _simulated_host(bench, settings) as host:
        await run_procedure(procedure, host, told, draft_path)
    return bench


async def calibrate_real(
    settings: Settings, procedure: Procedure, ask: Ask, told: Told, draft_path: Path
) -> None:
    """Run the procedure on the devices that the settings name; a person prepares the bench."""
    async with _real_host(settings, ask) as host:
        await run_procedure(procedure, host, told, draft_path)


async def check_simulated(
    settings: Settings, vessel: VesselMap, file: CalibrationFile, plan: CalibrationConfig
) -> HeldOut:
    """Compare the tip's map with where the simulated tip is seen."""
    bench = await asyncio.to_thread(SimulatedBench, settings, vessel.size_px, vessel.um_per_px, plan.sheet)
    async with _simulated_host(bench, settings) as host:
        return await run_check(file, plan, host)


async def check_real(settings: Settings, file: CalibrationFile, plan: CalibrationConfig, ask: Ask) -> HeldOut:
    """Compare the tip's map with where the tip is seen."""
    async with _real_host(settings, ask) as host:
        return await run_check(file, plan, host)


async def run_check(file: CalibrationFile, plan: CalibrationConfig, host: CalibrationHost) -> HeldOut:
    """Visit places that nothing was fitted to; return how far off the tip's map is."""
    steps = check_tip(file.floor, file.tip, plan)
    step: Step | HeldOut = next(steps)
    while not isinstance(step, HeldOut):
        step = await asyncio.to_thread(_after, steps, await host.perform(step))
    return step


def _after(steps: Generator[Step, Answer, HeldOut], answer: Answer) -> Step | HeldOut:
    try:
        return steps.send(answer)
    except StopIteration as end:
        held_out: HeldOut = end.value
        return held_out


@asynccontextmanager
async def _simulated_host(bench: SimulatedBench, settings: Settings) -> AsyncIterator[CalibrationHost]:
    async with _opened(bench.manipulator, bench.camera):
        yield CalibrationHost(
            bench.manipulator, bench.camera, settings.limits, bench.prepare, bench.clock, bench.sleep
        )


@asynccontextmanager
async def _real_host(settings: Settings, ask: Ask) -> AsyncIterator[CalibrationHost]:
    # Not the bench that the server drives: that one needs the calibration which is made here.
    core, clock = SharedCore(settings.micromanager), time.monotonic
    manipulator, camera = build_manipulator(settings, clock, core), build_camera(settings, clock, core)
    async with _opened(manipulator, camera):
        yield CalibrationHost(manipulator, camera, settings.limits, ask, clock)


@asynccontextmanager
async def _opened(manipulator: Manipulator, camera: Camera) -> AsyncIterator[None]:
    """Open camera, then manipulator, so that what must stop first is innermost."""
    await asyncio.to_thread(camera.open)
    try:
        await manipulator.open()
        try:
            yield
        finally:
            manipulator.stop()
            await manipulator.close()
    finally:
        await asyncio.to_thread(camera.close)
