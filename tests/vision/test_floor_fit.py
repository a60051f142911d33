"""The sheet and the floor map: corners are found true to parts of a pixel, and bad sheets are refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrnav_server.core.arrays import ByteArray, FloatArray
from mrnav_server.core.camera_map import FloorMap
from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.core.picture import PictureFormat
from mrnav_server.vision.charuco import SheetConfig, SheetCorners, board_picture, find_sheet, write_sheet
from mrnav_server.vision.floor_fit import FloorFit, fit_floor

PICTURE = PictureFormat()
TRUE = FloorMap(
    (0.066, -0.001, 790.0, 0.0008, 0.067, 610.0, 5e-7, -4e-7, 1.0), (799.5, 599.5), -0.012, 1000.0
)
LATTICE_UM = (
    np.stack(np.meshgrid(np.arange(-6.0, 7.0), np.arange(-4.0, 5.0)), axis=-1).reshape(-1, 2) * 1000.0
)


def corners(
    noise_px: float = 0.05, seed: int = 0, lattice_um: FloatArray = LATTICE_UM, true: FloorMap = TRUE
) -> SheetCorners:
    noise = np.random.default_rng(seed).normal(0.0, noise_px, lattice_um.shape)
    return SheetCorners(true.image(lattice_um) + noise, lattice_um, len(LATTICE_UM))


def error_um(fit: FloorFit, true: FloorMap = TRUE) -> float:
    grid = np.stack(np.meshgrid(np.linspace(-6, 6, 13), np.linspace(-6, 6, 13)), axis=-1).reshape(-1, 2) * 1e3
    return float(np.linalg.norm(fit.map.floor(true.image(grid)) - grid, axis=1).max())


@settings(max_examples=15, deadline=None)
@given(
    radial=st.floats(-0.08, 0.08),
    px=st.floats(-2e-6, 2e-6),
    py=st.floats(-2e-6, 2e-6),
    x_px=st.floats(770, 830),
)
def test_exact_corners_give_the_map_back(radial: float, px: float, py: float, x_px: float) -> None:
    true = FloorMap((0.066, -0.001, 790.0, 0.0008, 0.067, 610.0, px, py, 1.0), (x_px, 590.0), radial, 1000.0)
    fit = fit_floor(corners(0.0, true=true), PICTURE)
    # The axis itself is hardly to be seen in a weak distortion; the map is.
    assert error_um(fit, true) < 1.0
    assert fit.residuals.max_um < 0.5


def test_the_residual_is_the_noise_whatever_was_fitted() -> None:
    rms = [fit_floor(corners(0.1, seed), PICTURE).residuals.rms_um for seed in range(8)]
    # 0.1 px in x and in y of 15 µm each.
    assert np.mean(rms) == pytest.approx(0.1 * np.sqrt(2) * 15.0, rel=0.06)
    fit = fit_floor(corners(0.1), PICTURE)
    assert fit.residuals.rms_um <= fit.residuals.leave_one_out_um <= fit.residuals.leave_one_out_max_um
    assert error_um(fit) < 3.0


def test_the_spread_at_the_edge_is_what_other_noise_would_give() -> None:
    edge_px = np.array([[0.0, 0.0]])
    fits = [fit_floor(corners(0.1, seed), PICTURE) for seed in range(40)]
    found = np.array([fit.map.floor(edge_px)[0] for fit in fits])
    spread = float(np.sqrt(np.linalg.eigvalsh(np.cov(found.T))[-1]))
    assert 0.4 * spread < np.mean([fit.edge_sigma_um for fit in fits]) < 2.5 * spread


def test_leave_one_out_is_what_refitting_gives() -> None:
    whole = corners(0.1)
    fit = fit_floor(whole, PICTURE)
    misses = []
    for left_out in range(0, len(LATTICE_UM), 9):
        kept = np.arange(len(LATTICE_UM)) != left_out
        other = fit_floor(
            SheetCorners(whole.image_px[kept], whole.floor_um[kept], whole.expected), PICTURE
        ).map
        misses.append(other.floor(whole.image_px[left_out]) - LATTICE_UM[left_out])
    refitted_um = float(np.sqrt(np.mean(np.sum(np.square(misses), axis=1))))
    assert refitted_um == pytest.approx(fit.residuals.leave_one_out_um, rel=0.35)


def test_outliers_are_left_out_and_counted() -> None:
    bad = corners(0.03)
    bad.image_px[[5, 40, 77]] += [[9.0, 0.0], [0.0, -3.0], [1.5, 1.5]]
    fit = fit_floor(bad, PICTURE)
    assert fit.residuals.rejected == 3
    assert error_um(fit) < 1.0


def test_bad_sheets_are_refused() -> None:
    few = corners(lattice_um=LATTICE_UM[:39])
    with pytest.raises(RefusedError, match="39 of 117 corners"):
        fit_floor(few, PICTURE)
    small = SheetCorners(*(lambda c: (c.image_px, c.floor_um, 117))(corners(lattice_um=LATTICE_UM * 0.4)))
    with pytest.raises(RefusedError, match="% of the picture"):
        fit_floor(small, PICTURE)
    with pytest.raises(RefusedError, match="µm RMS"):
        fit_floor(corners(0.6), PICTURE)
    # A curled sheet: its edge stands up.
    bent = corners()
    bent.image_px[:, 0] += 4.0 * np.maximum(LATTICE_UM[:, 0] / 6000.0, 0.0) ** 4
    with pytest.raises(RefusedError, match=r"µm RMS|contradict"):
        fit_floor(bent, PICTURE)
    mixed = corners()
    mixed.image_px[:40] = mixed.image_px[:40][::-1]
    with pytest.raises(RefusedError, match=r"contradict|µm RMS"):
        fit_floor(mixed, PICTURE)


def shown(sheet: SheetConfig, noise: float = 3.0) -> ByteArray:
    """Return a picture of the sheet, drawn flat at 15 µm a pixel and shifted by parts of a pixel."""
    fine = 8
    board = np.kron(board_picture(sheet), np.ones((fine, fine), np.uint8))
    scale = sheet.module_um / fine / 15.0
    matrix = np.array([[scale, 0.0, 333.37], [0.0, scale, 266.71]])
    picture = cv2.warpAffine(board, matrix, (1600, 1200), flags=cv2.INTER_LINEAR, borderValue=255.0)
    picture = 40.0 + 0.7 * cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 1.0)
    noisy = picture + np.random.default_rng(2).normal(0.0, noise, picture.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


def test_corners_are_found_to_parts_of_a_pixel() -> None:
    sheet = SheetConfig()
    found = find_sheet([shown(sheet)], sheet)
    assert len(found.image_px) == found.expected == 117
    scale = 1.0 / 15.0
    # Texel (0, 0) is centred on the offset, so the board's own corner lies half a texel before it.
    half_texel = 0.5 * sheet.module_um / 8 / 15.0
    middle = np.array([333.37, 266.71]) - half_texel + np.array(sheet.size_um) / 2.0 * scale
    off_px = found.image_px - (middle + found.floor_um * scale)
    assert np.sqrt(np.mean(off_px**2)) < 0.1
    assert np.abs(off_px.mean(axis=0)).max() < 0.03


def test_a_picture_without_the_sheet_has_no_corners() -> None:
    empty = np.full((1200, 1600), 128, np.uint8)
    found = find_sheet([empty, empty], SheetConfig())
    assert found.image_px.shape == found.floor_um.shape == (0, 2)
    with pytest.raises(RefusedError, match="0 of 117"):
        fit_floor(found, PICTURE)


def test_a_corner_seen_in_few_pictures_does_not_count() -> None:
    sheet = SheetConfig()
    empty = np.full((1200, 1600), 128, np.uint8)
    assert len(find_sheet([shown(sheet), empty, empty], sheet).image_px) == 0
    assert len(find_sheet([shown(sheet), empty], sheet).image_px) == 117


def test_the_pdf_is_true_to_scale(tmp_path: Path) -> None:
    out = tmp_path / "sheet.pdf"
    write_sheet(SheetConfig(columns=5, rows=4, square_um=8000.0), out)
    page = out.read_bytes()
    assert page.startswith(b"%PDF")
    points_per_mm = 72.0 / 25.4
    box = page[page.index(b"/MediaBox") :].split(b"]")[0].split(b"[")[1].split()
    assert [float(v) for v in box[2:]] == pytest.approx([210 * points_per_mm, 297 * points_per_mm], abs=0.2)


def test_the_pdfs_black_cells_are_the_boards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from matplotlib.axes import Axes
    from matplotlib.patches import Rectangle

    drawn: list[tuple[float, float, float, float]] = []
    real = Axes.add_patch

    def noted(self: Axes, patch: Rectangle) -> object:
        drawn.append((*patch.get_xy(), patch.get_width(), patch.get_height()))
        return real(self, patch)

    monkeypatch.setattr(Axes, "add_patch", noted)
    sheet = SheetConfig(columns=5, rows=4, square_um=8000.0)
    write_sheet(sheet, tmp_path / "sheet.pdf")
    cells = np.array(drawn)
    black = np.count_nonzero(board_picture(sheet) < 128)
    assert cells[:, 2].sum() * cells[0, 3] == pytest.approx(black * (sheet.module_um * 1e-3) ** 2)
    assert cells[:, 0].min() == pytest.approx(105.0 - 20.0)
    assert (cells[:, 0] + cells[:, 2]).max() == pytest.approx(105.0 + 20.0)


def test_a_sheet_larger_than_the_page_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="A4"):
        write_sheet(SheetConfig(columns=20, rows=20, square_um=15_000.0), tmp_path / "sheet.pdf")
    with pytest.raises(ConfigError, match="square_um"):
        SheetConfig(square_um=0.0)
