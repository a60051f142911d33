"""Trials are filmed with the pictures that viewers get."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import numpy as np
import pytest

from mrnav_server.app import video
from mrnav_server.app.trial_video import TrialVideo
from mrnav_server.app.video import VideoEncoder
from mrnav_server.core.records import Frame
from mrnav_server.loops.latest import Latest
from mrnav_server.loops.video_recorder import VIDEO_NAME, VideoConfig
from tests.films import played
from tests.rig_process import wait_for

FILMED = VideoConfig(enabled=True, width_px=80, quality=75, min_free_mb=0.0)


class Studio:
    """A camera whose frames a test gives, and one viewer beside the film."""

    def __init__(self, config: VideoConfig) -> None:
        self.frames: Latest[Frame] = Latest()
        self.encoder = VideoEncoder(self.frames)
        self.film = TrialVideo(config, self.encoder)

    @asynccontextmanager
    async def open(self) -> AsyncIterator["Studio"]:
        async with asyncio.TaskGroup() as group:
            running = group.create_task(self.film.run())
            yield self
            running.cancel()
        self.encoder.close()

    async def shoot(self, number: int) -> None:
        """Show a frame and wait until the viewer has it, and with it the film."""
        self.show(number)
        await self.encoder.newer_than(number, 80, 75)
        await settle()

    def show(self, number: int) -> None:
        self.frames.put(Frame(number, 9.0 + number / 30.0, np.full((120, 160, 3), 9 * number, np.uint8)))


async def settle() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


@pytest.fixture
def encoded(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of the frames that are encoded."""
    numbers: list[int] = []
    real = video.encode_jpeg

    def counted(frame: Frame, width_px: int, quality: int) -> bytes:
        numbers.append(frame.number)
        return real(frame, width_px, quality)

    monkeypatch.setattr(video, "encode_jpeg", counted)
    return numbers


async def test_a_trial_is_filmed_without_an_encoding_of_its_own(tmp_path: Path, encoded: list[int]) -> None:
    async with Studio(FILMED).open() as studio:
        studio.film.begin(tmp_path)
        for number in range(6):
            await studio.shoot(number)
        done = await studio.film.end()
    assert done is not None
    assert (done.frames, done.dropped, done.first_taken_s, done.fault) == (6, 0, 9.0, "")
    assert encoded == list(range(6))
    stamps_s = [frame.stamp_s for frame in played(tmp_path / VIDEO_NAME)]
    assert stamps_s == pytest.approx([number / 30.0 for number in range(6)], abs=1e-3)


async def test_between_trials_nothing_is_encoded_and_the_next_one_is_filmed_anew(
    tmp_path: Path, encoded: list[int]
) -> None:
    async with Studio(FILMED).open() as studio:
        for trial in range(2):
            folder = tmp_path / str(trial)
            folder.mkdir()
            studio.film.begin(folder)
            await studio.shoot(3 * trial)
            done = await studio.film.end()
            assert done is not None
            assert done.frames > 0
            assert (folder / VIDEO_NAME).is_file()
            assert await studio.film.end() is None
            # The film asked for this one before it was ended.
            await studio.shoot(3 * trial + 1)
            studio.show(3 * trial + 2)
            await settle()
    assert encoded == [0, 1, 3, 4]


async def test_a_fault_of_the_film_is_told_while_the_trial_runs(tmp_path: Path) -> None:
    async with Studio(FILMED).open() as studio:
        assert studio.film.fault == ""
        studio.film.begin(tmp_path / "gone")
        await studio.shoot(0)
        await asyncio.to_thread(wait_for, lambda: bool(studio.film.fault), 10.0, "the fault")
        assert "gone" in studio.film.fault
        done = await studio.film.end()
    assert done is not None
    assert (done.frames, done.dropped) == (0, 1)


async def test_trials_are_not_filmed_unless_it_is_asked_for(tmp_path: Path) -> None:
    async with Studio(VideoConfig()).open() as studio:
        studio.film.begin(tmp_path)
        await studio.shoot(0)
        assert await studio.film.end() is None
    assert not (tmp_path / VIDEO_NAME).exists()
