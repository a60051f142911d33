"""`mrnav map`, as a person types it."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from mrnav_server.cli.map import models
from mrnav_server.core.errors import ConfigError
from mrnav_server.vision.calibration_file import save_calibration
from mrnav_server.vision.vessel_model import load_vessel_model
from tests.vision.test_calibration_file import made


def run(*arguments: str) -> str:
    result = CliRunner().invoke(models, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture
def image(tmp_path: Path) -> str:
    mask = np.zeros((600, 600), np.uint8)
    mask[200:300] = 255
    mask[290:, 250:340] = 255
    path = tmp_path / "tee.png"
    assert cv2.imwrite(str(path), mask)
    return str(path)


def test_import_ends_with_the_figures(image: str, tmp_path: Path) -> None:
    out = str(tmp_path / "model")
    text = run("import", image, "--um-per-px", "20", "--out", out, "--json")
    answer = json.loads(text.splitlines()[-1])
    assert list(answer) == ["model", "free_fraction", "junctions", "length_um"]
    assert (answer["model"], answer["junctions"]) == ("tee", 1)
    assert answer["length_um"] == pytest.approx(19_000, rel=0.02)
    free = load_vessel_model(tmp_path / "model").free
    assert answer["free_fraction"] == pytest.approx(free.mean(), abs=1e-5)
    assert "taken as a mask, bright lumen" in text


def test_import_takes_the_scale_from_a_calibration_of_that_camera(tmp_path: Path) -> None:
    file = made()
    save_calibration(file, tmp_path / "microscope.json")
    mask = np.zeros((file.camera.height_px, file.camera.width_px), np.uint8)
    mask[500:700] = 255
    for name, picture in (("whole.png", mask), ("half.png", mask[::2])):
        assert cv2.imwrite(str(tmp_path / name), picture)
    scale = ("--calibration", str(tmp_path / "microscope.json"), "--out", str(tmp_path / "model"))
    text = run("import", str(tmp_path / "whole.png"), *scale, "--json")
    long_um = json.loads(text.splitlines()[-1])["length_um"]
    assert long_um == pytest.approx(file.camera.width_px * file.um_per_px, rel=0.05)
    middle = np.array([file.camera.width_px, file.camera.height_px]) / 2.0
    two = file.floor.map.floor(middle + np.array([[-0.5, 0.0], [0.5, 0.0]]))
    assert file.um_per_px == pytest.approx(float(np.hypot(*(two[1] - two[0]))), rel=0.01)
    with pytest.raises(ConfigError, match="give --um-per-px instead"):
        run("import", str(tmp_path / "half.png"), *scale)


def test_import_crops_and_takes_the_side_that_it_is_told(image: str, tmp_path: Path) -> None:
    out = tmp_path / "model"
    options = ("--crop", "0,150,600,200", "--polarity", "dark", "--name", "below")
    assert "dark lumen" in run("import", image, "--um-per-px", "50", "--out", str(out), *options)
    assert not load_vessel_model(out).lumen[250:740, 100:1200].any()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "give the size of one pixel with --um-per-px X"),
        (("--um-per-px", "5"), "robot is wider than every vessel"),
        (("--um-per-px", "20", "--crop", "1,2"), "crop: '1,2' is not left,top,width,height"),
    ],
)
def test_import_refuses_by_name(
    image: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=said):
        run("import", image, *options)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tee.png"]


def test_show_a_shipped_model(tmp_path: Path) -> None:
    picture = tmp_path / "deep" / "network.png"
    text = run("show", "network", "--preview", str(picture), "--json")
    assert "12, 6, 6" in text
    assert "it has a policy" in text
    assert json.loads(text.splitlines()[-1])["junctions"] == 6
    assert cv2.imread(str(picture)) is not None


def test_show_says_that_there_is_no_policy(tmp_path: Path) -> None:
    out = str(tmp_path / "r")
    assert "random-3: 1800 x 1800 px" in run("generate", "random", "--seed", "3", "--out", out)
    assert f"no policy: mrnav train {out} makes one" in " ".join(run("show", out).split("\n"))


def test_a_seed_belongs_to_random_networks() -> None:
    with pytest.raises(ConfigError, match="add --seed N"):
        run("generate", "random")
    with pytest.raises(ConfigError, match="network is always the same: leave out --seed"):
        run("generate", "network", "--seed", "3")
