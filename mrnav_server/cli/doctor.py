"""``mrnav doctor``: what works on this machine, what does not, and what to do about it."""

import asyncio
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from mrnav_server.cli.serve import ConfigOption
from mrnav_server.core.errors import ConfigError, MrnavError

if TYPE_CHECKING:
    from mrnav_server.core.vessel import VesselMap
    from mrnav_server.settings import Settings

_PACKAGES = ("torch", "opencv-python-headless", "numpy", "scipy", "fastapi", "uvicorn", "websockets")
_FRAME_S = 2.0
"""A camera that gives no picture for so long is silent."""


@dataclass(frozen=True, slots=True)
class Check:
    """One finding.

    Attributes:
        name: What was looked at.
        ok: Whether the server can run with it.
        found: What was found, or what is wrong and what to do.
    """

    name: str
    ok: bool
    found: str


def doctor(
    config: ConfigOption = None,
    json_output: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Check Python, settings, vessel model, policy, ports and devices; nothing moves."""
    checks = list(examine(config))
    healthy = all(check.ok for check in checks)
    if json_output:
        typer.echo(json.dumps({"ok": healthy, "checks": [asdict(check) for check in checks]}))
    else:
        table = Table(title="mrnav doctor", title_justify="left")
        for column in ("", "check", "found"):
            table.add_column(column, overflow="fold")
        for check in checks:
            table.add_row("[green]ok[/]" if check.ok else "[bold red]fails[/]", check.name, check.found)
        Console().print(table)
    raise typer.Exit(0 if healthy else 1)


def examine(config: Path | None) -> Iterator[Check]:
    """Yield all findings; those that need settings only if the settings are right."""
    from mrnav_server.settings import load_settings

    yield _python()
    yield _packages()
    try:
        settings = load_settings(config, os.environ)
    except ConfigError as error:
        yield Check("settings", ok=False, found=str(error))
        return
    source = config or ("mrnav.toml" if Path("mrnav.toml").is_file() else "defaults")
    yield Check("settings", ok=True, found=f"{source}, configuration {settings.digest()[:12]}")
    yield from _model(settings)
    yield _attempt("pages", _pages)
    for name, port in (("port", settings.server.port), ("hand port", settings.server.hand_port)):
        yield _attempt(name, lambda port=port: _port(settings.server.host, port))  # type: ignore[misc]
    yield from _manipulator(settings)
    yield _attempt("camera", lambda: _camera(settings))


def _python() -> Check:
    found = f"Python {platform.python_version()} on {platform.system()} {platform.machine()}"
    return Check("python", sys.version_info >= (3, 11), found)


def _packages() -> Check:
    found, missing = [], []
    for name in _PACKAGES:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            missing.append(name)
    if missing:
        return Check("packages", ok=False, found=f"missing: {', '.join(missing)}: reinstall mrnav-server")
    return Check("packages", ok=True, found=", ".join(found))


def _model(settings: "Settings") -> Iterator[Check]:
    """Check the vessel model, and its policy if the model is right."""
    from mrnav_server.vision.model_store import find_model
    from mrnav_server.vision.vessel_model import load_vessel_model

    try:
        folder = find_model(settings.rig.vessel)
        vessel = load_vessel_model(folder)
    except ConfigError as error:
        yield Check("vessel model", ok=False, found=str(error))
        return
    side_mm = vessel.size_px * vessel.um_per_px / 1000.0
    yield Check("vessel model", ok=True, found=f"{vessel.name}, {side_mm:g} mm square, in {folder}")
    yield _policy(folder, vessel)


def _policy(folder: Path, vessel: "VesselMap") -> Check:
    from mrnav_server.autonomy.torchscript import verify

    verdict = verify(folder, vessel)
    if verdict.ok:
        return Check("policy", ok=True, found=f"verified for {vessel.name}")
    return Check("policy", ok=False, found=f"{verdict.reason}; MANUAL works without it, AUTO does not")


def _pages() -> str:
    from mrnav_server.app.pages import pages_folder

    return str(pages_folder())


def _port(host: str, port: int) -> str:
    from mrnav_server.app.serve import bound_socket

    with bound_socket(host, port):
        return f"{host} port {port} is free" if port else "a free port is taken at start"


def _manipulator(settings: "Settings") -> Iterator[Check]:
    """Find the manipulator that the settings name, and what else answers on its network; nothing moves."""
    from mrnav_server.app.bench import build_manipulator
    from mrnav_server.devices.micromanager.shared_core import SharedCore

    driver = settings.manipulator.driver
    if driver == "simulated":
        yield Check("manipulator", ok=True, found="simulated")
        return
    if driver.startswith("sensapex"):
        yield from _controllers(settings)
    manipulator = build_manipulator(settings, time.monotonic, SharedCore(settings.micromanager))

    async def look() -> str:
        await manipulator.open()
        try:
            tip = manipulator.tip().position
        finally:
            await manipulator.close()
        return f"{driver} reads X, Y, Z = {tip.x_um:.1f}, {tip.y_um:.1f}, {tip.z_um:.1f} µm"

    yield _attempt("manipulator", lambda: asyncio.run(look()))


def _controllers(settings: "Settings") -> Iterator[Check]:
    """List every Sensapex device that answers; none is a fault that opening the manipulator explains."""
    from mrnav_server.devices.sensapex.discovery import discover, is_emulated

    sensapex = settings.sensapex
    for found in asyncio.run(discover(sensapex.addresses, sensapex.port, time.monotonic)):
        at = ", ".join(f"{axis_um:.0f}" for axis_um in found.position_um) or "an unknown position"
        emulated = " (emulated)" if is_emulated(found.address) else ""
        seen = f"{found.address}{emulated}, firmware {found.version}, {found.axes} axes"
        yield Check(f"device {found.device_id}", ok=True, found=f"{seen}, at {at} of 0..20000 µm")


def _camera(settings: "Settings") -> str:
    if settings.rig.camera == "simulated":
        return "simulated"
    from mrnav_server.app.bench import build_camera, camera_format
    from mrnav_server.devices.micromanager.shared_core import SharedCore
    from mrnav_server.devices.pictures import FRAMES_TO_MEASURE

    camera = build_camera(settings, time.monotonic, SharedCore(settings.micromanager))
    camera.open()
    try:
        for _ in range(FRAMES_TO_MEASURE):
            camera.read(_FRAME_S)
    finally:
        camera.close()
    asked = settings.camera
    return camera_format(camera) or f"{settings.rig.camera} gives {asked.width_px}×{asked.height_px} px"


def _attempt(name: str, look: Callable[[], str]) -> Check:
    try:
        return Check(name, ok=True, found=look())
    except MrnavError as error:
        return Check(name, ok=False, found=str(error))
