"""Pictures are found in a film as it was written, whole or cut off."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from mrnav_server.loops.film_index import film_frames, film_picture
from mrnav_server.loops.video_recorder import VideoRecorder
from tests.films import packets

TAKEN_S = [71.5, 71.533, 71.6, 73.2, 74.9]


@pytest.fixture
def film(tmp_path: Path) -> Path:
    recorder = VideoRecorder(tmp_path / "video.mkv")
    for level, taken_s in enumerate(TAKEN_S):
        picture = np.full((48, 64, 3), 40 * level, np.uint8)
        recorder.add(taken_s, cv2.imencode(".jpg", picture)[1].tobytes())
    recorder.finish()
    return tmp_path / "video.mkv"


def test_every_picture_is_found_with_its_time(film: Path) -> None:
    frames = film_frames(film)
    assert [frame.taken_s for frame in frames] == pytest.approx(TAKEN_S, abs=1e-3)
    assert [film_picture(film, frame) for frame in frames] == packets(film)


def test_a_film_that_was_cut_off_shows_what_is_whole(film: Path) -> None:
    whole = film_frames(film)
    film.write_bytes(film.read_bytes()[: whole[3].offset + 5])
    assert film_frames(film) == whole[:3]
    film.write_bytes(film.read_bytes()[:1])
    assert film_frames(film) == []


def test_without_a_film_there_are_none(tmp_path: Path) -> None:
    assert film_frames(tmp_path / "video.mkv") == []
