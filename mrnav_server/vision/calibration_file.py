"""A calibration as a file: every number with unit and residuals, refused where it is not good enough."""

import hashlib
from pathlib import Path
from typing import Literal

import numpy as np
import orjson
from pydantic import ValidationError

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import Calibration
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.vessel import VesselMap
from mrnav_server.vision import floor_fit, magnet_fit, tip_fit
from mrnav_server.vision.calibration_parts import (
    CameraPart,
    Draft,
    FloorPart,
    HeightPart,
    MagnetPart,
    Part,
    TipPart,
    VesselPose,
    WaterPart,
    assembled,
)

HELD_OUT_MAX_UM = 30.0
"""A tip map that misses a place that it was not fitted to by more is refused, in a file and in a session."""


class CalibrationFile(Part):
    """A whole calibration.

    Attributes:
        format: What this file is.
        version: Raised when the format changes.
        made_by: Who made it, free text.
        made_at: When, ISO 8601; a label.
        simulated: Whether it was made on the simulated rig.
        sha256: Digest of all else, so that a file that was changed by hand is noticed.
    """

    format: Literal["mrnav-calibration"] = "mrnav-calibration"
    version: Literal[1] = 1
    made_by: str
    made_at: str
    simulated: bool
    camera: CameraPart
    water: WaterPart
    floor: FloorPart
    tip: TipPart
    height: HeightPart
    magnet: MagnetPart
    vessel: VesselPose = VesselPose()
    sha256: str = ""

    @property
    def um_per_px(self) -> float:
        """Size of a pixel on the floor, in the middle of the picture."""
        middle = self.floor.map.floor(np.array([self.camera.width_px / 2.0, self.camera.height_px / 2.0]))
        return 1.0 / float(self.floor.map.scale(middle))

    def digest(self) -> str:
        """Return the sha256 of everything but itself, 64 hex digits."""
        values = self.model_dump(mode="json", exclude={"sha256"})
        return hashlib.sha256(orjson.dumps(values, option=orjson.OPT_SORT_KEYS)).hexdigest()

    def faults(self) -> list[str]:
        """Return why the calibration is not good enough to steer by; empty if it is."""
        floor, tip = self.floor.residuals, self.tip.residuals
        held_out, magnet, height = self.tip.held_out, self.magnet, self.height
        checks = [
            ("floor.residuals.rms_um", floor.rms_um, floor_fit.RMS_MAX_UM),
            ("tip.residuals.rms_um", tip.rms_um, tip_fit.RMS_MAX_UM),
            ("tip.residuals.max_um", tip.max_um, tip_fit.MAX_UM),
            ("tip.held_out.max_um", held_out.max_um, HELD_OUT_MAX_UM),
            ("magnet.rms_um", magnet.rms_um, magnet_fit.RMS_MAX_UM),
        ]
        faults = [
            f"{name} is {value:.1f}, at most {most:g} is allowed"
            for name, value, most in checks
            if value > most
        ]
        fewest = [
            ("floor.residuals.points", floor.points, floor_fit.FEWEST_CORNERS),
            ("tip.residuals.points", tip.points, tip_fit.FEWEST_POINTS),
            ("tip.held_out.points", held_out.points, 1),
            ("magnet.approaches", magnet.approaches, magnet_fit.FEWEST_APPROACHES),
        ]
        faults += [
            f"{name} is {value}, at least {least} are needed"
            for name, value, least in fewest
            if value < least
        ]
        if self.floor.coverage < floor_fit.LEAST_COVERAGE:
            faults.append(
                f"floor.coverage is {self.floor.coverage:.2f}, {floor_fit.LEAST_COVERAGE:g} is needed"
            )
        if abs(height.jump_z_um + 0.5 * height.step_um - height.floor_z_um - height.critical_height_um) > 1.0:
            faults.append("height.critical_height_um contradicts height.jump_z_um and height.floor_z_um")
        try:
            _ = self.floor.map, self.tip.map
        except ValueError as error:
            faults.append(str(error))
        return faults


def finished(draft: Draft, *, made_by: str, made_at: str, simulated: bool) -> CalibrationFile:
    """Return the calibration of a draft that has all its parts.

    Raises:
        ConfigError: If a part is missing, or the whole is not good enough.
    """
    parts = {"floor": draft.floor, "tip": draft.tip, "height": draft.height, "magnet": draft.magnet}
    missing = [name for name, part in parts.items() if part is None]
    if missing:
        raise ConfigError(f"the calibration lacks {', '.join(missing)}: finish its steps first")
    file = CalibrationFile.model_validate(
        {"made_by": made_by, "made_at": made_at, "simulated": simulated}
        | {"camera": draft.camera, "water": draft.water, **parts}
    )
    if faults := file.faults():
        raise ConfigError(f"the calibration is not good enough: {'; '.join(faults)}")
    return file.model_copy(update={"sha256": file.digest()})


def save_calibration(file: CalibrationFile, path: Path) -> None:
    """Write a calibration, whole or not at all."""
    partial = path.with_name(path.name + ".new")
    sealed = file.model_copy(update={"sha256": file.digest()})
    partial.write_bytes(orjson.dumps(sealed.model_dump(mode="json"), option=orjson.OPT_INDENT_2) + b"\n")
    partial.replace(path)


def read_calibration(path: Path) -> CalibrationFile:
    """Read a calibration file.

    Raises:
        ConfigError: If it is missing, no calibration, changed by hand, or not good enough.
    """
    try:
        file = CalibrationFile.model_validate_json(path.read_bytes())
    except OSError as error:
        raise ConfigError(
            f"calibration {path}: cannot be read ({error.strerror}): run mrnav calibrate"
        ) from None
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        raise ConfigError(f"calibration {path}: {where}: {first['msg']}") from None
    if file.sha256 != file.digest():
        raise ConfigError(f"calibration {path}: it was changed after it was made (sha256): calibrate again")
    if faults := file.faults():
        raise ConfigError(f"calibration {path} is too bad to use: {'; '.join(faults)}: calibrate again")
    return file


def load_calibration(
    path: Path, picture: PictureFormat, vessel: VesselMap, *, simulated: bool
) -> Calibration:
    """Load the calibration that a rig runs by.

    Args:
        path: The file.
        picture: The camera's pictures, which must be of the calibrated size.
        vessel: The vessel model; it lies where the file's pose says.
        simulated: Whether the rig's camera is simulated; only a simulated one takes a simulated calibration.

    Raises:
        ConfigError: If the file is not good enough or made for something else.
    """
    file = read_calibration(path)
    made_for = (file.camera.width_px, file.camera.height_px)
    if made_for != (picture.width_px, picture.height_px):
        raise ConfigError(
            f"calibration {path} is made for pictures of {made_for[0]} x {made_for[1]} px, the camera"
            f" gives {picture.width_px} x {picture.height_px}: set them, or calibrate again"
        )
    if file.simulated and not simulated:
        raise ConfigError(f"calibration {path} was made on the simulated rig: calibrate this one")
    return calibration_of(file, vessel)


def calibration_of(file: CalibrationFile, vessel: VesselMap) -> Calibration:
    """Return a file's calibration for a vessel model that lies where the file's pose says."""
    return assembled(
        file.floor,
        file.tip,
        file.vessel.floor_from_vessel(vessel),
        vessel.um_per_px,
        vessel.size_px,
        floor_z_um=file.height.floor_z_um,
        offset_um=file.magnet.offset_um,
        critical_height_um=file.height.critical_height_um,
    )
