"""From a mask to the arrays that everything looks up, and vessel models on disk.

A model is a folder: ``mask.png`` (white lumen), ``model.json``, and beside them the policy with its
manifest and card.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mrnav_server.core.arrays import BoolArray, ByteArray, Float32Array, FloatArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.vessel import VesselMap

ROBOT_RADIUS_UM = 500.0
PLAY_UM = 50.0
"""A passage in which the robot has less room to either side is none: noise and steps of finite length would
make it touch, and the learned policies keep so far from the wall wherever they can."""


def vessel_map(
    name: str,
    mask: ByteArray,
    um_per_px: float = 10.0,
    robot_radius_um: float = ROBOT_RADIUS_UM,
    suggested_areas: tuple[VesselPoint, ...] = (),
) -> VesselMap:
    """Compute distances and the robot's free space from a mask.

    Args:
        name: The model's name.
        mask: Shape (size, size), uint8; non-zero is lumen.
        um_per_px: Size of a grid pixel in µm.
        robot_radius_um: Radius of the robot in µm.
        suggested_areas: Suggested critical areas.

    Raises:
        ConfigError: If the mask is not square, or the robot fits nowhere.
    """
    if mask.ndim != 2 or mask.shape[0] != mask.shape[1]:
        raise ConfigError(f"vessel model {name}: the mask must be square and gray, not {mask.shape}")
    lumen = (mask > 0).astype(np.uint8)
    distance = _signed_distance_px(lumen)
    radius_px = robot_radius_um / um_per_px
    free = _free_space(distance, radius_px, PLAY_UM / um_per_px)
    if not free.any():
        raise ConfigError(
            f"vessel model {name}: a robot of {2 * robot_radius_um:.0f} µm fits nowhere in it"
            f" with {PLAY_UM:.0f} µm to either side"
        )
    return VesselMap(
        name=name,
        lumen=lumen.astype(bool),
        distance_px=distance,
        um_per_px=um_per_px,
        robot_radius_px=radius_px,
        digest=hashlib.sha256(lumen.tobytes()).hexdigest(),
        free=free,
        suggested_areas=suggested_areas,
    )


def load_vessel_model(folder: Path) -> VesselMap:
    """Load a model's folder.

    Raises:
        ConfigError: If a file is missing, unreadable, or the mask is not the one the model names.
    """
    description = read_model_json(folder)
    mask = cv2.imread(str(folder / "mask.png"), cv2.IMREAD_GRAYSCALE)
    if mask is None:
        raise ConfigError(f"vessel model {folder.name}: {folder / 'mask.png'} is missing or unreadable")
    areas = tuple(VesselPoint(a["x_px"], a["y_px"]) for a in description["critical_areas"])
    model = vessel_map(
        description["name"],
        mask.astype(np.uint8),
        description["um_per_px"],
        description["robot_radius_um"],
        areas,
    )
    if model.digest != description["mask_sha256"]:
        raise ConfigError(f"vessel model {folder.name}: mask.png is not the mask that model.json names")
    return model


def save_vessel_model(folder: Path, model: VesselMap, title: str, source: str) -> None:
    """Write ``mask.png`` and ``model.json`` into a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(folder / "mask.png"), model.lumen.astype(np.uint8) * 255)
    description = {
        "name": model.name,
        "title": title,
        "source": source,
        "um_per_px": model.um_per_px,
        "robot_radius_um": model.robot_radius_px * model.um_per_px,
        "mask_sha256": model.digest,
        "critical_areas": [{"x_px": a.x_px, "y_px": a.y_px} for a in model.suggested_areas],
    }
    (folder / "model.json").write_text(json.dumps(description, indent=2) + "\n")


def read_model_json(folder: Path) -> dict[str, Any]:
    """Read a model's description.

    Raises:
        ConfigError: If it is missing, or is not JSON with the fields that are needed.
    """
    path = folder / "model.json"
    try:
        description: dict[str, Any] = json.loads(path.read_text())
    except FileNotFoundError:
        raise ConfigError(f"vessel model {folder.name}: {path} is missing") from None
    except json.JSONDecodeError as error:
        raise ConfigError(f"vessel model {folder.name}: {path} is not JSON ({error})") from None
    needed = ("name", "um_per_px", "robot_radius_um", "mask_sha256", "critical_areas")
    missing = [field for field in needed if field not in description]
    if missing:
        raise ConfigError(f"vessel model {folder.name}: {path} lacks {', '.join(missing)}")
    return description


def _free_space(distance_px: Float32Array, radius_px: float, play_px: float) -> BoolArray:
    """Return where the robot's centre may be: near the largest part where it has play."""
    roomy = largest_part(distance_px > radius_px + play_px)
    if not roomy.any():
        return roomy
    away_px = _distance_px((~roomy).astype(np.uint8))
    # Corners of the free space lie farther from the roomy part than the play.
    return largest_part((distance_px > radius_px) & (away_px <= 2 * play_px))


def largest_part(marked: BoolArray) -> BoolArray:
    """Return the largest connected part of what is marked; nothing if nothing is."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(marked.astype(np.uint8), connectivity=8)
    if count < 2:
        return np.zeros_like(marked)
    return np.asarray(labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))


def _signed_distance_px(lumen: ByteArray) -> Float32Array:
    """Return the distance to the wall, positive inside; the picture's edge is a wall."""
    padded = cv2.copyMakeBorder(lumen, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0).astype(np.uint8)
    signed = _distance_px(padded) - _distance_px(1 - padded)
    return signed[1:-1, 1:-1].astype(np.float32)


def _distance_px(marked: ByteArray) -> FloatArray:
    """Return each marked pixel's distance to the nearest one that is not, to the last bit the same each time.

    The last digits of OpenCV's result change with threads and memory, and a replay would depart by them.
    Between centres of pixels the squared distance is a whole number.
    """
    rough_px = cv2.distanceTransform(marked, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    distance_px = np.square(rough_px, dtype=np.float64)
    np.rint(distance_px, out=distance_px)
    return np.sqrt(distance_px, out=distance_px)
