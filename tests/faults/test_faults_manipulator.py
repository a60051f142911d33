"""What the rig does when its manipulator's controller fails: a server and an emulator, each a process.

Orders and reasons only, under a generous ceiling; `mrnav bench manipulator` measures the milliseconds.
"""

import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.emulated_rig import PATIENT, EmulatedRig
from tests.rig_process import MRNAV, wait_for

CEILING_S = 2.0


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatedRig]:
    with EmulatedRig(tmp_path_factory.mktemp("emulated"), PATIENT) as emulated:
        emulated.prepare()
        yield emulated


@pytest.fixture
def moving(bench: EmulatedRig) -> Iterator[EmulatedRig]:
    """The rig in AUTO, in motion; sound and disarmed afterwards."""
    bench.go()
    yield bench
    bench.recover()


@pytest.mark.parametrize(
    ("knobs", "reason"),
    [
        ({"mute": True}, "silent|answered|acknowledge"),
        ({"stall": "xy"}, "does not move|does not follow|not where it was told"),
        ({"stall": "y"}, "does not move|does not follow|not where it was told"),
        ({"offset_um": [0.0, 80.0, 0.0]}, "not where it was told|rests"),
        ({"freeze_reading": True}, "does not move|does not follow|not where it was told"),
        ({"calibration_lost": True}, "calibration"),
        ({"latency_ms": 900.0}, "silent|answered|acknowledge"),
        ({"latency_ms": 60.0, "jitter_ms": 2000.0}, "silent|answered|acknowledge|does not"),
        ({"drop_acks": 1_000_000}, "acknowledge|silent|answered"),
        ({"reboot": True}, "silent|started anew|answered|acknowledge"),
    ],
    ids=lambda value: "+".join(value) if isinstance(value, dict) else None,
)
def test_a_fault_of_the_controller_ends_in_fault_with_its_reason(
    moving: EmulatedRig, knobs: dict[str, object], reason: str
) -> None:
    began_s = time.monotonic()
    moving.emulator.turn(**knobs)
    moving.rig.until(lambda s: s["mode"] == "FAULT", "FAULT", CEILING_S)
    assert re.search(reason, moving.rig.state["reason"]), moving.rig.state["reason"]
    assert moving.stops(began_s)
    wait_for(lambda: not moving.truth()["moving"], CEILING_S, "rest")


@pytest.mark.parametrize(
    ("knobs", "told"),
    [
        ({"lose_completion": True}, "does not say that a move has ended"),
        ({"no_status": True}, "does not say when it moves"),
    ],
    ids=["lose_completion", "no_status"],
)
def test_notifications_that_are_missing_are_told_and_the_position_decides(
    moving: EmulatedRig, knobs: dict[str, object], told: str
) -> None:
    moving.emulator.turn(**knobs)
    moving.rig.until(lambda s: told in s["reason"], "the warning", 20.0)
    moving.rig.until(lambda s: s["mode"] in ("MANUAL", "HOLD"), "the end of AUTO", 20.0)


def test_requests_that_are_lost_now_and_then_are_told_and_do_not_end_the_motion(moving: EmulatedRig) -> None:
    def lose_some() -> bool:
        moving.emulator.turn(drop_requests=3)
        time.sleep(0.2)
        return "without an answer" in moving.rig.state["reason"]

    wait_for(lose_some, 20.0, "the warning")
    moving.emulator.turn(drop_requests=0)
    moving.rig.until(lambda s: s["mode"] in ("MANUAL", "HOLD"), "the end of AUTO", 20.0)


def test_a_killed_server_is_stopped_by_the_supervisor_which_says_so_at_the_next_start(tmp_path: Path) -> None:
    with EmulatedRig(tmp_path, PATIENT) as emulated:
        emulated.prepare()
        emulated.go()
        killed_s = time.monotonic()
        emulated.rig.process.kill()
        wait_for(lambda: bool(emulated.stops(killed_s)), CEILING_S, "STOP")
        wait_for(lambda: not emulated.truth()["moving"], CEILING_S, "rest")
        report = tmp_path / "trials" / "supervisor.jsonl"
        wait_for(lambda: report.exists() and '"reason": "killed"' in report.read_text(), 5.0, "the report")
        emulated.rig.end()
        again = tmp_path / "again"
        again.mkdir()
        (again / "trials").symlink_to(tmp_path / "trials")
        where = {"MRNAV_SENSAPEX__ADDRESS": emulated.emulator.host}
        emulated.rig = type(emulated.rig)(again, **where, **emulated.settings)
        said = (again / "stderr.txt").read_text()
        assert "the supervisor stopped the manipulator" in said
        assert "the server was killed" in said


def test_a_frozen_server_is_stopped_and_faults_when_it_wakes(tmp_path: Path) -> None:
    with EmulatedRig(tmp_path, PATIENT) as emulated:
        emulated.prepare()
        emulated.go()
        frozen_s = time.monotonic()
        emulated.rig.process.send_signal(signal.SIGSTOP)
        wait_for(lambda: bool(emulated.stops(frozen_s)), CEILING_S, "STOP")
        wait_for(lambda: not emulated.truth()["moving"], CEILING_S, "rest")
        emulated.rig.process.send_signal(signal.SIGCONT)
        emulated.rig.until(lambda s: s["mode"] == "FAULT", "FAULT", 10.0)
        assert "supervisor" in emulated.rig.state["reason"]


def test_mrnav_stop_stops_the_controller_and_the_server(tmp_path: Path) -> None:
    with EmulatedRig(tmp_path, PATIENT) as emulated:
        emulated.prepare()
        emulated.go()
        asked_s = time.monotonic()
        settings = {
            "MRNAV_MANIPULATOR__DRIVER": "sensapex-udp",
            "MRNAV_SENSAPEX__ADDRESS": emulated.emulator.host,
        }
        done = subprocess.run(
            [*MRNAV, "stop"], env=os.environ | settings, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        assert emulated.stops(asked_s)
        emulated.rig.until(lambda s: s["mode"] == "STOP", "STOP", CEILING_S)
        assert not emulated.truth()["moving"]
