"""Lumens are found in photographs and masks, and what cannot be used is refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from mrnav_server.core.arrays import BoolArray, ByteArray, FloatArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.training.photograph import cut, read_photograph
from mrnav_server.training.random_vessels import generate_random
from mrnav_server.training.segmentation import MAX_SIZE_PX, Segmentation, segment
from mrnav_server.training.vessels import draw, names
from tests.training.photographs import photographed

BRIGHT, DARK = 255, 0


def written(path: Path, picture: ByteArray) -> Path:
    assert cv2.imwrite(str(path), picture)
    return path


def found(path: Path, um_per_px: float, **options: object) -> Segmentation:
    return segment(read_photograph(path), um_per_px, **options)  # type: ignore[arg-type]


def wall_errors_px(found: BoolArray, true: BoolArray) -> FloatArray:
    """Return how far each pixel of a found wall lies from the true one."""
    walls = [
        cv2.morphologyEx(lumen.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3))) > 0
        for lumen in (found, true)
    ]
    away = cv2.distanceTransform((~walls[1]).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return away[walls[0]].astype(np.float64)


@pytest.mark.parametrize("lumen", [BRIGHT, DARK])
def test_a_mask_is_taken_as_it_is(tmp_path: Path, lumen: int) -> None:
    mask = draw("network")
    result = found(written(tmp_path / "m.png", mask if lumen == BRIGHT else 255 - mask), 10.0)
    assert result.drawn
    assert result.side == ("bright" if lumen == BRIGHT else "dark")
    np.testing.assert_array_equal(result.mask, mask)


@pytest.mark.parametrize("um_per_px", [4.0, 20.0, 45.0])
def test_a_mask_of_another_scale_keeps_its_walls_within_a_pixel(tmp_path: Path, um_per_px: float) -> None:
    size = round(12_000 / um_per_px)
    mask = np.zeros((size, size), np.uint8)
    mask[round(4000 / um_per_px) : round(6000 / um_per_px)] = 255
    result = found(written(tmp_path / "m.png", mask), um_per_px)
    rows = np.flatnonzero(result.mask[:, 600])
    assert abs(rows[0] - round(4000 / um_per_px) * um_per_px / 10) <= 1
    assert abs(rows[-1] + 1 - round(6000 / um_per_px) * um_per_px / 10) <= 1
    assert result.mask[500].all()


@pytest.mark.parametrize("dark", [True, False])
@pytest.mark.parametrize(("name", "um_per_px"), [("bifurcation", 12.0), ("network", 15.0)])
def test_a_hard_photograph_gives_nearly_the_true_lumen(
    tmp_path: Path, name: str, um_per_px: float, dark: bool
) -> None:
    mask = draw(name)
    path = tmp_path / "photograph.jpg"
    path.write_bytes(photographed(mask, um_per_px, seed=3, dark=dark).tobytes())
    result = found(path, um_per_px)
    assert result.side == ("dark" if dark else "bright")
    assert not result.drawn
    true = mask > 0
    lumen = result.mask[: len(true), : len(true)] > 0
    assert (lumen & true).sum() / (lumen | true).sum() > 0.97
    errors_px = wall_errors_px(lumen, true)
    assert np.median(errors_px) <= 1.0
    assert np.percentile(errors_px, 95) <= 8.0


def test_of_two_lumens_the_one_with_more_room_is_kept(tmp_path: Path) -> None:
    mask = np.zeros((1000, 1000), np.uint8)
    mask[100:250], mask[500:760] = 255, 255
    kept = found(written(tmp_path / "m.png", mask), 10.0).mask
    assert not kept[:400].any()
    assert kept[500:760].all()


def test_an_eyepiece_is_no_lumen(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    picture = np.full((900, 900), 150.0)
    picture[420:560] = 90.0
    picture += random.normal(0, 3, picture.shape)
    y, x = np.mgrid[:900, :900]
    picture[np.hypot(x - 450, y - 450) > 440] = 2
    result = found(written(tmp_path / "p.png", picture.clip(0, 255).astype(np.uint8)), 12.0)
    assert result.side == "dark"
    top, bottom = np.flatnonzero(result.mask[:, 540])[[0, -1]]
    assert (top, bottom + 1) == pytest.approx((504, 672), abs=3)


def test_what_is_too_large_is_cut_to_the_part_with_most_room(tmp_path: Path) -> None:
    mask = np.zeros((900, 900), np.uint8)
    mask[40:50, :], mask[:, 700:750], mask[600:720, :] = 255, 255, 255
    result = found(written(tmp_path / "m.png", mask), 100.0)
    assert result.mask.shape == (MAX_SIZE_PX, MAX_SIZE_PX)
    left, top = (corner / 100.0 for corner in result.origin_um)
    # The robot's centre keeps half its width from the walls.
    assert left <= 705
    assert left + 400 >= 745
    assert top <= 605
    assert top + 400 >= 715


def test_a_crop_is_the_part_that_it_names() -> None:
    photograph = np.arange(200 * 100 * 3, dtype=np.float32).reshape(100, 200, 3)
    np.testing.assert_array_equal(cut(photograph, (30, 10, 100, 80)), photograph[10:90, 30:130])
    with pytest.raises(
        ConfigError, match=r"crop: 150,10,100,80 .* leaves the photograph, which is 200 x 100"
    ):
        cut(photograph, (150, 10, 100, 80))
    with pytest.raises(ConfigError, match="crop: 10 x 80 px; 64 px a side are needed"):
        cut(photograph, (30, 10, 10, 80))


@pytest.mark.parametrize(
    ("row_um", "um_per_px", "radius_um", "said"),
    [
        (1500, 10.0, 500.0, None),
        (1500, 10.0, 800.0, "robot is wider than every vessel: the widest is 15"),
        (1500, 0.01, 500.0, r"scale: 0.01 µm/px is not within 0.1 to 500"),
        (1500, float("nan"), 500.0, "scale: nan"),
        (1500, 10.0, 5.0, "robot radius: 5 µm is not within 50 to 5000"),
        (1500, 2.0, 500.0, "shows 1.2 x 1.2 mm .* at least 2 mm a side are needed: check the scale"),
    ],
)
def test_what_does_not_fit_is_refused(
    row_um: float, um_per_px: float, radius_um: float, said: str | None
) -> None:
    picture = np.zeros((600, 600, 3), np.float32)
    picture[200 : 200 + round(row_um / 10)] = 1.0
    if said is None:
        segment(picture, um_per_px, radius_um)
    else:
        with pytest.raises(ConfigError, match=said):
            segment(picture, um_per_px, radius_um)


def test_pictures_without_a_lumen_are_refused(tmp_path: Path) -> None:
    even = np.full((400, 400), 120, np.uint8)
    with pytest.raises(ConfigError, match="no lumen found, the picture is uniform"):
        found(written(tmp_path / "even.png", even), 20.0)
    hairs = even.copy()
    hairs[::40] = 60
    with pytest.raises(ConfigError, match=r"no lumen found|wider than every vessel"):
        found(written(tmp_path / "hairs.png", hairs), 10.0)


def test_files_that_are_no_pictures_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="there is no file"):
        read_photograph(tmp_path / "none.png")
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(
        ConfigError, match=r"text.png is not a picture that can be read; use PNG, JPEG or TIFF"
    ):
        read_photograph(tmp_path / "text.png")
    with pytest.raises(ConfigError, match="30 x 20 px; 64 px a side are needed"):
        read_photograph(written(tmp_path / "small.png", np.zeros((20, 30), np.uint8)))


@pytest.mark.slow
def test_forty_hard_photographs(tmp_path: Path) -> None:
    overlaps: list[float] = []
    for seed in range(5):
        for name in (*names(), "random"):
            mask = generate_random(seed, tmp_path).lumen * np.uint8(255) if name == "random" else draw(name)
            for dark in (True, False):
                um_per_px, quality = ((8.0, 40), (15.0, 70), (30.0, 90))[seed % 3]
                path = tmp_path / "photograph.jpg"
                path.write_bytes(photographed(mask, um_per_px, seed, dark=dark, quality=quality).tobytes())
                lumen = found(path, um_per_px).mask[: len(mask), : len(mask)] > 0
                errors_px = wall_errors_px(lumen, mask > 0)
                assert np.median(errors_px) <= 1.0
                assert np.percentile(errors_px, 95) <= 8.0
                overlaps.append(float((lumen & (mask > 0)).sum() / (lumen | (mask > 0)).sum()))
    assert np.median(overlaps) > 0.98
    assert sum(overlap < 0.96 for overlap in overlaps) <= 2
