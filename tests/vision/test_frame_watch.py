"""The camera's faults, each named in a sentence; told frames and times."""

import numpy as np
import pytest

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.records import Frame
from mrnav_server.vision.frame_watch import FrameWatch, PictureWatch

FPS = 30.0


class Camera:
    """A camera that is watched; every frame is fresh noise, unless told otherwise."""

    def __init__(self) -> None:
        self.watch = FrameWatch(FPS)
        self.rng = np.random.default_rng(3)
        self.number = 0
        self.taken_s = 50.0
        self.last = self.picture()

    def picture(self, level: float = 120.0) -> ByteArray:
        picture: ByteArray = self.rng.normal(level, 3.0, (240, 320, 3)).clip(0, 255).astype(np.uint8)
        return picture

    def frame(
        self, image: ByteArray | None = None, period_s: float = 1 / FPS, age_s: float = 0.03, skip: int = 0
    ) -> str:
        self.last = self.picture() if image is None else image
        self.number += 1 + skip
        self.taken_s += period_s
        return self.watch.look(Frame(self.number, self.taken_s, self.last), self.taken_s + age_s)


@pytest.fixture
def camera() -> Camera:
    camera = Camera()
    assert [camera.frame() for _ in range(40)] == [""] * 40
    return camera


def test_a_frozen_picture_is_named_at_once_and_forgotten_at_once(camera: Camera) -> None:
    assert "frozen" in camera.frame(camera.last.copy())
    assert camera.frame() == ""


def test_a_black_picture_is_named_even_with_noise_and_hot_pixels(camera: Camera) -> None:
    black = camera.picture(2.0)
    black[::40, ::40] = 255
    assert "black" in camera.frame(black)
    assert "black" in camera.frame(np.zeros_like(black))
    assert camera.frame() == ""


def test_a_white_picture_is_named(camera: Camera) -> None:
    assert "white" in camera.frame(np.full((240, 320, 3), 255, np.uint8))


def test_a_dark_field_may_be_allowed() -> None:
    dark = np.random.default_rng(0).integers(0, 5, (240, 320, 3), np.uint8)
    assert "black" in PictureWatch(12.0).fault(dark)
    assert PictureWatch(0.0).fault(dark) == ""


def test_a_slow_camera_is_named_once_it_lasts_and_with_both_periods(camera: Camera) -> None:
    said = [camera.frame(period_s=1.6 / FPS) for _ in range(2)]
    assert said[0] == ""
    assert said[1] == "the camera is slow: a frame every 53 ms instead of 33 ms"
    back = [camera.frame() for _ in range(5)]
    assert "slow" in back[3]
    assert back[4] == ""


def test_one_late_frame_is_no_fault(camera: Camera) -> None:
    assert camera.frame(period_s=3 / FPS) == ""
    assert camera.frame(age_s=0.3) == ""


def test_a_camera_within_half_as_much_again_is_not_slow(camera: Camera) -> None:
    assert {camera.frame(period_s=1.4 / FPS) for _ in range(30)} == {""}


def test_frames_that_arrive_late_are_named_by_their_age_at_capture(camera: Camera) -> None:
    said = [camera.frame(age_s=0.25) for _ in range(5)]
    assert said[-1] == "the camera is late: its frames arrive 250 ms after they were taken"


def test_the_sentence_stays_while_the_fault_does(camera: Camera) -> None:
    said = {camera.frame(age_s=0.2 + 0.01 * k) for k in range(20)} - {""}
    assert len(said) == 1


def test_missing_numbers_are_counted_and_named(camera: Camera) -> None:
    assert camera.frame(skip=1) == ""
    said = [camera.frame(skip=1, period_s=1.2 / FPS) for _ in range(2)]
    assert said[-1] == "frames are missing: 3 of the last 33"
    assert camera.watch.missing == 3
    assert [camera.frame() for _ in range(31)][-1] == ""


def test_half_the_rate_is_slow_whether_the_numbers_jump_or_not(camera: Camera) -> None:
    assert "slow" in [camera.frame(period_s=2 / FPS, skip=1) for _ in range(8)][-1]


@pytest.mark.parametrize(("periods", "skip"), [(2.0, 0), (1.4, 1)])
def test_half_the_rate_is_noticed_before_the_frame_that_would_show_it(
    camera: Camera, periods: float, skip: int
) -> None:
    camera.frame(period_s=periods / FPS, skip=skip)
    arrived_s = camera.taken_s + 0.03
    assert camera.watch.overdue(arrived_s + 1.15 / FPS) == ""
    assert "overdue" in camera.watch.overdue(arrived_s + 1.25 / FPS)


def test_a_frame_that_was_lost_makes_nothing_overdue(camera: Camera) -> None:
    camera.frame(period_s=2 / FPS)
    camera.frame()
    assert camera.watch.overdue(camera.taken_s + 10.0) == ""


def test_a_clock_that_stands_still_is_named(camera: Camera) -> None:
    assert camera.frame(period_s=0.0) == ""
    assert "do not rise" in camera.frame(period_s=-0.001)
    assert "do not rise" in camera.frame(period_s=0.0)
    assert camera.frame() == ""


def test_a_single_capture_time_that_is_repeated_is_no_fault(camera: Camera) -> None:
    said = {camera.frame(period_s=period_s) for _ in range(10) for period_s in (0.0, 1 / FPS)}
    assert said == {""}


def test_a_camera_that_was_opened_anew_starts_afresh(camera: Camera) -> None:
    camera.number = -1
    camera.taken_s += 7.0
    assert [camera.frame() for _ in range(10)] == [""] * 10
    assert camera.watch.missing == 0


def test_a_film_may_repeat_its_pictures_but_not_go_black() -> None:
    camera = Camera()
    camera.watch = FrameWatch(FPS, may_repeat=True)
    still = camera.picture()
    assert [camera.frame(still) for _ in range(10)] == [""] * 10
    assert "black" in camera.frame(np.zeros_like(still))
