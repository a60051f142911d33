"""Settings of the camera: controls of a USB camera, and a film in its place."""

from pathlib import Path

import pytest

from mrnav_server.core.errors import ConfigError
from mrnav_server.settings import load_settings


@pytest.fixture(autouse=True)
def _no_file_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def fault(**env: str) -> str:
    with pytest.raises(ConfigError) as error:
        load_settings(None, env)
    return str(error.value)


def test_exposure_and_gain_come_from_a_file_and_from_variables(tmp_path: Path) -> None:
    file = tmp_path / "lab.toml"
    file.write_text("[camera]\nexposure_ms = 8\ngain = 12\n")
    read = load_settings(file, {"MRNAV_CAMERA__GAIN": "3.5"})
    assert (read.camera.exposure_ms, read.camera.gain) == (8.0, 3.5)
    defaults = load_settings(None, {})
    assert (defaults.camera.exposure_ms, defaults.camera.gain) == (0.0, None)


@pytest.mark.parametrize("value", ["-1", "nan", "inf", "much"])
@pytest.mark.parametrize("name", ["exposure_ms", "gain"])
def test_controls_have_their_ranges(name: str, value: str) -> None:
    assert f"camera.{name} (MRNAV_CAMERA__{name.upper()})" in fault(
        **{f"MRNAV_CAMERA__{name.upper()}": value}
    )


def test_a_film_needs_its_file() -> None:
    assert 'rig.camera = "file" needs camera.file: name a video file' in fault(MRNAV_RIG__CAMERA="file")
    read = load_settings(
        None, {"MRNAV_RIG__CAMERA": "file", "MRNAV_CAMERA__FILE": "film.mkv", "MRNAV_CAMERA__LOOP": "true"}
    )
    assert (read.rig.camera, read.camera.file, read.camera.loop) == ("file", "film.mkv", True)


def test_a_real_manipulator_is_not_steered_by_a_film() -> None:
    told = fault(
        MRNAV_RIG__CAMERA="file", MRNAV_CAMERA__FILE="film.mkv", MRNAV_MANIPULATOR__DRIVER="sensapex-udp"
    )
    assert 'set manipulator.driver = "simulated"' in told
