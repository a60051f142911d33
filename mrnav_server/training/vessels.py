"""Vessel models drawn from splines: the phantoms that ship, and test maps."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray, FloatArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.vessel import VesselMap
from mrnav_server.vision.vessel_model import save_vessel_model, vessel_map

SIZE_PX = 1800
AREA_CLEARANCE_PX = 25.0
"""Least gap between the robot's rim and the wall at a suggested critical area."""

Branch = Sequence[tuple[float, float, float]]
"""Points (x, y, width) in grid pixels that a vessel runs through."""

_BRANCHES: dict[str, Sequence[Branch]] = {
    "bifurcation": (
        ((900, 1640, 240), (880, 1350, 230), (900, 950, 220)),
        ((900, 950, 200), (700, 700, 180), (420, 480, 160), (300, 130, 150)),
        ((900, 950, 200), (1120, 720, 180), (1350, 520, 160), (1500, 130, 150)),
    ),
    "serpentine": (
        (
            *((250, 160, 160), (900, 190, 160), (1450, 160, 160), (1660, 400, 150)),
            *((1450, 640, 160), (900, 670, 160), (250, 640, 160), (140, 885, 150)),
            *((250, 1130, 160), (900, 1160, 160), (1450, 1130, 160), (1660, 1375, 150)),
            *((1450, 1620, 160), (900, 1650, 160), (250, 1620, 160)),
        ),
    ),
    "network": (
        ((900, 1720, 220), (900, 1480, 210), (880, 1300, 200)),
        ((880, 1300, 180), (560, 1150, 150), (470, 880, 140), (620, 620, 150), (880, 520, 170)),
        ((880, 1300, 180), (1180, 1180, 160), (1290, 900, 150), (1150, 640, 150), (880, 520, 170)),
        ((880, 520, 170), (900, 300, 150), (760, 130, 140)),
        ((470, 880, 140), (260, 700, 140), (180, 420, 135), (330, 170, 135)),
        ((560, 1150, 150), (330, 1330, 140), (200, 1620, 135)),
        ((1290, 900, 150), (1500, 760, 140), (1640, 500, 135), (1480, 220, 135)),
        ((1180, 1180, 150), (1430, 1340, 140), (1560, 1640, 135)),
    ),
}
_AREAS: dict[str, Sequence[tuple[float, float]]] = {
    "bifurcation": ((420, 480), (1340, 520), (885, 1250)),
    "serpentine": ((900, 1650), (900, 1160), (900, 190)),
    "network": ((900, 320), (1180, 1180), (600, 650)),
}


def names() -> list[str]:
    """Return the names of the models that can be drawn."""
    return list(_BRANCHES)


def draw(name: str) -> ByteArray:
    """Draw a model's lumen.

    Returns:
        Shape (1800, 1800), uint8, 255 inside the vessel.

    Raises:
        ConfigError: If there is no such model.
    """
    if name not in _BRANCHES:
        raise ConfigError(f"no vessel model {name!r} can be drawn; there are {', '.join(names())}")
    return paint(_BRANCHES[name])


def paint(branches: Sequence[Branch]) -> ByteArray:
    """Draw vessels along splines.

    Returns:
        Shape (1800, 1800), uint8, 255 inside the vessels.
    """
    mask = np.zeros((SIZE_PX, SIZE_PX), np.uint8)
    for branch in branches:
        for x, y, width in _catmull_rom(np.array(branch, dtype=np.float64)):
            cv2.circle(mask, (round(x), round(y)), round(width / 2), 255, cv2.FILLED)
    return mask


def generate(name: str, folder: Path) -> VesselMap:
    """Draw a model and write its folder (``mask.png`` and ``model.json``).

    Returns:
        The model, with its suggested critical areas on the vessel's centre line.

    Raises:
        ConfigError: If there is no such model.
    """
    mask = draw(name)
    bare = vessel_map(name, mask)
    areas = tuple(_widest_nearby(bare, x, y) for x, y in _AREAS[name])
    model = vessel_map(name, mask, suggested_areas=areas)
    title = f"Synthetic {name}, {SIZE_PX * model.um_per_px / 1000:.0f} mm"
    save_vessel_model(folder, model, title, "drawn from splines by `mrnav map generate`")
    return model


def _catmull_rom(points: FloatArray, samples: int = 1500) -> FloatArray:
    """Return a Catmull-Rom spline through points of shape (n, k), about ``samples`` of them."""
    ends = np.vstack([2 * points[0] - points[1], points, 2 * points[-1] - points[-2]])
    t = np.linspace(0, 1, samples // (len(points) - 1) + 1)[:, None]
    pieces = []
    for a, b, c, d in zip(ends, ends[1:], ends[2:], ends[3:], strict=False):
        cubic = (-a + 3 * b - 3 * c + d) * t**3
        pieces.append(0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + cubic))
    return np.vstack(pieces)


def _widest_nearby(model: VesselMap, x: float, y: float, reach_px: int = 25) -> VesselPoint:
    """Return the point near (x, y) that is farthest from the wall."""
    left, top = round(x) - reach_px, round(y) - reach_px
    window = model.distance_px[top : top + 2 * reach_px + 1, left : left + 2 * reach_px + 1]
    row, column = np.unravel_index(int(window.argmax()), window.shape)
    return VesselPoint(float(left + column), float(top + row))
