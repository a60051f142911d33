"""From a photograph on disk to a vessel model's folder."""

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mrnav_server.core.errors import ConfigError
from mrnav_server.training.lumen_level import Polarity, Side
from mrnav_server.training.map_preview import save_preview
from mrnav_server.training.map_report import MapReport, map_report
from mrnav_server.training.photograph import Crop, cut, read_photograph
from mrnav_server.training.segmentation import GRID_UM_PER_PX, MAX_SIZE_PX, segment
from mrnav_server.training.suggested_areas import suggest_areas
from mrnav_server.vision.vessel_model import (
    ROBOT_RADIUS_UM,
    read_model_json,
    save_vessel_model,
    vessel_map,
)

PREVIEW_FILE = "preview.png"
REPORT_FILE = "report.json"
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")


@dataclass(frozen=True, slots=True)
class Imported:
    """A model that was imported.

    Attributes:
        folder: Holds ``mask.png``, ``model.json``, ``preview.png`` and ``report.json``.
        report: The model in figures.
        side: Whether the lumen is the bright or the dark part of the photograph.
        drawn: Whether the photograph was a mask.
        notes: What the person who imports should know.
    """

    folder: Path
    report: MapReport
    side: Side
    drawn: bool
    notes: tuple[str, ...]


def import_map(
    image: Path,
    um_per_px: float,
    out: Path | None = None,
    name: str | None = None,
    crop: Crop | None = None,
    polarity: Polarity = "auto",
    robot_radius_um: float = ROBOT_RADIUS_UM,
) -> Imported:
    """Turn a photograph or a mask into a vessel model.

    Args:
        image: The picture.
        um_per_px: Size of one of its pixels in µm.
        out: The model's folder; one named like the model by default.
        name: The model's name; the picture's by default.
        crop: The part of the picture that counts; all of it by default.
        polarity: Whether the lumen is bright or dark.
        robot_radius_um: Radius of the robot in µm.

    Raises:
        ConfigError: If there is no usable lumen in it, or the folder holds another model's policy.
    """
    name = _checked_name(name) if name is not None else _name_of(image)
    photograph = read_photograph(image)
    if crop is not None:
        photograph = cut(photograph, crop)
    found = segment(photograph, um_per_px, robot_radius_um, polarity)
    bare = vessel_map(name, found.mask, GRID_UM_PER_PX, robot_radius_um)
    folder = out if out is not None else Path(name)
    _check_folder(folder, bare.digest)
    measured = map_report(bare)
    points = np.vstack([branch.path_px for branch in measured.line.branches]).astype(np.float64)
    vessel = replace(bare, suggested_areas=suggest_areas(bare, points))
    report = replace(measured, vessel=vessel)
    source = f"imported by `mrnav map import` from {image.name} at {um_per_px:g} µm/px, {found.side} lumen"
    if crop is not None:
        source += f", crop {','.join(map(str, crop))}"
    save_vessel_model(folder, vessel, f"{name}, {vessel.size_px * GRID_UM_PER_PX / 1000:.0f} mm", source)
    save_preview(folder / PREVIEW_FILE, report, found.photograph)
    notes = []
    if max(found.shown_mm) * 1000 > MAX_SIZE_PX * GRID_UM_PER_PX:
        left, top = (corner / um_per_px for corner in found.origin_um)
        side = vessel.size_px * GRID_UM_PER_PX / um_per_px
        notes.append(
            f"the picture shows {found.shown_mm[0]:.0f} x {found.shown_mm[1]:.0f} mm, a model at most"
            f" {MAX_SIZE_PX * GRID_UM_PER_PX / 1000:.0f} mm: kept is the part with most room for the robot,"
            f" {side:.0f} px wide from ({left:.0f}, {top:.0f}); --crop chooses another"
        )
    done = Imported(folder, report, found.side, found.drawn, (*notes, *report_notes(report)))
    told = report.details() | {"drawn": done.drawn, "side": done.side, "notes": done.notes}
    (folder / REPORT_FILE).write_text(json.dumps(told, indent=1))
    return done


def report_notes(report: MapReport) -> tuple[str, ...]:
    """Return what a report should make a person look at."""
    notes = []
    if report.reached_um < 0.9 * report.length_um:
        notes.append(
            f"the robot reaches {report.reached_um / report.length_um:.0%} of the centre line;"
            " the policy never leaves that part"
        )
    if report.training_memory_gb > 4.0:
        notes.append(
            f"training would need about {report.training_memory_gb:.0f} GB of memory: cut a part out with"
            " --crop, or check the scale"
        )
    return tuple(notes)


def _name_of(image: Path) -> str:
    name = re.sub(r"[^a-z0-9_-]+", "-", image.stem.lower()).strip("-_")[:64]
    return _checked_name(name or "vessel")


def _checked_name(name: str) -> str:
    if not _NAME.fullmatch(name):
        raise ConfigError(f"name: {name!r} may have small letters, digits, - and _, 64 at most, letter first")
    return name


def _check_folder(folder: Path, digest: str) -> None:
    if not (folder / "model.json").is_file():
        return
    if (folder / "policy.pt").exists() and read_model_json(folder)["mask_sha256"] != digest:
        raise ConfigError(
            f"{folder} holds the policy of another vessel: name another folder with --out, or remove it"
        )
