"""A film in the camera's place: its own stamps, on a clock that passes only while the camera waits."""

import itertools
import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from mrnav_server.app.bench import build_bench
from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import DeviceError, DeviceTimeoutError
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Frame
from mrnav_server.devices.pictures import FRAMES_TO_MEASURE
from mrnav_server.devices.video_file import VideoFileCamera
from mrnav_server.loops.video_recorder import VideoRecorder
from mrnav_server.settings import CameraConfig, RigConfig, Settings
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model

ASKED = PictureFormat(width_px=80, height_px=64, fps=30.0)
UNEVEN_S = (0.0, 0.02, 0.1, 0.13, 0.2, 0.35)


class Cinema:
    """A camera, and a clock that waiting moves on."""

    def __init__(self, path: Path, *, loop: bool = False, as_fast_as_possible: bool = False) -> None:
        self.now_s = 50.0
        self.camera = VideoFileCamera(
            path,
            ASKED,
            lambda: self.now_s,
            loop=loop,
            as_fast_as_possible=as_fast_as_possible,
            sleep=self.wait,
        )

    def wait(self, span_s: float) -> None:
        self.now_s += span_s

    def read(self, count: int) -> list[Frame]:
        return [self.camera.read(1.0) for _ in range(count)]


def picture(level: int, width_px: int = 80, height_px: int = 64) -> ByteArray:
    return np.full((height_px, width_px, 3), level, np.uint8)


def level(frame: Frame) -> int:
    """Return which picture this is: they rise by 10."""
    return round(float(frame.image.mean()) / 10.0)


def avi(path: Path, frames: int, fps: float = 30.0, width_px: int = 80) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), fps, (width_px, 64))
    assert writer.isOpened()
    for number in range(frames):
        writer.write(picture(10 * number, width_px))
    writer.release()
    return path


def matroska(path: Path, stamps_s: tuple[float, ...]) -> Path:
    recorder = VideoRecorder(path)
    for number, stamp_s in enumerate(stamps_s):
        recorder.add(stamp_s, cv2.imencode(".jpg", picture(10 * number))[1].tobytes())
    assert recorder.finish().frames == len(stamps_s)
    return path


def times(frames: list[Frame]) -> list[float]:
    return [frame.taken_s for frame in frames]


def test_a_film_runs_in_real_time_from_the_moment_of_opening(tmp_path: Path) -> None:
    cinema = Cinema(avi(tmp_path / "film.avi", 6))
    cinema.camera.open()
    delivered_s = []
    for number in range(6):
        frame = cinema.camera.read(1.0)
        delivered_s.append(cinema.now_s)
        assert (frame.number, level(frame)) == (number, number)
        assert frame.image.shape == (64, 80, 3)
        assert frame.taken_s == pytest.approx(50.0 + number / 30.0, abs=1e-3)
    assert delivered_s == pytest.approx([50.0 + number / 30.0 for number in range(6)], abs=1e-3)


def test_a_variable_rate_is_kept(tmp_path: Path) -> None:
    cinema = Cinema(matroska(tmp_path / "film.mkv", UNEVEN_S))
    cinema.camera.open()
    assert times(cinema.read(6)) == pytest.approx([50.0 + stamp_s for stamp_s in UNEVEN_S], abs=1e-3)
    assert cinema.now_s == pytest.approx(50.35, abs=1e-3)


def test_a_late_reader_misses_frames_and_sees_the_gap(tmp_path: Path) -> None:
    cinema = Cinema(avi(tmp_path / "film.avi", 10))
    cinema.camera.open()
    cinema.read(1)
    cinema.wait(5.5 / 30.0)
    frame = cinema.camera.read(1.0)
    assert (frame.number, level(frame)) == (5, 5)
    assert 0.0 < cinema.now_s - frame.taken_s < 1.0 / 30.0
    assert cinema.camera.read(1.0).number == 6


def test_as_fast_as_possible_waits_for_nothing_and_skips_nothing(tmp_path: Path) -> None:
    cinema = Cinema(matroska(tmp_path / "film.mkv", UNEVEN_S), as_fast_as_possible=True)
    cinema.camera.open()
    cinema.wait(5.0)
    frames = cinema.read(6)
    assert [frame.number for frame in frames] == list(range(6))
    assert times(frames) == pytest.approx([50.0 + stamp_s for stamp_s in UNEVEN_S], abs=1e-3)
    assert cinema.now_s == 55.0


def test_a_film_ends_once_and_for_all(tmp_path: Path) -> None:
    cinema = Cinema(avi(tmp_path / "film.avi", 3))
    cinema.camera.open()
    cinema.read(3)
    for attempt in (lambda: cinema.camera.read(1.0), cinema.camera.open):
        with pytest.raises(DeviceError, match=r"film\.avi has ended: set camera\.loop = true"):
            attempt()
        cinema.camera.close()


def test_a_loop_goes_on_with_numbers_and_capture_times(tmp_path: Path) -> None:
    cinema = Cinema(avi(tmp_path / "film.avi", 3), loop=True)
    cinema.camera.open()
    frames = cinema.read(8)
    assert [frame.number for frame in frames] == list(range(8))
    assert [level(frame) for frame in frames] == [0, 1, 2, 0, 1, 2, 0, 1]
    gaps_s = [after - before for before, after in itertools.pairwise(times(frames))]
    assert gaps_s == pytest.approx([1 / 30.0] * 7, abs=2e-3)


def test_a_frame_that_is_due_later_is_a_timeout_and_comes_then(tmp_path: Path) -> None:
    cinema = Cinema(matroska(tmp_path / "film.mkv", (0.0, 2.0)))
    cinema.camera.open()
    cinema.read(1)
    for _ in range(3):
        with pytest.raises(DeviceTimeoutError, match=r"no frame within 0\.5 s"):
            cinema.camera.read(0.5)
    assert cinema.now_s == pytest.approx(51.5)
    assert cinema.camera.read(1.0).taken_s == pytest.approx(52.0, abs=1e-3)


def test_reading_needs_an_open_film(tmp_path: Path) -> None:
    cinema = Cinema(avi(tmp_path / "film.avi", 3))
    with pytest.raises(DeviceError, match="not open"):
        cinema.camera.read(1.0)
    cinema.camera.open()
    cinema.read(2)
    cinema.camera.close()
    cinema.camera.close()
    with pytest.raises(DeviceError, match="not open"):
        cinema.camera.read(1.0)
    cinema.wait(5.0)
    cinema.camera.open()
    assert cinema.camera.read(1.0).number == 0


def test_what_cannot_be_played_is_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    text = tmp_path / "notes.txt"
    text.write_text("no film")
    for path, said in (
        (tmp_path / "missing.avi", "does not exist: set camera.file"),
        (tmp_path, "does not exist"),
        (text, "cannot be read: set camera.file to an AVI"),
        (
            avi(tmp_path / "wide.avi", 2, width_px=160),
            "of 160×64 px; asked for 80×64: set camera.width_px = 160",
        ),
    ):
        with pytest.raises(DeviceError) as error:
            Cinema(path).camera.open()
        assert said in str(error.value)
        assert path.name in str(error.value)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(("fps", "warned"), [(15.0, True), (29.0, False)])
def test_another_rate_is_named_and_played(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, fps: float, warned: bool
) -> None:
    cinema = Cinema(avi(tmp_path / "film.avi", FRAMES_TO_MEASURE, fps))
    assert cinema.camera.format == ""
    cinema.camera.open()
    cinema.read(FRAMES_TO_MEASURE)
    assert cinema.camera.format.startswith(f"video file 80×64 at {fps:.1f} fps")
    assert ("set camera.fps = 15" in cinema.camera.format) is warned
    assert ("gives 15.0 fps, not 30" in caplog.text) is warned


def test_the_bench_plays_the_film_that_the_settings_name(tmp_path: Path) -> None:
    film = avi(tmp_path / "film.avi", 2)
    camera = CameraConfig(width_px=80, height_px=64, file=str(film), loop=True)
    vessel = load_vessel_model(find_model("bifurcation"))
    now_s = itertools.count(0.0, 0.001)
    bench = build_bench(Settings(rig=RigConfig(camera="file"), camera=camera), vessel, lambda: next(now_s))
    assert bench.camera_format == ""
    bench.camera.open()
    assert math.isfinite(bench.camera.read(1.0).taken_s)
    assert bench.camera_format == "video file 80×64"
    bench.camera.close()
