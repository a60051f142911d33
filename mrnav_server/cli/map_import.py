"""`mrnav map import`: a vessel model from a photograph."""

import json
from pathlib import Path
from typing import Annotated, Literal

import typer

from mrnav_server.cli.map_show import print_report
from mrnav_server.core.errors import ConfigError


def import_model(
    image: Annotated[Path, typer.Argument(help="Photograph or mask: PNG, JPEG or TIFF.")],
    um_per_px: Annotated[
        float | None, typer.Option(metavar="X", help="Size of one of its pixels in µm.")
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="Calibration of the microscope that took it, in place of the size.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="The model's folder; ./NAME if left out.")] = None,
    name: Annotated[str | None, typer.Option(help="The model's name; the picture's if left out.")] = None,
    crop: Annotated[
        str | None, typer.Option(metavar="X,Y,W,H", help="The part that counts, in pixels of the picture.")
    ] = None,
    polarity: Annotated[
        Literal["auto", "bright", "dark"], typer.Option(help="Whether the lumen is bright or dark.")
    ] = "auto",
    robot_radius_um: Annotated[float, typer.Option(help="Radius of the robot in µm.")] = 500.0,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on the last line.")
    ] = False,
) -> None:
    """Turn a photograph of a printed vessel, or a mask, into a vessel model, with a report and a preview."""
    from mrnav_server.training.map_import import PREVIEW_FILE, import_map

    if calibration is not None and um_per_px is None:
        um_per_px = _scale_of(calibration, image)
    elif calibration is not None or um_per_px is None:
        raise ConfigError(
            "scale: give the size of one pixel with --um-per-px X, or the microscope's --calibration FILE,"
            " not both; measure a known length in the photograph, and divide it in µm by its pixels"
        )
    found = import_map(image, um_per_px, out, name, _parsed(crop), polarity, robot_radius_um)
    what = "a mask" if found.drawn else "a photograph"
    print_report(found.report, f"taken as {what}, {found.side} lumen", found.notes)
    typer.echo(f"{found.report.vessel.name} is in {found.folder}; look at {found.folder / PREVIEW_FILE}")
    if json_output:
        typer.echo(json.dumps(found.report.record()))


def _scale_of(calibration: Path, image: Path) -> float:
    """Return µm per pixel in the middle of the calibrated pictures, if the photograph is one of them."""
    from mrnav_server.training.photograph import read_photograph
    from mrnav_server.vision.calibration_file import read_calibration

    file = read_calibration(calibration)
    height, width = read_photograph(image).shape[:2]
    if (width, height) != (file.camera.width_px, file.camera.height_px):
        asked = f"{file.camera.width_px} x {file.camera.height_px} px"
        raise ConfigError(
            f"calibration: {calibration} is for pictures of {asked}, {image} has {width} x {height}:"
            " give --um-per-px instead"
        )
    return file.um_per_px


def _parsed(crop: str | None) -> tuple[int, int, int, int] | None:
    if crop is None:
        return None
    try:
        left, top, width, height = (int(part) for part in crop.split(","))
    except ValueError:
        raise ConfigError(
            f"crop: {crop!r} is not left,top,width,height in pixels, such as 100,50,640,480"
        ) from None
    return left, top, width, height
