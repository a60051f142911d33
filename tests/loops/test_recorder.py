import asyncio
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import namedtuple
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.loops.recorder import Recorder, RecorderConfig
from mrnav_server.loops.trial_log import (
    LOG_NAME,
    TrialHeader,
    list_trials,
    new_trial_id,
    read_header,
    read_log,
    read_trial,
    trial_folder,
)

NOW = datetime(2026, 11, 22, 17, 45, 0, tzinfo=UTC)
HEADER = TrialHeader(
    participant="P01",
    condition="with_autonomy",
    operator_kind="simulated",
    simulated_rig=True,
    software_version="0.1.0",
    configuration_sha256="c0",
    vessel="straight",
    vessel_sha256="ab",
    um_per_px=10.0,
    calibration={"floor_z_um": 500.0},
    start_px=(1.0, 2.0),
    area_id="area-1",
    area_px=(3.0, 4.0),
    area_epsilon_um=500.0,
    seeds={"rig": 7},
)


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def recorder(root: Path, clock: Clock | None = None, **config: float) -> Recorder:
    settings = RecorderConfig(**{"flush_s": 0.05, "min_free_mb": 0.0, **config})
    return Recorder(root, clock or Clock(), settings, wall_clock=lambda: NOW)


async def until_fault(trial: Recorder, *, wanted: bool) -> str:
    """Wait until the recorder's fault comes or goes."""

    def poll() -> str:
        _poll(lambda: bool(trial.fault) is wanted)
        return trial.fault

    return await asyncio.to_thread(poll)


async def test_a_trial_is_read_back_as_it_was_recorded(tmp_path: Path) -> None:
    clock = Clock()
    trial = recorder(tmp_path, clock)
    trial_id = trial.start_trial(HEADER)
    assert trial_id == "20261122-174500-001-P01"
    assert trial.trial == trial_id
    clock.now_s = 100.5
    trial.record("track", {"taken_s": 100.4, "vessel": [1.0, 2.0], "sigma_um": math.nan})
    clock.now_s = 101.0
    trial.record("hand", {"seq": 5})
    folder = await trial.end_trial()
    assert folder == tmp_path / trial_id
    log = folder / LOG_NAME
    assert read_header(log) == HEADER
    track, hand, closed = read_log(log)
    assert (track.seq, track.t_s, track.topic) == (1, 100.5, "track")
    assert track.t_wall == NOW.timestamp() + 0.5
    assert track.data == {"taken_s": 100.4, "vessel": [1.0, 2.0], "sigma_um": None}
    assert (hand.seq, hand.data) == (2, {"seq": 5})
    assert (closed.topic, closed.data) == ("closed", {"status": "ended", "lost_lines": 0})


async def test_the_file_is_json_lines_with_the_header_first(tmp_path: Path) -> None:
    trial = recorder(tmp_path)
    trial_id = trial.start_trial(HEADER)
    trial.record("mode", {"mode": "AUTO"})
    await trial.end_trial()
    header, line, _ = (tmp_path / trial_id / LOG_NAME).read_text().splitlines()
    assert json.loads(header)["schema"] == 1
    assert json.loads(header)["id"] == trial_id
    assert set(json.loads(line)) == {"seq", "t_mono_ns", "t_wall", "topic", "data"}


async def test_the_beginning_is_on_disk_before_the_trial_has_a_name(tmp_path: Path) -> None:
    trial = recorder(tmp_path, flush_s=1.0)
    beginning: dict[str, dict[str, object]] = {
        "settings": {"hand": {"gain": 0.04}},
        "state": {"control": [1.5]},
    }
    log = tmp_path / trial.start_trial(HEADER, beginning) / LOG_NAME
    trial.record("track", {"n": 1})
    assert read_header(log) == HEADER
    first = [(line.seq, line.t_s, line.topic, line.data) for line in read_log(log)]
    assert first == [(1, 100.0, "settings", beginning["settings"]), (2, 100.0, "state", beginning["state"])]
    await trial.end_trial()
    assert [line.seq for line in read_log(log)] == [1, 2, 3, 4]
    assert [path.name for path in log.parent.iterdir()] == [LOG_NAME]


async def test_a_message_that_is_no_json_costs_that_message_alone(tmp_path: Path) -> None:
    trial = recorder(tmp_path)
    log = tmp_path / trial.start_trial(HEADER) / LOG_NAME
    trial.record("track", {"n": 1})
    trial.record("track", {"n": object()})
    await asyncio.to_thread(_poll, lambda: log.stat().st_size > len(log.read_bytes().splitlines()[0]) + 1)
    trial.record("track", {"n": 3})
    await trial.end_trial()
    one, three, closed = read_log(log)
    assert (one.data, three.data) == ({"n": 1}, {"n": 3})
    assert closed.data == {"status": "ended", "lost_lines": 1}


async def test_nothing_is_recorded_outside_a_trial(tmp_path: Path) -> None:
    trial = recorder(tmp_path / "trials")
    trial.record("track", {})
    assert trial.trial is None
    assert await trial.end_trial() is None
    assert trial.fault == ""
    assert not (tmp_path / "trials").exists()
    assert list_trials(tmp_path / "trials") == []


async def test_trials_are_numbered_and_one_runs_at_a_time(tmp_path: Path) -> None:
    trial = recorder(tmp_path)
    trial.start_trial(HEADER)
    with pytest.raises(RefusedError) as caught:
        trial.start_trial(HEADER)
    assert caught.value.code == "trial_running"
    await trial.end_trial()
    assert trial.start_trial(replace(HEADER, participant="P02")) == "20261122-174500-002-P02"
    assert [(info.id[16:], info.status) for info in list_trials(tmp_path)] == [
        ("001-P01", "ended"),
        ("002-P02", "running"),
    ]
    await trial.end_trial()


@given(st.text(max_size=20).filter(lambda name: not name.isascii() or not name.replace("_", "a").isalnum()))
def test_a_participant_is_a_pseudonym_and_never_a_path(name: str) -> None:
    with pytest.raises(RefusedError, match="participant"):
        new_trial_id(Path("no/such/folder"), name, NOW)


@pytest.mark.parametrize(
    "trial_id",
    ["", ".", "..", "../secret", "/etc", "20261122-174500-001-P01/..", "20261122-174500-009-P09", "x\0"],
)
async def test_no_id_leads_out_of_the_folder(tmp_path: Path, trial_id: str) -> None:
    trial = recorder(tmp_path / "trials")
    trial.start_trial(HEADER)
    await trial.end_trial()
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / LOG_NAME).write_text("{}")
    with pytest.raises(RefusedError, match="no trial"):
        trial_folder(tmp_path / "trials", trial_id)


def test_a_link_out_of_the_folder_is_no_trial(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / LOG_NAME).write_text("{}")
    (tmp_path / "trials").mkdir()
    (tmp_path / "trials" / "20261122-174500-001-P01").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(RefusedError, match="no trial"):
        trial_folder(tmp_path / "trials", "20261122-174500-001-P01")
    assert list_trials(tmp_path / "trials") == []


async def test_a_partial_last_line_is_ignored_and_later_cut_off(tmp_path: Path) -> None:
    crashed = recorder(tmp_path)
    trial_id = crashed.start_trial(HEADER)
    crashed.record("track", {"n": 1})
    crashed.record("track", {"n": 2})
    await crashed.end_trial()
    log = tmp_path / trial_id / LOG_NAME
    log.write_bytes(log.read_bytes()[:-20])
    assert [line.data for line in read_log(log)] == [{"n": 1}, {"n": 2}]
    assert read_trial(tmp_path, trial_id).status == "running"

    assert recorder(tmp_path).recover() == [trial_id]
    assert [line.topic for line in read_log(log)] == ["track", "track", "closed"]
    assert [line.seq for line in read_log(log)] == [1, 2, 3]
    assert read_trial(tmp_path, trial_id).status == "interrupted"
    assert recorder(tmp_path).recover() == []


async def test_a_crash_after_a_very_long_line_is_marked_too(tmp_path: Path) -> None:
    crashed = recorder(tmp_path)
    trial_id = crashed.start_trial(HEADER)
    crashed.record("path", {"points_px": [[0.5, 0.25]] * 20_000})
    await crashed.end_trial()
    log = tmp_path / trial_id / LOG_NAME
    log.write_bytes(log.read_bytes()[:-20])
    assert recorder(tmp_path).recover() == [trial_id]
    assert [(line.seq, line.topic) for line in read_log(log)] == [(1, "path"), (2, "closed")]


async def test_a_damaged_line_is_named(tmp_path: Path) -> None:
    trial = recorder(tmp_path)
    trial_id = trial.start_trial(HEADER)
    trial.record("track", {"n": 1})
    await trial.end_trial()
    log = tmp_path / trial_id / LOG_NAME
    log.write_bytes(log.read_bytes().replace(b'"data":{"n":1}', b'"data":{"n":1'))
    with pytest.raises(ConfigError, match="line 2"):
        list(read_log(log))


@pytest.mark.parametrize(
    "first", [b"", b"[]\n", b"{}\n", b'{"schema":2}\n', b'{"schema":1,"topic":1,"id":2}\n']
)
def test_another_file_is_no_trial_log(tmp_path: Path, first: bytes) -> None:
    path = tmp_path / LOG_NAME
    path.write_bytes(first)
    with pytest.raises(ConfigError, match=LOG_NAME):
        read_header(path)


def test_a_trial_does_not_start_on_a_full_disk(tmp_path: Path) -> None:
    trial = recorder(tmp_path, min_free_mb=1e12)
    with pytest.raises(RefusedError, match="MB are free") as caught:
        trial.start_trial(HEADER)
    assert caught.value.code == "disk_full"
    assert trial.trial is None
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RefusedError) as caught:
        recorder(tmp_path / "file").start_trial(HEADER)
    assert caught.value.code == "disk_error"


async def test_free_space_that_runs_low_is_flagged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = namedtuple("usage", "total used free")
    trial = recorder(tmp_path, min_free_mb=1.0)
    trial.start_trial(HEADER)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(10, 9, 1))
    assert "0 MB are free" in await until_fault(trial, wanted=True)
    monkeypatch.undo()
    await until_fault(trial, wanted=False)
    await trial.end_trial()


async def test_a_full_disk_is_flagged_and_loses_nothing_once_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trial = recorder(tmp_path)
    trial_id = trial.start_trial(HEADER)
    log = tmp_path / trial_id / LOG_NAME
    room = [400]
    before = log.stat().st_size
    write = os.write

    def write_while_there_is_room(file: int, data: bytes) -> int:
        taken = write(file, data[: room[0]])
        room[0] -= taken
        if taken == 0:
            raise OSError(28, "No space left on device")
        return taken

    monkeypatch.setattr(os, "write", write_while_there_is_room)
    for number in range(50):
        trial.record("track", {"n": number})
    assert "No space left on device" in await until_fault(trial, wanted=True)
    assert log.stat().st_size == before + 400
    list(read_log(log))
    room[0] = 10**9
    await until_fault(trial, wanted=False)
    await trial.end_trial()
    assert [line.data["n"] for line in read_log(log) if line.topic == "track"] == list(range(50))


async def test_a_disk_that_stays_full_leaves_a_readable_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trial = recorder(tmp_path)
    trial_id = trial.start_trial(HEADER)

    def refuse(_file: int, _data: bytes) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "write", refuse)
    trial.record("track", {"n": 1})
    await until_fault(trial, wanted=True)
    await trial.end_trial()
    assert read_header(tmp_path / trial_id / LOG_NAME) == HEADER
    assert read_trial(tmp_path, trial_id).status == "running"


def test_settings_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match="flush_s"):
        RecorderConfig(flush_s=5.0)
    with pytest.raises(ValueError, match="min_free_mb"):
        RecorderConfig(min_free_mb=-1.0)


WRITER = """
import asyncio, sys, time
from pathlib import Path
from test_recorder import HEADER
from mrnav_server.loops.recorder import Recorder, RecorderConfig

recorder = Recorder(Path(sys.argv[1]), time.monotonic, RecorderConfig(min_free_mb=0.0))
recorder.start_trial(HEADER)
print("ready", flush=True)
while True:
    recorder.record("tick", {})
    time.sleep(0.002)
"""


def test_kill_9_loses_at_most_what_was_not_due_yet(tmp_path: Path) -> None:
    path = os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parents[2])])
    child = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path)],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": path},
    )
    assert child.stdout is not None
    with child.stdout:
        assert child.stdout.readline() == b"ready\n"
        (log,) = tmp_path.glob("*/" + LOG_NAME)
        _poll(lambda: log.stat().st_size > 30_000)
        killed_s = time.monotonic()
        child.send_signal(signal.SIGKILL)
        child.wait()
    lines = list(read_log(log))
    assert [line.seq for line in lines] == list(range(1, len(lines) + 1))
    # The promise is 0.25 s; the rest is for a test machine that schedules threads late.
    assert killed_s - lines[-1].t_s < 0.25 + 0.5
    (interrupted,) = recorder(tmp_path).recover()
    assert read_trial(tmp_path, interrupted).status == "interrupted"


def _poll(condition: Callable[[], bool]) -> None:
    """Wait for another thread or process."""
    deadline_s = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < deadline_s, "it did not happen within 30 s"
        time.sleep(0.005)
