"""`mrnav measure robot`: the radius goes from the picture into the settings."""

import json
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner, Result

from mrnav_server.cli.main import app
from mrnav_server.cli.settings_file import store
from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.settings import load_settings


def still(radius_px: float, seed: int = 0, *, bright: bool = False) -> ByteArray:
    y, x = np.mgrid[0:300, 0:400]
    picture = 180.0 + np.random.default_rng(seed).normal(0.0, 2.0, x.shape)
    picture -= 130.0 * (0.5 - 0.5 * np.tanh(np.hypot(x - 201.3, y - 150.8) - radius_px))
    gray: ByteArray = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    return 255 - gray if bright else gray


def robot(*words: object) -> Result:
    return CliRunner().invoke(app, ["measure", "robot", *map(str, words)])


def answer(result: Result) -> dict[str, Any]:
    assert result.exit_code == 0, result.output
    told: dict[str, Any] = json.loads(result.stdout.splitlines()[-1])
    return told


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def stills(folder: Path, *, bright: bool = False) -> list[str]:
    words = []
    for seed in range(3):
        path = folder / f"still{seed}.png"
        cv2.imwrite(str(path), still(24.6, seed, bright=bright))
        words += ["--image", str(path)]
    return words


@pytest.mark.parametrize("bright", [False, True])
def test_stills_give_radius_spread_and_polarity(tmp_path: Path, bright: bool) -> None:
    told = answer(robot(*stills(tmp_path, bright=bright), "--um-per-px", 12.5, "--json"))
    assert told["radius_px"] == pytest.approx(24.6, abs=0.1)
    assert told["radius_um"] == pytest.approx(12.5 * told["radius_px"], abs=0.1)
    assert 0.0 < told["spread_px"] < 0.2
    assert told["spread_um"] == pytest.approx(12.5 * told["spread_px"], abs=0.1)
    assert told["polarity"] == ("bright" if bright else "dark")
    assert (told["pictures"], told["simulated"], told["saved"]) == (3, False, None)
    assert not Path("mrnav.toml").exists()


def test_the_simulated_camera_is_measured_and_says_so() -> None:
    result = robot()
    assert result.exit_code == 0, result.output
    assert "robot (simulated): radius 33.4" in result.stdout
    assert "robot_radius_um = 50" in result.stdout


def test_save_writes_the_settings_file_that_the_rig_reads(tmp_path: Path) -> None:
    told = answer(robot(*stills(tmp_path, bright=True), "--um-per-px", 20, "--save", "--json"))
    assert told["saved"] == "mrnav.toml"
    tracker = load_settings(None, {}).tracker
    assert tracker.robot_radius_um == told["radius_um"]
    assert tracker.polarity == "bright"
    again = answer(robot(*stills(tmp_path), "--um-per-px", 10, "--save", "--json"))
    tracker = load_settings(None, {}).tracker
    assert (tracker.robot_radius_um, tracker.polarity) == (again["radius_um"], "dark")


def test_save_leaves_everything_else_in_the_named_file(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(
        "# our bench\n[tracker]  # seen\ngate_um = 80.0 # wide\nrobot_radius_um = 400.0\n\n"
        "[camera]\nfps = 25.0\n"
    )
    told = answer(robot(*stills(tmp_path), "--um-per-px", 20, "--save", "--config", path, "--json"))
    text = path.read_text()
    assert text.startswith("# our bench\n[tracker]  # seen\n")
    assert "gate_um = 80.0 # wide\n" in text
    assert tomllib.loads(text) == {
        "tracker": {"gate_um": 80.0, "robot_radius_um": told["radius_um"], "polarity": "dark"},
        "camera": {"fps": 25.0},
    }


def test_a_variable_that_goes_before_the_file_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MRNAV_TRACKER__ROBOT_RADIUS_UM", "300")
    assert (
        "MRNAV_TRACKER__ROBOT_RADIUS_UM is set"
        in robot(*stills(tmp_path), "--um-per-px", 20, "--save").stderr
    )


def test_without_a_scale_stills_must_have_the_cameras_size(tmp_path: Path) -> None:
    error = robot(*stills(tmp_path)).exception
    assert isinstance(error, ConfigError)
    assert "--um-per-px" in str(error)


def test_what_cannot_be_measured_is_refused(tmp_path: Path) -> None:
    empty = tmp_path / "empty.png"
    cv2.imwrite(str(empty), np.full((300, 400), 128, np.uint8))
    for words, told in (
        (["--image", empty, "--um-per-px", 15], "no disc"),
        (["--image", tmp_path / "none.png", "--um-per-px", 15], "none.png"),
        (["--image", empty, "--um-per-px", 0], "--um-per-px"),
        (["--smallest-um", 500, "--largest-um", 100], "--smallest-um"),
    ):
        error = robot(*words).exception
        assert isinstance(error, ConfigError)
        assert told in str(error)


@pytest.mark.parametrize("text", ["tracker = {gate_um = 70.0}\n", "tracker.gate_um = 70.0\n", "[tracker\n"])
def test_a_file_that_is_laid_out_in_another_way_is_left_alone(tmp_path: Path, text: str) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"by hand: robot_radius_um = 501\.0"):
        store(path, "tracker", {"robot_radius_um": 501.0})
    assert path.read_text() == text


names = st.text("abcdefg_", min_size=1, max_size=6)
values = st.one_of(
    st.floats(-1e6, 1e6), st.sampled_from(["dark", "bright"]), st.booleans(), st.integers(0, 9)
)


@given(
    before=st.dictionaries(names, st.dictionaries(names, values, max_size=4), max_size=4),
    section=names,
    change=st.dictionaries(
        names, st.one_of(st.floats(-1e6, 1e6), st.sampled_from(["dark"])), min_size=1, max_size=3
    ),
)
def test_a_file_means_what_it_meant_but_for_what_was_stored(
    tmp_path_factory: pytest.TempPathFactory,
    before: dict[str, dict[str, Any]],
    section: str,
    change: dict[str, str | float],
) -> None:
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    lines = []
    for name, content in before.items():
        lines += [f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in content.items()), ""]
    path.write_text("\n".join(lines))
    store(path, section, change)
    assert tomllib.loads(path.read_text()) == {**before, section: {**before.get(section, {}), **change}}
