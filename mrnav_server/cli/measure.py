"""``mrnav measure``: what the rig's settings need to know of the robot, from its pictures."""

import json
import math
import os
import statistics
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mrnav_server.cli.serve import ConfigOption
from mrnav_server.core.errors import ConfigError, DeviceError

if TYPE_CHECKING:
    from mrnav_server.core.arrays import ByteArray
    from mrnav_server.core.frames import Calibration
    from mrnav_server.settings import Settings
    from mrnav_server.vision.measure import RobotLook

measure = typer.Typer(no_args_is_help=True, help="Measure in the microscope's picture.")

_FRAMES = 15
_TRIES = 10
_READ_S = 2.0
_RADII_UM = (50.0, 1500.0)


@measure.callback()
def measures() -> None:
    """Measure in the microscope's picture."""


@measure.command()
def robot(
    image: Annotated[
        list[Path] | None,
        typer.Option(help="A still of full size instead of the camera; give several for a truer spread."),
    ] = None,
    um_per_px: Annotated[
        float | None, typer.Option(help="Size of a pixel on the floor; the calibration's if left out.")
    ] = None,
    smallest_um: Annotated[float, typer.Option(help="Least radius that is looked for, in µm.")] = _RADII_UM[
        0
    ],
    largest_um: Annotated[float, typer.Option(help="Largest one.")] = _RADII_UM[1],
    save: Annotated[
        bool, typer.Option("--save", help="Write radius and polarity into the rig's settings file.")
    ] = False,
    config: ConfigOption = None,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on the last line.")
    ] = False,
) -> None:
    """Measure the robot's radius and whether it is dark or bright, from the camera or from stills.

    Show the robot alone, in the open, in focus, away from the magnet. A server that holds the camera must
    be stopped first, or give it stills.
    """
    from mrnav_server.settings import load_settings

    if not 0.0 < smallest_um < largest_um < math.inf:
        raise ConfigError("--smallest-um and --largest-um: choose 0 < smallest < largest")
    settings = load_settings(config, os.environ)
    simulated = image is None and settings.rig.camera == "simulated"
    images, um_per_px = _pictures(settings, image, um_per_px)
    looks, refused = _looks(images, um_per_px, (smallest_um, largest_um))
    if not looks:
        raise ConfigError(f"the robot's radius cannot be measured: {refused}")
    if len({look.polarity for look in looks}) > 1:
        raise ConfigError(
            "the robot looks darker than its surroundings in some pictures and brighter in others: light it"
            " evenly"
        )
    radii_px = [look.radius_px for look in looks]
    radius_px = statistics.median(radii_px)
    spread_px = max(statistics.pstdev(radii_px), statistics.median(look.spread_px for look in looks))
    answer: dict[str, Any] = {
        "radius_px": round(radius_px, 3),
        "spread_px": round(spread_px, 3),
        "radius_um": round(radius_px * um_per_px, 1),
        "spread_um": round(spread_px * um_per_px, 1),
        "polarity": looks[0].polarity,
        "um_per_px": round(um_per_px, 4),
        "pictures": len(looks),
        "refused": len(images) - len(looks),
        "simulated": simulated,
        "saved": None,
    }
    if save:
        answer["saved"] = str(_save(config, round(radius_px * um_per_px, 1), looks[0].polarity))
    if json_output:
        typer.echo(json.dumps(answer))
        return
    origin = "simulated" if simulated else "measured"
    typer.echo(
        f"robot ({origin}): radius {radius_px:.2f} ± {spread_px:.2f} px, {answer['radius_um']} ±"
        f" {answer['spread_um']} µm, {looks[0].polarity}, in {len(looks)} of {len(images)} pictures"
    )
    if answer["saved"]:
        typer.echo(f"written into {answer['saved']}, section [tracker]")
    else:
        typer.echo(
            f"settings, section [tracker]: robot_radius_um = {answer['radius_um']}, polarity ="
            f' "{looks[0].polarity}"; --save writes them'
        )


def _pictures(
    settings: "Settings", stills: list[Path] | None, um_per_px: float | None
) -> tuple[list["ByteArray"], float]:
    """Return the pictures to measure in, and the size of their pixels on the floor."""
    import cv2
    import numpy as np

    if um_per_px is not None and not 0.01 <= um_per_px <= 1000.0:
        raise ConfigError(f"--um-per-px is {um_per_px:g}: choose it within 0.01..1000")
    if stills is None:
        return _from_camera(settings, um_per_px)
    images = []
    for path in stills:
        read = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if read is None:
            raise ConfigError(f"--image {path} is missing or no picture")
        images.append(np.asarray(read, np.uint8))
    if um_per_px is not None:
        return images, um_per_px
    calibration = _calibration(settings)
    size = settings.camera.height_px, settings.camera.width_px
    if any(picture.shape[:2] != size for picture in images):
        raise ConfigError(
            f"--image: the calibration is for pictures of {size[1]}x{size[0]} px: use stills of full size, or"
            " give --um-per-px"
        )
    return images, _floor_um_per_px(calibration)


def _calibration(settings: "Settings") -> "Calibration":
    """Return what the rig goes by; no device is opened."""
    from mrnav_server.app.bench import build_bench
    from mrnav_server.vision.model_store import find_model
    from mrnav_server.vision.vessel_model import load_vessel_model

    return build_bench(
        settings, load_vessel_model(find_model(settings.rig.vessel)), time.monotonic
    ).calibration


def _floor_um_per_px(calibration: "Calibration") -> float:
    return calibration.um_per_px / calibration.image_from_vessel.linear_scale


def _from_camera(settings: "Settings", um_per_px: float | None) -> tuple[list["ByteArray"], float]:
    """Return pictures of the rig's camera, opened and closed again."""
    from mrnav_server.app.bench import build_bench, build_camera
    from mrnav_server.core.errors import DeviceTimeoutError
    from mrnav_server.devices.base import Camera
    from mrnav_server.devices.micromanager.shared_core import SharedCore
    from mrnav_server.vision.model_store import find_model
    from mrnav_server.vision.vessel_model import load_vessel_model

    camera: Camera
    if settings.rig.camera == "simulated" or um_per_px is None:
        vessel = load_vessel_model(find_model(settings.rig.vessel))
        bench = build_bench(settings, vessel, time.monotonic)
        camera, um_per_px = bench.camera, um_per_px or _floor_um_per_px(bench.calibration)
    else:
        camera = build_camera(settings, time.monotonic, SharedCore(settings.micromanager))
    images: list[ByteArray] = []
    try:
        camera.open()
        for _ in range(_FRAMES + _TRIES):
            if len(images) == _FRAMES:
                break
            try:
                images.append(camera.read(_READ_S).image)
            except DeviceTimeoutError:
                continue
    except DeviceError as error:
        raise ConfigError(f"rig.camera {settings.rig.camera}: {error}") from error
    finally:
        camera.close()
    if not images:
        raise ConfigError(f"rig.camera {settings.rig.camera} gives no picture: check it with mrnav doctor")
    return images, um_per_px


def _looks(
    images: list["ByteArray"], um_per_px: float, radii_um: tuple[float, float]
) -> tuple[list["RobotLook"], str]:
    """Return what could be measured, and why the last of the others could not."""
    from mrnav_server.core.errors import RefusedError
    from mrnav_server.vision.measure import measure_robot

    looks, refused = [], ""
    for image in images:
        try:
            looks.append(measure_robot(image, um_per_px, radii_um))
        except RefusedError as error:
            refused = str(error)
    return looks, refused


def _save(config: Path | None, radius_um: float, polarity: str) -> Path:
    """Write radius and polarity into the settings file that the rig reads."""
    from mrnav_server.cli.settings_file import store
    from mrnav_server.settings import DEFAULT_FILE
    from mrnav_server.vision.tracker import TrackerConfig

    TrackerConfig(robot_radius_um=radius_um)
    path = config or DEFAULT_FILE
    store(path, "tracker", {"robot_radius_um": radius_um, "polarity": polarity})
    for name in ("ROBOT_RADIUS_UM", "POLARITY"):
        variable = f"MRNAV_TRACKER__{name}"
        if variable in os.environ:
            typer.echo(f"{variable} is set and goes before the file: unset it", err=True)
    return path
