"""The calibration sheet: a ChArUco board of known size, drawn to scale and found in pictures."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray, FloatArray
from mrnav_server.core.errors import ConfigError

_DICTIONARY = cv2.aruco.DICT_4X4_250
_MODULES = 8
"""Modules a square is wide; a marker takes six of them, four bits and its border."""
_MARKER_MODULES = 6
_MM_PER_INCH = 25.4
_A4_MM = (210.0, 297.0)
_RANGES = {"columns": (3, 22), "rows": (3, 22), "square_um": (50.0, 20_000.0)}


@dataclass(frozen=True, slots=True)
class SheetConfig:
    """The calibration sheet.

    Attributes:
        columns: Squares along x, 3..22.
        rows: Squares along y, 3..22.
        square_um: Side of a square in µm, as measured on the sheet, 50..20000.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    columns: int = 14
    rows: int = 10
    square_um: float = 1000.0

    def __post_init__(self) -> None:
        for field in fields(self):
            low, high = _RANGES[field.name]
            value = getattr(self, field.name)
            if not low <= value <= high:
                raise ConfigError(f"sheet {field.name} is {value:g}; choose it within {low:g}..{high:g}")

    @property
    def size_um(self) -> tuple[float, float]:
        """Width and height of the board in µm."""
        return self.columns * self.square_um, self.rows * self.square_um

    @property
    def module_um(self) -> float:
        """Side of the smallest black or white cell in µm."""
        return self.square_um / _MODULES


@dataclass(frozen=True)
class SheetCorners:
    """Corners of the board that were found.

    Attributes:
        image_px: Where they appear, the mean over the pictures, shape (n, 2).
        floor_um: Where they are on the sheet, shape (n, 2); the origin is its centre, x right, y down.
        expected: How many the whole board has.
    """

    image_px: FloatArray
    floor_um: FloatArray
    expected: int


def board_picture(sheet: SheetConfig, px_per_module: int = 1) -> ByteArray:
    """Return the board in black and white, exact to the module, shape (rows, columns) times 8 modules."""
    size = (sheet.columns * _MODULES * px_per_module, sheet.rows * _MODULES * px_per_module)
    return _board(sheet).generateImage(size).astype(np.uint8)


def write_sheet(sheet: SheetConfig, out: Path) -> None:
    """Write the board as a PDF at true scale, with a ruler to measure what the printer made of it.

    Raises:
        ConfigError: If the board does not fit on the page.
    """
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    width_mm, height_mm = (side * 1e-3 for side in sheet.size_um)
    page_mm = _A4_MM if width_mm <= _A4_MM[0] - 20.0 else _A4_MM[::-1]
    if width_mm > page_mm[0] - 20.0 or height_mm > page_mm[1] - 60.0:
        raise ConfigError(
            f"a sheet of {width_mm:g} x {height_mm:g} mm does not fit on A4: fewer or smaller squares do"
        )
    figure = Figure(figsize=(page_mm[0] / _MM_PER_INCH, page_mm[1] / _MM_PER_INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, page_mm[0]), ylim=(page_mm[1], 0.0))
    axes.axis("off")
    left, top, module = (page_mm[0] - width_mm) / 2.0, 30.0, sheet.module_um * 1e-3
    bits = board_picture(sheet) < 128
    for row, line in enumerate(bits):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(np.int8)))
        for start, stop in edges.reshape(-1, 2):
            corner = (left + start * module, top + row * module)
            axes.add_patch(Rectangle(corner, (stop - start) * module, module, color="black", linewidth=0.0))
    below = top + height_mm + 10.0
    axes.plot([left, left + 10.0], [below, below], color="black", linewidth=0.5)
    for tick in range(11):
        axes.plot([left + tick] * 2, [below, below - 2.0], color="black", linewidth=0.3)
    axes.text(left, below + 5.0, "10 mm", fontsize=8)
    text = (
        f"{sheet.columns} x {sheet.rows} squares of {sheet.square_um * 1e-3:g} mm, ChArUco 4x4_250. "
        "Print at 100 %, then measure the whole board: width / columns is the square's true side."
    )
    axes.text(10.0, page_mm[1] - 10.0, text, fontsize=6)
    with PdfPages(out, metadata={"Title": "Calibration sheet", "CreationDate": None}) as pdf:
        pdf.savefig(figure)


def find_sheet(grays: Sequence[ByteArray], sheet: SheetConfig) -> SheetCorners:
    """Find the board's corners; those seen in at least half of the pictures count.

    Args:
        grays: Pictures of the resting sheet, shape (height, width), uint8.
        sheet: The sheet.
    """
    detector = cv2.aruco.CharucoDetector(_board(sheet))
    seen: dict[int, list[FloatArray]] = {}
    for gray in grays:
        # OpenCV's stubs know neither that there may be none, nor that the numbers are whole.
        found: Any = detector.detectBoard(gray)
        corners, ids = found[0], found[1]
        if ids is None:
            continue
        for identity, corner in zip(ids.ravel().tolist(), corners.reshape(-1, 2), strict=True):
            seen.setdefault(int(identity), []).append(corner.astype(np.float64))
    steady = sorted(identity for identity, places in seen.items() if 2 * len(places) >= len(grays))
    inner = sheet.columns - 1
    at = np.array([(identity % inner + 1, identity // inner + 1) for identity in steady], np.float64)
    center = np.array([sheet.columns, sheet.rows]) / 2.0
    return SheetCorners(
        image_px=np.array([np.median(seen[identity], axis=0) for identity in steady]).reshape(-1, 2),
        floor_um=(at.reshape(-1, 2) - center) * sheet.square_um,
        expected=inner * (sheet.rows - 1),
    )


def _board(sheet: SheetConfig) -> cv2.aruco.CharucoBoard:
    dictionary = cv2.aruco.getPredefinedDictionary(_DICTIONARY)
    marker = sheet.square_um * _MARKER_MODULES / _MODULES
    return cv2.aruco.CharucoBoard((sheet.columns, sheet.rows), sheet.square_um, marker, dictionary)
