"""The registration that a rig goes by, kept over restarts."""

import hashlib
from pathlib import Path
from typing import Literal

import orjson
from pydantic import ValidationError

from mrnav_server.core.errors import ConfigError
from mrnav_server.vision.calibration_parts import Finite, NotNegative, Part, VesselPose

_NAME = "registration.json"


class RegistrationRecord(Part):
    """A registration that was accepted.

    Attributes:
        format: What this file is.
        version: Raised when the format changes.
        made_for: Digest of the calibration, the vessel model and the rig that it belongs to.
        pose: Where the vessel lies, relative to that calibration.
        by: Who found it: the picture, or somebody's hand.
        overlap: Dice coefficient of seen and modelled lumen, or the share of the walls that was found.
        overlap_by: Which of the two.
        residual_um: Root mean square distance of the walls; None by hand.
    """

    format: Literal["mrnav-registration"] = "mrnav-registration"
    version: Literal[1] = 1
    made_for: str
    pose: VesselPose
    by: Literal["auto", "hand"]
    overlap: Finite | None
    overlap_by: Literal["lumen", "wall"]
    residual_um: NotNegative | None


def digest_of(*parts: object) -> str:
    """Return the sha256 of whatever a registration belongs to, 64 hex digits."""
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def save_registration(root: Path, record: RegistrationRecord) -> None:
    """Write a registration into a folder, whole or not at all.

    Raises:
        ConfigError: If it cannot be written.
    """
    path = root / _NAME
    partial = path.with_name(path.name + ".new")
    try:
        root.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(orjson.dumps(record.model_dump(mode="json"), option=orjson.OPT_INDENT_2) + b"\n")
        partial.replace(path)
    except OSError as error:
        raise ConfigError(f"{path} cannot be written ({error.strerror}): free the disk") from None


def load_registration(root: Path, made_for: str) -> RegistrationRecord | None:
    """Return the registration of a folder; None if there is none.

    Raises:
        ConfigError: If it is unreadable, or belongs to another calibration, vessel model or rig.
    """
    path = root / _NAME
    if not path.is_file():
        return None
    try:
        record = RegistrationRecord.model_validate_json(path.read_bytes())
    except (OSError, ValidationError):
        raise ConfigError(f"{path} is no registration: register the vessel") from None
    if record.made_for != made_for:
        raise ConfigError(f"{path} belongs to another calibration, vessel model or rig: register the vessel")
    return record
