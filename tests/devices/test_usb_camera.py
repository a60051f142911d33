"""The USB camera, seen from outside, on a capture that gives pictures when told."""

import asyncio
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from mrnav_server.app.bench import build_bench
from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import DeviceError, DeviceTimeoutError
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Frame, Track, TrackState
from mrnav_server.devices.cameras import UsbCamera
from mrnav_server.devices.v4l2 import AUTOMATIC, Controls, open_capture
from mrnav_server.loops import tracking
from mrnav_server.settings import CameraConfig, RigConfig, Settings
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model
from tests.devices.fake_capture import PULLED_OUT, FakeCapture, Socket, clock_of

ASKED = PictureFormat(width_px=80, height_px=64, fps=30.0)
WAIT_S = 30.0
"""How long a picture that surely comes is waited for."""

Plug = Callable[..., UsbCamera]


def picture(level: int = 100, width_px: int = 80, height_px: int = 64) -> ByteArray:
    return np.full((height_px, width_px, 3), level, np.uint8)


@pytest.fixture
def plug(tmp_path: Path) -> Iterator[Plug]:
    """Make cameras with index 3; whatever they hold is given back at the end."""
    made: list[tuple[UsbCamera, tuple[FakeCapture | None, ...]]] = []

    def make(
        *captures: FakeCapture | None, open_timeout_s: float = WAIT_S, controls: Controls = AUTOMATIC
    ) -> UsbCamera:
        clock = clock_of(captures[0]) if captures and captures[0] else float
        camera = UsbCamera(3, ASKED, clock, controls, Socket(*captures), tmp_path, open_timeout_s)
        made.append((camera, captures))
        return camera

    yield make
    for camera, captures in made:
        for capture in captures:
            if capture is not None:
                capture.flow()
        camera.close()


def refusal(camera: UsbCamera) -> str:
    with pytest.raises(DeviceError) as error:
        camera.open()
    return str(error.value)


def test_size_rate_automatic_exposure_and_a_buffer_of_one_frame_are_asked_for(plug: Plug) -> None:
    capture = FakeCapture(picture())
    camera = plug(capture)
    assert camera.format == ""
    camera.open()
    assert capture.asked == {
        cv2.CAP_PROP_FOURCC: cv2.VideoWriter.fourcc(*"MJPG"),
        cv2.CAP_PROP_FRAME_WIDTH: 80,
        cv2.CAP_PROP_FRAME_HEIGHT: 64,
        cv2.CAP_PROP_FPS: 30.0,
        cv2.CAP_PROP_BUFFERSIZE: 1,
        cv2.CAP_PROP_AUTO_EXPOSURE: 3,
    }
    assert camera.format == "MJPG 80×64 at 30 fps"


@pytest.mark.parametrize(
    ("modes", "taken"),
    [
        ({"MJPG": (80, 64, 30.0), "NV12": (80, 64, 30.0), "YUYV": (80, 64, 30.0)}, "YUYV 80×64 at 30 fps"),
        ({"MJPG": (80, 64, 30.0), "NV12": (80, 64, 60.0), "YUYV": (80, 64, 5.0)}, "NV12 80×64 at 60 fps"),
        ({"MJPG": (80, 64, 30.0), "YUYV": (40, 32, 30.0)}, "MJPG 80×64 at 30 fps"),
        ({"MJPG": (80, 64, 15.0), "YUYV": (80, 64, 20.0)}, "YUYV 80×64 at 20 fps"),
        ({"MJPG": (40, 32, 30.0), "YUYV": (80, 64, 5.0)}, "YUYV 80×64 at 5 fps"),
        ({"MJPG": (80, 64, 0.0), "YUYV": (80, 64, 0.0)}, "MJPG 80×64 at an untold rate"),
        ({"GREY": (80, 64, 30.0)}, "GREY 80×64 at 30 fps"),
    ],
)
def test_raw_pictures_are_taken_where_size_and_rate_allow(
    plug: Plug, modes: dict[str, tuple[int, int, float]], taken: str
) -> None:
    capture = FakeCapture(picture(), modes=modes)
    camera = plug(capture)
    camera.open()
    assert camera.format == taken
    assert capture.code == taken[:4]


def test_exposure_and_gain_are_set_and_told(plug: Plug) -> None:
    capture = FakeCapture(picture())
    camera = plug(capture, controls=Controls(exposure_ms=8.0, gain=12.0))
    camera.open()
    assert capture.asked[cv2.CAP_PROP_AUTO_EXPOSURE] == 1
    assert capture.asked[cv2.CAP_PROP_EXPOSURE] == 80
    assert capture.asked[cv2.CAP_PROP_GAIN] == 12.0
    assert camera.format == "MJPG 80×64 at 30 fps, exposure 8 ms, gain 12"


@pytest.mark.parametrize(
    ("refused", "setting"),
    [(cv2.CAP_PROP_EXPOSURE, "camera.exposure_ms = 8"), (cv2.CAP_PROP_GAIN, "camera.gain = 12")],
)
def test_a_control_that_the_camera_does_not_take_is_named(plug: Plug, refused: int, setting: str) -> None:
    capture = FakeCapture(picture(), refuses=[refused])
    told = refusal(plug(capture, controls=Controls(exposure_ms=8.0, gain=12.0)))
    assert f"USB camera 3 does not take {setting}" in told
    assert capture.released.is_set()


def test_nothing_is_touched_before_it_is_opened(tmp_path: Path) -> None:
    socket = Socket()
    camera = UsbCamera(3, ASKED, float, AUTOMATIC, socket, tmp_path)
    camera.close()
    with pytest.raises(DeviceError, match="USB camera 3 is not open"):
        camera.read(0.0)
    assert socket.indices == []
    refusal(camera)
    assert socket.indices == [3]


def test_frames_are_counted_and_stamped_when_they_were_grabbed_not_decoded(plug: Plug) -> None:
    capture = FakeCapture()
    capture.give(picture(1), at_s=7.0)
    camera = plug(capture)
    camera.open()
    frames = [camera.read(WAIT_S)]
    for level, at_s in ((2, 7.5), (3, 8.0)):
        capture.give(picture(level), at_s)
        frames.append(camera.read(WAIT_S))
    assert [frame.number for frame in frames] == [0, 1, 2]
    assert [frame.taken_s for frame in frames] == [7.0, 7.5, 8.0]
    assert [int(frame.image[0, 0, 0]) for frame in frames] == [1, 2, 3]


def test_a_slow_reader_gets_the_newest_frame_and_sees_the_gap(plug: Plug) -> None:
    capture = FakeCapture(picture(0), picture(1), picture(2))
    camera = plug(capture)
    camera.open()
    capture.settle()
    frame = camera.read(0.0)
    assert (frame.number, int(frame.image[0, 0, 0])) == (2, 2)
    with pytest.raises(DeviceTimeoutError):
        camera.read(0.0)


def test_a_picture_that_cannot_be_decoded_is_a_dropped_frame(plug: Plug) -> None:
    capture = FakeCapture(picture())
    camera = plug(capture)
    camera.open()
    camera.read(WAIT_S)
    capture.give("broken JPEG")
    capture.give(picture(5))
    assert camera.read(WAIT_S).number == 2


@pytest.mark.parametrize("shape", [(64, 80), (64, 80, 1)])
def test_gray_pictures_become_bgr(plug: Plug, shape: tuple[int, ...]) -> None:
    gray = np.arange(64 * 80, dtype=np.uint32).astype(np.uint8).reshape(shape)
    camera = plug(FakeCapture(gray))
    camera.open()
    image = camera.read(WAIT_S).image
    assert image.shape == (64, 80, 3)
    assert image.dtype == np.uint8
    for channel in range(3):
        assert np.array_equal(image[:, :, channel], gray.reshape(64, 80))


def test_no_picture_in_time_is_a_timeout_and_the_next_one_is_read(plug: Plug) -> None:
    capture = FakeCapture(picture())
    camera = plug(capture)
    camera.open()
    camera.read(WAIT_S)
    with pytest.raises(DeviceTimeoutError, match=r"USB camera 3 gives no picture within 0 s.*cable"):
        camera.read(0.0)
    capture.give(picture(9))
    assert camera.read(WAIT_S).number == 1


def test_a_camera_that_is_pulled_out_fails_and_works_again_once_it_is_back(plug: Plug) -> None:
    first, second = FakeCapture(picture(), PULLED_OUT), FakeCapture(picture(8))
    camera = plug(first, None, second)
    camera.open()
    assert camera.read(WAIT_S).number == 0
    for _ in range(2):
        with pytest.raises(DeviceError, match=r"USB camera 3 gives no more pictures.*video3 pulled out"):
            camera.read(WAIT_S)
    camera.close()
    assert first.released.is_set()
    refusal(camera)
    camera.open()
    frame = camera.read(WAIT_S)
    assert (frame.number, int(frame.image[0, 0, 0])) == (0, 8)


def test_closing_gives_the_camera_back_and_ends_reading(plug: Plug) -> None:
    capture = FakeCapture(picture())
    camera = plug(capture)
    camera.open()
    capture.flow()
    camera.close()
    camera.close()
    assert capture.released.is_set()
    with pytest.raises(DeviceError, match="not open"):
        camera.read(0.0)


def test_a_read_that_hangs_holds_up_neither_close_nor_a_waiting_reader(plug: Plug) -> None:
    hung, replaced = FakeCapture(picture()), FakeCapture(picture(4))
    camera = plug(hung, replaced)
    camera.open()
    camera.read(WAIT_S)
    ended: list[str] = []

    def read() -> None:
        with pytest.raises(DeviceError) as error:
            camera.read(3600.0)
        ended.append(str(error.value))

    reader = threading.Thread(target=read)
    reader.start()
    camera.close()
    reader.join(WAIT_S)
    assert ended == ["USB camera 3 is not open: open it first"]
    assert not hung.released.is_set()
    assert "still held" in refusal(camera)
    hung.give(picture())
    assert hung.released.wait(WAIT_S)
    camera.close()
    camera.open()
    assert int(camera.read(WAIT_S).image[0, 0, 0]) == 4


def test_another_size_is_refused_with_what_was_asked_and_what_was_given(plug: Plug) -> None:
    capture = FakeCapture(picture(width_px=320, height_px=240))
    told = refusal(plug(capture))
    for part in ("USB camera 3", "320×240", "80×64", "camera.width_px = 320", "camera.height_px = 240"):
        assert part in told
    assert capture.released.is_set()


@pytest.mark.parametrize(
    ("image", "kind"),
    [(np.zeros((64, 80, 4), np.uint8), "4 channels"), (np.zeros((64, 80), np.uint16), "uint16")],
)
def test_other_kinds_of_pictures_are_refused(plug: Plug, image: ByteArray, kind: str) -> None:
    assert kind in refusal(plug(FakeCapture(image)))


@pytest.mark.parametrize(
    ("period_s", "said", "remedy"),
    [
        (1 / 15, "gives 15.0 fps, not 30", "lower camera.exposure_ms or add light"),
        (1 / 60, "gives 60.0 fps, not 30", "set camera.fps = 60"),
        (1 / 29, "", ""),
    ],
)
def test_the_rate_is_measured_once_the_camera_has_settled(
    plug: Plug, caplog: pytest.LogCaptureFixture, period_s: float, said: str, remedy: str
) -> None:
    capture = FakeCapture(picture())
    camera = plug(capture)
    camera.open()
    for number in range(1, 5):
        capture.give(picture(), at_s=100.0 * number)
    for number in range(20):
        capture.give(picture(), at_s=400.0 + (1 + number) * period_s)
    capture.settle()
    assert f"measured {1 / period_s:.1f} fps" in camera.format
    warnings = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert len(warnings) == bool(said)
    assert said in "".join(warnings)
    assert remedy in camera.format


def test_a_missing_camera_is_told_with_those_that_there_are(plug: Plug, tmp_path: Path) -> None:
    told = refusal(plug())
    for part in ("USB camera 3", f"{tmp_path}/video3 does not exist", "no camera is connected", "rig.camera"):
        assert part in told
    for number in (10, 2):
        (tmp_path / f"video{number}").touch()
    told = refusal(plug())
    assert f"there is {tmp_path}/video2, {tmp_path}/video10: set camera.index" in told


def test_a_camera_in_use_and_one_that_may_not_be_used_are_told_apart(
    plug: Plug, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "video3").touch()
    assert "another program uses" in refusal(plug())
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert "add the user to the group" in refusal(plug())


def test_a_camera_that_stays_silent_is_refused_and_left(plug: Plug) -> None:
    capture = FakeCapture()
    assert "gives no picture within 0 s" in refusal(plug(capture, open_timeout_s=0.0))
    capture.give(picture())
    assert capture.released.wait(WAIT_S)


def test_frames_of_opencv_itself_are_read_until_it_has_no_more(tmp_path: Path) -> None:
    film = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(film), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (80, 64))
    assert writer.isOpened()
    for level in range(0, 200, 20):
        writer.write(picture(level))
    writer.release()
    camera = UsbCamera(
        3, ASKED, float, AUTOMATIC, lambda _: cv2.VideoCapture(str(film)), open_timeout_s=WAIT_S
    )
    camera.open()
    numbers, levels = [], []

    def read_all() -> None:
        while True:
            frame = camera.read(WAIT_S)
            numbers.append(frame.number)
            levels.append(float(frame.image.mean()))

    with pytest.raises(DeviceError, match="no more pictures"):
        read_all()
    camera.close()
    assert numbers == sorted(set(numbers))
    assert numbers[-1] == 9
    assert levels == pytest.approx([20.0 * number for number in numbers], abs=3.0)


def test_opencv_says_nothing_on_stderr_about_a_missing_camera(capfd: pytest.CaptureFixture[str]) -> None:
    assert open_capture(97) is None
    assert capfd.readouterr() == ("", "")


async def test_the_tracking_loop_survives_unplugging(plug: Plug, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracking, "_FIRST_RETRY_S", 0.001)
    pulled, back = FakeCapture(picture(1), PULLED_OUT), FakeCapture(picture(2))
    camera = plug(pulled, None, None, back)
    camera.open()
    levels: list[int] = []
    told: list[str] = []
    works_again = asyncio.Event()

    class Blind:
        def update(self, frame: Frame) -> Track:
            return Track(frame.taken_s, frame.number, TrackState.SEARCHING, None, None, 0.0, 0.0, 0)

    def on_track(frame: Frame, _: Track) -> None:
        levels.append(int(frame.image[0, 0, 0]))

    def on_camera(fault: str) -> None:
        told.append(fault)
        if not fault:
            works_again.set()

    async with asyncio.timeout(WAIT_S):
        async with asyncio.TaskGroup() as group:
            loop = group.create_task(tracking.TrackingLoop(camera, Blind(), on_track, on_camera).run())
            await works_again.wait()
            back.flow()
            loop.cancel()
    assert levels[:2] == [1, 2]
    assert "no more pictures" in told[0]
    assert told[-1] == ""
    assert back.released.is_set()


def test_the_bench_takes_the_camera_that_the_settings_name() -> None:
    settings = Settings(rig=RigConfig(camera="usb"), camera=CameraConfig(index=97))
    bench = build_bench(settings, load_vessel_model(find_model("bifurcation")), float)
    with pytest.raises(DeviceError, match="/dev/video97 does not exist"):
        bench.camera.open()
