"""`mrnav register`: where a vessel model lies in a photograph."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mrnav_server.core.errors import ConfigError

if TYPE_CHECKING:
    from mrnav_server.core.arrays import ByteArray
    from mrnav_server.core.frames import Calibration
    from mrnav_server.core.vessel import VesselMap
    from mrnav_server.vision.registration import Registration

_SCALES = (0.98, 0.99, 1.0, 1.01, 1.02)
"""Without a calibration the scale is a guess; with one it is known."""
_TOLD_BGR = (0, 140, 255)
_FOUND_BGR = (80, 220, 60)


def register(
    image: Annotated[Path, typer.Argument(help="Photograph of the vessel, or a still from the server.")],
    model: Annotated[str, typer.Argument(help="Vessel model: a name or a folder.")],
    calibration: Annotated[
        Path | None, typer.Option(help="File of `mrnav calibrate run`; without it the scale is found, too.")
    ] = None,
    um_per_px: Annotated[
        float | None,
        typer.Option(
            help="Size of a pixel, to 2 %, without a calibration; the model fills the height if left out."
        ),
    ] = None,
    preview: Annotated[
        Path | None, typer.Option(help="Draw into this PNG where the model was supposed and is found.")
    ] = None,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on the last line.")
    ] = False,
) -> None:
    """Lay a vessel model onto a photograph; ends with 1 if its place is not certain."""
    import cv2
    import numpy as np

    from mrnav_server.vision.model_store import find_model
    from mrnav_server.vision.registration import RegistrationConfig
    from mrnav_server.vision.registration import register as registration
    from mrnav_server.vision.vessel_model import load_vessel_model

    vessel = load_vessel_model(find_model(model))
    read = cv2.imread(str(image), cv2.IMREAD_COLOR)
    if read is None:
        raise ConfigError(f"{image} is missing or no picture")
    picture = read.astype(np.uint8)
    told = _supposed(picture, vessel, calibration, um_per_px)
    scales = () if calibration is not None else _SCALES
    found = registration(picture, told, vessel, RegistrationConfig(), scales)
    pose = found.pose
    verdict = f"refused: {found.reason}" if found.reason else "accepted"
    by = "of the lumen" if found.overlap_by == "lumen" else "of the walls, for lumen and tissue look alike"
    typer.echo(f"{vessel.name} in {image.name}: {verdict}")
    typer.echo(f"  lies {pose.x_um:+.0f} µm, {pose.y_um:+.0f} µm off, turned by {pose.angle_deg:+.2f}°")
    if scales:
        typer.echo(f"  {1 / found.scale:.4f} times the supposed size of a pixel")
    typer.echo(f"  overlap {found.overlap:.3f} {by}; {found.wall_share:.0%} of the walls seen are found")
    typer.echo(f"  walls lie {found.residual_um:.1f} µm (rms) from the model's")
    if preview is not None:
        _draw(preview, picture, told, vessel, found)
    if json_output:
        typer.echo(json.dumps(_record(found)))
    if not found.accepted:
        raise typer.Exit(1)


def _supposed(
    picture: "ByteArray", vessel: "VesselMap", file: Path | None, um_per_px: float | None
) -> "Calibration":
    """Return where the model is supposed to lie in a picture."""
    from mrnav_server.core.frames import Affine2, Calibration
    from mrnav_server.vision.calibration_file import calibration_of, read_calibration

    height, width = picture.shape[:2]
    if file is not None:
        if um_per_px is not None:
            raise ConfigError("--um-per-px and --calibration contradict each other: leave one out")
        made = read_calibration(file)
        if (made.camera.width_px, made.camera.height_px) != (width, height):
            raise ConfigError(
                f"{file} is made for pictures of {made.camera.width_px} x {made.camera.height_px} px, this"
                f" one has {width} x {height}: use a still of full size"
            )
        return calibration_of(made, vessel)
    if um_per_px is not None and not 0.1 <= um_per_px <= 1000.0:
        raise ConfigError(f"--um-per-px is {um_per_px:g}: choose it within 0.1..1000")
    px = vessel.um_per_px / um_per_px if um_per_px is not None else height / vessel.size_px
    left, top = (width - vessel.size_px * px) / 2.0, (height - vessel.size_px * px) / 2.0
    return Calibration(
        image_from_vessel=Affine2.scale(px, left, top),
        stage_from_vessel=Affine2.scale(vessel.um_per_px),
        um_per_px=vessel.um_per_px,
        floor_z_um=0.0,
        magnet_offset_um=(0.0, 0.0),
        critical_height_um=0.0,
    )


def _draw(
    path: Path, picture: "ByteArray", told: "Calibration", vessel: "VesselMap", found: "Registration"
) -> None:
    import cv2
    import numpy as np

    from mrnav_server.vision.registration import outline_px, registered

    drawn = picture.copy()
    there = registered(told, vessel, found.pose, found.scale)
    for calibration, color in ((told, _TOLD_BGR), (there, _FOUND_BGR)):
        lines = [np.rint(line).astype(np.int32) for line in outline_px(calibration, vessel)]
        cv2.polylines(drawn, lines, isClosed=True, color=color, thickness=2, lineType=cv2.LINE_AA)
    if not cv2.imwrite(str(path), drawn):
        raise ConfigError(f"--preview {path} cannot be written: name a .png in a folder that exists")


def _record(found: "Registration") -> dict[str, object]:
    return {
        "accepted": found.accepted,
        "reason": found.reason,
        "pose": {
            "dx_um": round(found.pose.x_um, 2),
            "dy_um": round(found.pose.y_um, 2),
            "turn_deg": round(found.pose.angle_deg, 4),
        },
        "scale": round(found.scale, 5),
        "overlap": round(found.overlap, 4),
        "overlap_by": found.overlap_by,
        "wall_share": round(found.wall_share, 4),
        "residual_um": round(found.residual_um, 2),
        "sigma_um": round(found.sigma_um, 2),
    }
