"""`mrnav register` on rendered photographs."""

import json
from pathlib import Path

import cv2
import pytest
from typer.testing import CliRunner

from mrnav_server.cli.main import app
from mrnav_server.core.errors import ConfigError
from tests.vision.registration_scenes import Scene, shipped


@pytest.fixture(scope="module")
def photograph(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("stills") / "still.png"
    scene = Scene.of(shipped("bifurcation"), (700.0, 400.0), -2.5)
    cv2.imwrite(str(path), scene.picture())
    return path


def test_a_photograph_is_registered_and_drawn(photograph: Path, tmp_path: Path) -> None:
    preview = tmp_path / "preview.png"
    result = CliRunner().invoke(
        app, ["register", str(photograph), "bifurcation", "--json", "--preview", str(preview)]
    )
    assert result.exit_code == 0, result.output
    record = json.loads(result.output.splitlines()[-1])
    assert record["accepted"]
    assert record["pose"]["dx_um"] == pytest.approx(700.0, abs=40.0)
    assert record["pose"]["turn_deg"] == pytest.approx(-2.5, abs=0.1)
    assert record["scale"] == pytest.approx(1.0, abs=0.002)
    drawn, plain = cv2.imread(str(preview)), cv2.imread(str(photograph))
    assert drawn is not None
    assert plain is not None
    assert (drawn != plain).any(axis=2).mean() > 0.002


def test_a_pixel_size_of_its_own_is_taken_and_corrected(photograph: Path) -> None:
    result = CliRunner().invoke(
        app, ["register", str(photograph), "bifurcation", "--um-per-px", "15.2", "--json"]
    )
    record = json.loads(result.output.splitlines()[-1])
    assert record["accepted"], record["reason"]
    assert record["scale"] == pytest.approx(15.2 / 15.0, abs=0.002)


def test_another_model_ends_with_1_and_the_reason(photograph: Path) -> None:
    result = CliRunner().invoke(app, ["register", str(photograph), "serpentine"])
    assert result.exit_code == 1
    assert "refused: " in result.output


def test_what_is_no_picture_is_named(tmp_path: Path, photograph: Path) -> None:
    nothing = tmp_path / "nothing.png"
    nothing.write_text("not a picture")
    result = CliRunner().invoke(app, ["register", str(nothing), "bifurcation"])
    assert isinstance(result.exception, ConfigError)
    assert "nothing.png" in str(result.exception)
    result = CliRunner().invoke(app, ["register", str(photograph), "bifurcation", "--um-per-px", "0"])
    assert isinstance(result.exception, ConfigError)
