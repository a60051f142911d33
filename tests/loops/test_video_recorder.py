"""Films of trials: what is in the file is what was handed over, at the times it was taken."""

import resource
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrnav_server.loops.video_recorder import (
    FIRST_TAKEN_KEY,
    MAX_WAITING_FRAMES,
    VideoConfig,
    VideoRecorder,
)
from tests.films import packets, played, tag

UNEVEN_S = (1000.1234, 1000.1571, 1000.1899, 1000.3, 1001.9004, 1002.0)


def jpeg(level: int) -> bytes:
    _, encoded = cv2.imencode(".jpg", np.full((64, 80, 3), level, np.uint8))
    return encoded.tobytes()


class Film(NamedTuple):
    times_s: list[float]
    jpegs: list[bytes]
    first_taken_s: float


def read(path: Path) -> Film:
    first_s = float(tag(path.read_bytes(), FIRST_TAKEN_KEY))
    return Film([first_s + frame.stamp_s for frame in played(path)], packets(path), first_s)


def test_frames_come_back_byte_for_byte_at_their_capture_times(tmp_path: Path) -> None:
    recorder = VideoRecorder(tmp_path / "video.mkv")
    pictures = [jpeg(10 * number) for number in range(len(UNEVEN_S))]
    for taken_s, picture in zip(UNEVEN_S, pictures, strict=True):
        recorder.add(taken_s, picture)
    done = recorder.finish()
    assert (done.frames, done.dropped, done.fault) == (6, 0, "")
    film = read(tmp_path / "video.mkv")
    assert film.times_s == pytest.approx(UNEVEN_S, abs=1e-3)
    assert film.jpegs == pictures
    assert film.first_taken_s == done.first_taken_s == UNEVEN_S[0]


@settings(max_examples=25, deadline=None)
@given(gaps_ms=st.lists(st.floats(1.1, 3000.0), min_size=1, max_size=40))
def test_stamps_are_true_at_any_rate(gaps_ms: list[float], tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("film") / "video.mkv"
    times_s = [77.0 + 1e-3 * float(gap_ms) for gap_ms in np.cumsum(gaps_ms)]
    recorder = VideoRecorder(path)
    for taken_s in times_s:
        recorder.add(taken_s, jpeg(0))
    assert recorder.finish().frames == len(times_s)
    assert read(path).times_s == pytest.approx(times_s, abs=1e-3)


def test_players_see_the_size_and_every_frame(tmp_path: Path) -> None:
    recorder = VideoRecorder(tmp_path / "video.mkv")
    for number in range(5):
        recorder.add(number / 30.0, jpeg(40 * number))
    recorder.finish()
    player = cv2.VideoCapture(str(tmp_path / "video.mkv"))
    levels = []
    while (shown := player.read())[0]:
        assert shown[1].shape == (64, 80, 3)
        levels.append(float(shown[1].mean()))
    assert levels == pytest.approx([0.0, 40.0, 80.0, 120.0, 160.0], abs=3.0)


def test_a_frame_that_is_no_later_than_the_one_before_is_dropped(tmp_path: Path) -> None:
    recorder = VideoRecorder(tmp_path / "video.mkv")
    for taken_s in (5.0, 5.1, 5.1, 4.0, 5.2):
        recorder.add(taken_s, jpeg(0))
    done = recorder.finish()
    assert (done.frames, done.dropped) == (3, 2)
    assert read(tmp_path / "video.mkv").times_s == pytest.approx([5.0, 5.1, 5.2], abs=1e-3)


@pytest.fixture
def held_disk(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Hold the writer at its first look at the disk until told."""
    go_on = threading.Event()
    real = shutil.disk_usage

    def held(path: Path) -> object:
        assert go_on.wait(30.0)
        return real(path)

    monkeypatch.setattr(shutil, "disk_usage", held)
    return go_on.set


def test_a_slow_disk_holds_nobody_up_and_what_is_dropped_is_counted(
    tmp_path: Path, held_disk: Callable[[], None]
) -> None:
    recorder = VideoRecorder(tmp_path / "video.mkv")
    handed_over = MAX_WAITING_FRAMES + 20
    for number in range(handed_over):
        recorder.add(number / 30.0, jpeg(0))
    held_disk()
    done = recorder.finish()
    # The writer holds one frame beside those that wait, if it was quick enough.
    assert done.frames in (MAX_WAITING_FRAMES, MAX_WAITING_FRAMES + 1)
    assert done.frames + done.dropped == handed_over
    assert len(read(tmp_path / "video.mkv").times_s) == done.frames


def test_little_space_ends_the_film_with_a_reason(tmp_path: Path) -> None:
    recorder = VideoRecorder(tmp_path / "video.mkv", min_free_mb=1e12)
    recorder.add(1.0, jpeg(0))
    done = recorder.finish()
    assert (done.frames, done.dropped, done.first_taken_s) == (0, 1, None)
    assert "ended early" in done.fault
    assert "MB are free, 1000000000000 MB are needed" in recorder.fault
    assert not (tmp_path / "video.mkv").exists()


def test_a_folder_that_is_gone_and_bytes_that_are_no_picture_are_faults(tmp_path: Path) -> None:
    for path, content in ((tmp_path / "gone" / "video.mkv", jpeg(0)), (tmp_path / "video.mkv", b"no JPEG")):
        recorder = VideoRecorder(path)
        recorder.add(1.0, content)
        done = recorder.finish()
        assert done.frames == 0
        assert str(path) in done.fault


def test_what_a_crash_leaves_can_be_read(tmp_path: Path) -> None:
    recorder = VideoRecorder(tmp_path / "video.mkv")
    for number in range(90):
        recorder.add(number / 10.0, jpeg(0))
        while recorder._waiting.qsize() > 10:
            threading.Event().wait(0.001)
    while recorder._waiting.qsize():
        threading.Event().wait(0.001)
    left = tmp_path / "left.mkv"
    left.write_bytes((tmp_path / "video.mkv").read_bytes())
    assert 90 - 12 <= len(read(left).times_s) <= 90
    recorder.finish()


def test_a_killed_process_leaves_a_film(tmp_path: Path) -> None:
    path = tmp_path / "video.mkv"
    recording = f"""
import sys, time
from pathlib import Path
from mrnav_server.loops.video_recorder import VideoRecorder
recorder = VideoRecorder(Path({str(path)!r}))
for number in range(40):
    recorder.add(number / 10.0, bytes.fromhex({jpeg(120).hex()!r}))
while recorder._waiting.qsize():
    time.sleep(0.001)
print("recorded", flush=True)
sys.stdin.read()
"""
    with subprocess.Popen(
        [sys.executable, "-c", recording], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "recorded\n"
        process.send_signal(signal.SIGKILL)
    film = read(path)
    # Clusters of 11 frames, a second each, are whole.
    assert film.times_s == pytest.approx([number / 10.0 for number in range(33)], abs=1e-3)
    assert film.jpegs == [jpeg(120)] * 33


@pytest.fixture
def full_disk() -> Iterator[int]:
    """Let no file grow beyond so many bytes."""
    bound = 200_000
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (bound, before[1]))
    yield bound
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_ends_the_film_at_a_whole_cluster(tmp_path: Path, full_disk: int) -> None:
    path = tmp_path / "video.mkv"
    noise = np.random.default_rng(1).integers(0, 255, (64, 80, 3), np.uint8)
    picture = cv2.imencode(".jpg", noise)[1].tobytes()
    recorder = VideoRecorder(path)
    for number in range(50):
        recorder.add(number / 10.0, picture)
    done = recorder.finish()
    assert done.fault.startswith(f"the video {path} ended early: ")
    assert done.frames % 11 == 0
    assert 0 < done.frames < 50 == done.frames + done.dropped
    assert path.stat().st_size < full_disk
    assert len(read(path).times_s) == done.frames


def test_nothing_is_written_without_frames(tmp_path: Path) -> None:
    assert VideoRecorder(tmp_path / "video.mkv").finish().frames == 0
    assert not (tmp_path / "video.mkv").exists()


@pytest.mark.parametrize(
    ("wrong", "named"),
    [({"width_px": 20}, "width_px"), ({"quality": 99}, "quality"), ({"min_free_mb": -1.0}, "free")],
)
def test_settings_have_their_ranges(wrong: dict[str, Any], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        VideoConfig(**wrong)
