"""The command itself: its commands, its errors, and the doctor."""

import json
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from mrnav_server import __version__
from mrnav_server.cli.main import app, main


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MRNAV_SERVER__PORT", "0")
    monkeypatch.setenv("MRNAV_SERVER__HAND_PORT", "0")


def ends(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> object:
    monkeypatch.setattr(sys, "argv", ["mrnav", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    return end.value.code


def test_every_command_explains_itself() -> None:
    for command in ("serve", "demo", "operator", "doctor", "train", "evaluate", "report", "map"):
        result = CliRunner().invoke(app, [command, "--help"])
        assert result.exit_code == 0, result.output
    assert CliRunner().invoke(app, ["--version"]).stdout.strip() == __version__


def test_a_wrong_configuration_is_one_line_and_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("MRNAV_SERVER__PROT", "1")
    assert ends(monkeypatch, "serve", "--config", "no.toml") == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    for part in ("2 faults", "no.toml does not exist", "server.prot (MRNAV_SERVER__PROT)"):
        assert part in told


def test_a_taken_port_is_one_line_and_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = str(other.getsockname()[1])
        monkeypatch.setenv("MRNAV_SERVER__PORT", port)
        assert ends(monkeypatch, "serve") == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert f"port {port}" in told


def test_an_unknown_vessel_model_is_one_line_and_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("MRNAV_RIG__VESSEL", "aorta")
    assert ends(monkeypatch, "serve") == 2
    assert "'aorta'" in capsys.readouterr().err


def examined() -> tuple[int, dict[str, bool]]:
    result = CliRunner().invoke(app, ["doctor", "--json"])
    answer = json.loads(result.stdout)
    assert answer["ok"] is (result.exit_code == 0)
    return result.exit_code, {check["name"]: check["ok"] for check in answer["checks"]}


def test_the_doctor_finds_this_checkout_healthy() -> None:
    code, checks = examined()
    assert code == 0, checks
    assert set(checks) == {
        "python",
        "packages",
        "settings",
        "vessel model",
        "policy",
        "pages",
        "port",
        "hand port",
        "manipulator",
        "camera",
    }


def test_the_doctor_names_what_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        monkeypatch.setenv("MRNAV_SERVER__PORT", str(other.getsockname()[1]))
        monkeypatch.setenv("MRNAV_RIG__VESSEL", "aorta")
        code, checks = examined()
    assert code == 1
    assert {name for name, ok in checks.items() if not ok} == {"vessel model", "port"}
    monkeypatch.setenv("MRNAV_X", "1")
    assert examined()[1]["settings"] is False


def test_the_doctor_tries_the_camera_that_is_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MRNAV_RIG__CAMERA", "usb")
    monkeypatch.setenv("MRNAV_CAMERA__INDEX", "97")
    result = CliRunner().invoke(app, ["doctor", "--json"])
    camera = next(check for check in json.loads(result.stdout)["checks"] if check["name"] == "camera")
    assert (result.exit_code, camera["ok"]) == (1, False)
    assert "USB camera 97 cannot be opened: /dev/video97 does not exist" in camera["found"]


def test_the_doctor_prints_a_table() -> None:
    result = CliRunner().invoke(app, ["doctor"])
    assert result.exit_code == 0
    assert "vessel model" in result.stdout


def test_a_command_whose_extra_is_missing_names_it() -> None:
    hidden = (
        "import sys; sys.modules['matplotlib'] = None; sys.argv = ['mrnav', 'demo', '--help']\n"
        "import mrnav_server.cli.main as main\n"
        "def broken(): import matplotlib.axes\n"
        "main.app = broken\n"
        "main.main()"
    )
    done = subprocess.run([sys.executable, "-c", hidden], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.strip() == "error: this needs matplotlib: pip install 'mrnav-server[study]'"
