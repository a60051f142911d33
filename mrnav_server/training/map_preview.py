"""The picture that shows what was found in a photograph."""

from pathlib import Path

import cv2
import numpy as np

from mrnav_server.core.arrays import BoolArray, ByteArray, IntArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.training.map_report import MapReport, too_narrow

_SIDE_PX = 1000
_LEGEND_PX = 40
# Okabe and Ito's colours, as BGR: colour-blind readers tell them apart.
_OUTLINE = (115, 158, 0)
_CENTRE = (178, 114, 0)
_JUNCTION = (66, 228, 240)
_TIGHT = (0, 94, 213)
_AREA = (167, 121, 204)
_FREE = (233, 180, 86)
_INK = (255, 255, 255)
_PAPER = (40, 40, 40)
_SCALES_MM = (0.5, 1, 2, 5, 10)


def save_preview(path: Path, report: MapReport, photograph: ByteArray | None = None) -> None:
    """Write the picture that `draw_preview` draws.

    Raises:
        ConfigError: If it cannot be written.
    """
    _, encoded = cv2.imencode(".png", draw_preview(report, photograph))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(encoded.tobytes())
    except OSError as error:
        raise ConfigError(f"preview: {path} cannot be written ({error.strerror})") from None


def draw_preview(report: MapReport, photograph: ByteArray | None = None) -> ByteArray:
    """Draw outline, centre line, junctions, tight places, suggested areas and a scale bar.

    Args:
        report: The model in figures.
        photograph: Shape (size, size, 3), uint8, BGR, on the model's grid; the mask if left out.

    Returns:
        Shape (height, width, 3), uint8, BGR.
    """
    vessel = report.vessel
    if photograph is None:
        photograph = np.repeat((90 + vessel.lumen * np.uint8(130))[:, :, None], 3, axis=2).astype(np.uint8)
    scale = _SIDE_PX / vessel.size_px
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    picture = cv2.resize(photograph, (_SIDE_PX, _SIDE_PX), interpolation=how).astype(np.uint8)
    free = _enlarged(vessel.free)
    picture[free] = (0.75 * picture[free] + 0.25 * np.array(_FREE)).astype(np.uint8)
    outlines, _ = cv2.findContours(
        _enlarged(vessel.lumen).astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE
    )
    cv2.drawContours(picture, outlines, -1, _OUTLINE, 2)
    for branch in report.line.branches:
        points = np.rint((branch.path_px + 0.5) * scale).astype(np.int32)
        cv2.polylines(picture, [points], False, _CENTRE, 2, cv2.LINE_AA)
        for stretch in _stretches(points, too_narrow(branch, vessel)):
            cv2.polylines(picture, [stretch], False, _TIGHT, 4, cv2.LINE_AA)
    for x, y in np.rint(report.line.junctions_px * scale).astype(int):
        cv2.circle(picture, (int(x), int(y)), 7, _PAPER, 3, cv2.LINE_AA)
        cv2.circle(picture, (int(x), int(y)), 7, _JUNCTION, -1, cv2.LINE_AA)
    for area in vessel.suggested_areas:
        at = (round(area.x_px * scale), round(area.y_px * scale))
        cv2.drawMarker(picture, at, _PAPER, cv2.MARKER_DIAMOND, 24, 5, cv2.LINE_AA)
        cv2.drawMarker(picture, at, _AREA, cv2.MARKER_DIAMOND, 24, 2, cv2.LINE_AA)
    return np.vstack([picture, _legend(1000.0 / vessel.um_per_px * scale)])


def _enlarged(part: BoolArray) -> BoolArray:
    resized = cv2.resize(part.astype(np.uint8), (_SIDE_PX, _SIDE_PX), interpolation=cv2.INTER_NEAREST)
    return np.asarray(resized > 0)


def _stretches(points: IntArray, chosen: BoolArray) -> list[IntArray]:
    changes = np.flatnonzero(np.diff(np.concatenate([[0], chosen, [0]])))
    return [points[first:beyond] for first, beyond in zip(changes[::2], changes[1::2], strict=True)]


def _legend(px_per_mm: float) -> ByteArray:
    """Return a strip with a scale bar and what the colours mean."""
    strip = np.full((_LEGEND_PX, _SIDE_PX, 3), _PAPER, dtype=np.uint8)
    middle = _LEGEND_PX // 2
    length_mm = max([mm for mm in _SCALES_MM if mm * px_per_mm < 0.2 * _SIDE_PX], default=_SCALES_MM[0])
    beyond = 16 + round(length_mm * px_per_mm)
    cv2.line(strip, (16, middle), (beyond, middle), _INK, 5)
    at = _written(strip, f"{length_mm:g} mm", beyond + 10) + 30
    meanings = (
        ("wall", _OUTLINE),
        ("centre line", _CENTRE),
        ("room for the robot's centre", _FREE),
        ("junction", _JUNCTION),
        ("robot does not fit", _TIGHT),
        ("suggested area", _AREA),
    )
    for text, colour in meanings:
        cv2.circle(strip, (at, middle), 8, colour, -1, cv2.LINE_AA)
        at = _written(strip, text, at + 14) + 24
    return strip


def _written(strip: ByteArray, text: str, left: int) -> int:
    """Write on the strip; return where the text ends."""
    font, size = cv2.FONT_HERSHEY_SIMPLEX, 0.52
    (width, height), _ = cv2.getTextSize(text, font, size, 1)
    cv2.putText(strip, text, (left, (_LEGEND_PX + height) // 2), font, size, _INK, 1, cv2.LINE_AA)
    return left + width
