"""``mrnav calibrate``: the sheet, the run on the simulated rig, and what is said of a file."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from mrnav_server.cli.main import app, main
from mrnav_server.vision.calibration_file import read_calibration

SMALL = {
    "MRNAV_CAMERA__WIDTH_PX": "800",
    "MRNAV_CAMERA__HEIGHT_PX": "600",
    "MRNAV_SIM__IMAGE_UM_PER_PX": "30",
}


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, value in SMALL.items():
        monkeypatch.setenv(name, value)


def test_the_sheet_is_written() -> None:
    done = CliRunner().invoke(app, ["calibrate", "sheet", "--out", "board.pdf", "--square-um", "2000"])
    assert done.exit_code == 0
    assert Path("board.pdf").read_bytes().startswith(b"%PDF")
    assert "28 x 20 mm" in done.stdout


def test_the_simulated_rig_calibrates_itself_and_the_file_is_told() -> None:
    done = CliRunner().invoke(app, ["calibrate", "run", "--distorted", "--out", "c.json", "--json"])
    assert done.exit_code == 0, done.output
    answer = json.loads(done.stdout.splitlines()[-1])
    assert answer["simulated"] is True
    assert answer["simulated_true_errors"]["floor_rms_um"] <= 5.0
    assert answer["simulated_true_errors"]["offset_um"] <= 50.0
    assert answer["sha256"] == read_calibration(Path("c.json")).sha256
    assert not Path("c.json.draft").exists()

    shown = CliRunner().invoke(app, ["calibrate", "show", "c.json"])
    assert shown.exit_code == 0
    assert "simulated" in shown.stdout
    assert answer["sha256"] in shown.stdout.replace("\n", "")
    checked = CliRunner().invoke(app, ["calibrate", "check", "c.json", "--json"])
    assert json.loads(checked.stdout) == {"ok": True, "file": "c.json", "simulated": True}
    # The calibrated camera was distorted; the one of the settings is not: the check on the rig notices.
    live = CliRunner().invoke(app, ["calibrate", "check", "c.json", "--live", "--json"])
    assert live.exit_code == 1
    assert json.loads(live.stdout.splitlines()[0])["held_out"]["max_um"] > 30.0
    assert "calibrate again" in live.output


def ends(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> object:
    monkeypatch.setattr("sys.argv", ["mrnav", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code


@pytest.mark.parametrize(
    ("drivers", "arguments", "said"),
    [
        (("sensapex-udp", "simulated"), (), "needs both to be real, or none"),
        (("sensapex-udp", "usb"), (), "--water-depth-um"),
        (("sensapex-udp", "usb"), ("--distorted",), "--distorted"),
    ],
)
def test_real_devices_need_what_the_simulated_rig_knows(
    drivers: tuple[str, str],
    arguments: tuple[str, ...],
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("MRNAV_MANIPULATOR__DRIVER", drivers[0])
    monkeypatch.setenv("MRNAV_RIG__CAMERA", drivers[1])
    assert ends(monkeypatch, "calibrate", "run", *arguments) == 2
    assert said in capsys.readouterr().err


def test_a_file_that_is_no_calibration_is_one_line_and_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("c.json").write_text("{}")
    assert ends(monkeypatch, "calibrate", "show", "c.json") == 2
    assert capsys.readouterr().err.count("\n") == 1
