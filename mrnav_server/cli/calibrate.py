"""``mrnav calibrate``: the calibration sheet, the guided calibration, and what a calibration is worth."""

import asyncio
import json
import os
from collections.abc import Callable
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mrnav_server.cli.serve import ConfigOption
from mrnav_server.core.errors import ConfigError

if TYPE_CHECKING:
    from mrnav_server.app.calibration_run import Told
    from mrnav_server.core.vessel import VesselMap
    from mrnav_server.settings import Settings
    from mrnav_server.vision.calibration_file import CalibrationFile
    from mrnav_server.vision.calibration_parts import HeldOut
    from mrnav_server.vision.calibration_plan import CalibrationConfig, Prepare, Step
    from mrnav_server.vision.calibration_procedure import Procedure

calibrate = typer.Typer(no_args_is_help=True, help="Calibrate microscope and manipulator.")

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on the last line.")]
SquareOption = Annotated[float, typer.Option(help="Side of a square in µm, as measured on the sheet.")]


@calibrate.command()
def sheet(
    out: Annotated[Path, typer.Option(help="The PDF file.")] = Path("sheet.pdf"),
    square_um: SquareOption = 1000.0,
    columns: Annotated[int, typer.Option(help="Squares along x.")] = 14,
    rows: Annotated[int, typer.Option(help="Squares along y.")] = 10,
) -> None:
    """Write the calibration sheet as a PDF at true scale."""
    from mrnav_server.vision.charuco import SheetConfig, write_sheet

    board = SheetConfig(columns, rows, square_um)
    write_sheet(board, out)
    width_mm, height_mm = (side * 1e-3 for side in board.size_um)
    typer.echo(
        f"{out}: {width_mm:g} x {height_mm:g} mm; print it at 100 % on film, measure it, and pass the"
        " square's true side as --square-um"
    )


@calibrate.command()
def run(
    config: ConfigOption = None,
    out: Annotated[Path, typer.Option(help="The calibration file.")] = Path("calibration.json"),
    made_by: Annotated[str, typer.Option(help="Who calibrates.")] = "",
    square_um: SquareOption = 1000.0,
    water_depth_um: Annotated[
        float | None,
        typer.Option(help="Water over the robot's centre in µm; the simulated rig knows its own."),
    ] = None,
    distorted: Annotated[
        bool, typer.Option("--distorted", help="Simulated rig: switch on distortion, tilt and water.")
    ] = False,
    json_output: JsonOption = False,
) -> None:
    """Calibrate, step by step; interrupted, the same command goes on where it was.

    The simulated rig does every step by itself.
    """
    from mrnav_server.app.calibration_run import distorted as with_optics
    from mrnav_server.app.calibration_run import load_draft, simulated_plan
    from mrnav_server.vision.calibration_file import finished, save_calibration
    from mrnav_server.vision.calibration_procedure import Procedure

    settings, vessel = _rig(config)
    simulated = _is_simulated(settings)
    if distorted:
        if not simulated:
            raise ConfigError(
                "--distorted switches on the simulated rig's optics: leave it out on real devices"
            )
        settings = with_optics(settings)
    if water_depth_um is None and not simulated:
        raise ConfigError(
            "the water over the robot's centre lifts the floor that the camera sees: give --water-depth-um,"
            " 0 for a dry dish"
        )
    plan = _plan(settings.calibration, square_um, water_depth_um)
    if simulated and water_depth_um is None:
        plan = simulated_plan(settings, plan)
    draft_path = out.with_name(out.name + ".draft")
    procedure = Procedure(plan, settings.camera, settings.tracker, load_draft(draft_path))
    with _Bar() as bar:
        true_errors = asyncio.run(
            _calibrate(settings, vessel, plan, procedure, bar.told, draft_path, simulated)
        )
    made_at = datetime.now(UTC).isoformat(timespec="seconds")
    file = finished(procedure.draft, made_by=made_by, made_at=made_at, simulated=simulated)
    save_calibration(file, out)
    draft_path.unlink(missing_ok=True)
    _print(file, out, json_output, None if true_errors is None else true_errors(file))


@calibrate.command()
def check(
    file: Annotated[Path, typer.Argument(help="A calibration file.")],
    config: ConfigOption = None,
    live: Annotated[bool, typer.Option("--live", help="Visit places with the tip and compare.")] = False,
    json_output: JsonOption = False,
) -> None:
    """Tell whether a calibration is good enough to run by, and whether it still holds."""
    from mrnav_server.vision.calibration_file import HELD_OUT_MAX_UM, load_calibration, read_calibration

    settings, vessel = _rig(config)
    load_calibration(file, settings.camera, vessel, simulated=_is_simulated(settings))
    found = read_calibration(file)
    answer: dict[str, Any] = {"ok": True, "file": str(file), "simulated": found.simulated}
    if live:
        held_out = asyncio.run(_check(settings, vessel, found))
        answer["held_out"] = held_out.model_dump()
        answer["ok"] = held_out.max_um <= HELD_OUT_MAX_UM
    if json_output:
        typer.echo(json.dumps(answer))
    elif live:
        origin = "simulated" if found.simulated else "measured"
        typer.echo(
            f"{file}: the tip's map misses {held_out.points} places by {held_out.rms_um:.1f} µm RMS,"
            f" {held_out.max_um:.1f} µm at most ({origin})"
        )
    else:
        typer.echo(f"{file}: good enough to run by; --live tells whether it still holds")
    if not answer["ok"]:
        typer.echo(f"more than {HELD_OUT_MAX_UM:g} µm: calibrate again before the rig runs", err=True)
        raise typer.Exit(1)


@calibrate.command()
def show(
    file: Annotated[Path, typer.Argument(help="A calibration file.")],
    json_output: JsonOption = False,
) -> None:
    """Print a calibration and its residuals."""
    from mrnav_server.vision.calibration_file import read_calibration

    _print(read_calibration(file), file, json_output, None)


def _rig(config: Path | None) -> "tuple[Settings, VesselMap]":
    from mrnav_server.settings import load_settings
    from mrnav_server.vision.model_store import find_model
    from mrnav_server.vision.vessel_model import load_vessel_model

    settings = load_settings(config, os.environ)
    return settings, load_vessel_model(find_model(settings.rig.vessel))


def _is_simulated(settings: "Settings") -> bool:
    kinds = {settings.manipulator.driver == "simulated", settings.rig.camera == "simulated"}
    if len(kinds) > 1:
        raise ConfigError(
            "one of manipulator.driver and rig.camera is simulated, the other is not: a calibration needs"
            " both to be real, or none"
        )
    return kinds == {True}


def _plan(
    configured: "CalibrationConfig", square_um: float, water_depth_um: float | None
) -> "CalibrationConfig":
    from mrnav_server.vision.charuco import SheetConfig

    return replace(configured, sheet=SheetConfig(square_um=square_um), water_depth_um=water_depth_um or 0.0)


async def _calibrate(
    settings: "Settings",
    vessel: "VesselMap",
    plan: "CalibrationConfig",
    procedure: "Procedure",
    told: "Told",
    draft_path: Path,
    simulated: bool,
) -> "Callable[[CalibrationFile], dict[str, float]] | None":
    from mrnav_server.app.calibration_run import calibrate_real, calibrate_simulated

    if not simulated:
        await calibrate_real(settings, procedure, _ask, told, draft_path)
        return None
    bench = await calibrate_simulated(settings, vessel, procedure, plan.sheet, told, draft_path)
    return lambda file: asdict(bench.true_errors(file, vessel, plan.height_factor))


async def _check(settings: "Settings", vessel: "VesselMap", file: "CalibrationFile") -> "HeldOut":
    from mrnav_server.app.calibration_run import check_real, check_simulated

    plan = _plan(settings.calibration, file.floor.square_um, file.water.depth_um)
    if _is_simulated(settings):
        return await check_simulated(settings, vessel, file, plan)
    return await check_real(settings, file, plan, _ask)


async def _ask(step: "Prepare") -> None:
    """Wait until a person has done what a step asks for."""
    await asyncio.to_thread(typer.prompt, f"{step.text}; then press Enter", default="", show_default=False)


class _Bar:
    """Shows the step in progress on the error stream."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
        self._progress = Progress(*columns, console=Console(stderr=True), transient=True)
        self._task = self._progress.add_task("calibration", total=1.0)

    def __enter__(self) -> "_Bar":
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def told(self, step: "Step") -> None:
        self._progress.update(self._task, description=f"{step.stage}: {step.text}", completed=step.share)


def _print(file: "CalibrationFile", path: Path, json_output: bool, errors: dict[str, float] | None) -> None:
    if json_output:
        answer: dict[str, Any] = {"file": str(path)} | file.model_dump(mode="json")
        if errors is not None:
            answer["simulated_true_errors"] = errors
        typer.echo(json.dumps(answer))
        return
    from rich.console import Console
    from rich.table import Table

    origin = "simulated" if file.simulated else "measured"
    table = Table(title=f"Calibration {path} ({origin}), {file.made_at} {file.made_by}", title_justify="left")
    for column in ("part", "figure", origin):
        table.add_column(column)
    for part, figure, text in _rows(file):
        table.add_row(part, figure, text)
    for name, value in (errors or {}).items():
        shown = f"{100 * value:.2f} %" if name.endswith("share") else f"{value:.2f} µm"
        table.add_row("true error", name.removesuffix("_um").removesuffix("_share").replace("_", " "), shown)
    Console().print(table)
    Console().print(f"sha256 {file.sha256}", highlight=False)


def _rows(file: "CalibrationFile") -> list[tuple[str, str, str]]:
    floor, tip, height, magnet = file.floor, file.tip, file.height, file.magnet
    rows = [
        ("camera", "picture", f"{file.camera.width_px} x {file.camera.height_px} px"),
        ("floor", "corners used, rejected", f"{floor.residuals.points}, {floor.residuals.rejected}"),
        ("floor", "coverage of the picture", f"{100 * floor.coverage:.0f} %"),
        ("floor", "radial distortion at the corners", f"{100 * floor.radial:.2f} %"),
        ("floor", "standard deviation at the corners", f"{floor.edge_sigma_um:.2f} µm"),
        ("tip", "places, heights", f"{tip.residuals.points}, {len(tip.heights_z_um)}"),
        ("tip", "held out, RMS and maximum", f"{tip.held_out.rms_um:.2f}, {tip.held_out.max_um:.2f} µm"),
        ("height", "critical height h*", f"{height.critical_height_um:.0f} ± {height.step_um / 2:.0f} µm"),
        ("height", "floor", f"z = {height.floor_z_um:.0f} µm"),
        ("magnet", "offset", f"{magnet.offset_um[0]:.0f}, {magnet.offset_um[1]:.0f} µm"),
        ("magnet", "lead of friction", f"{magnet.friction_lead_um:.0f} µm"),
        ("magnet", "approaches, RMS", f"{magnet.approaches}, {magnet.rms_um:.0f} µm"),
    ]
    for name, figures in (("floor", floor.residuals), ("tip", tip.residuals)):
        rows += [
            (name, "RMS, corrected for the fit", f"{figures.rms_um:.2f} µm"),
            (name, "maximum", f"{figures.max_um:.2f} µm"),
            (
                name,
                "leave-one-out, RMS and maximum",
                f"{figures.leave_one_out_um:.2f}, {figures.leave_one_out_max_um:.2f} µm",
            ),
        ]
    return sorted(rows, key=lambda row: ("camera", "floor", "tip", "height", "magnet").index(row[0]))
