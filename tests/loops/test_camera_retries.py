"""A camera that fails is opened again with back-off; no time passes."""

import asyncio
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.records import Frame, Track, TrackState
from mrnav_server.loops import tracking

PICTURE = np.zeros((4, 4, 3), np.uint8)
WAIT_S = 30.0


class Impatient(threading.Event):
    """An event that notes how long it would be waited for."""

    waited_s: list[float]

    def wait(self, timeout: float | None = None) -> bool:
        assert timeout is not None
        self.waited_s.append(timeout)
        return self.is_set()


class Flaky:
    """A camera whose every opening and reading goes as the script says; at its end it is read for ever."""

    def __init__(self, *script: bool) -> None:
        self._script = list(script)
        self.at_the_end = threading.Event()
        self.given_up = threading.Event()
        self.number = 0

    def open(self) -> None:
        self._next("cannot be opened")

    def read(self, timeout_s: float) -> Frame:
        if not self._script:
            self.at_the_end.set()
            assert self.given_up.wait(WAIT_S)
        self._next("is pulled out")
        self.number += 1
        return Frame(self.number, float(self.number), PICTURE)

    def close(self) -> None:
        pass

    def _next(self, fault: str) -> None:
        if not self._script or not self._script.pop(0):
            raise DeviceError(fault)


class Blind:
    """A tracker that never finds anything."""

    def update(self, frame: Frame) -> Track:
        return Track(frame.taken_s, frame.number, TrackState.SEARCHING, None, None, 0.0, 0.0, 0)


@pytest.fixture
def waited_s(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    Impatient.waited_s = []
    monkeypatch.setattr(tracking, "threading", SimpleNamespace(Event=Impatient))
    return Impatient.waited_s


async def told_of(camera: Flaky) -> list[str]:
    """Run the loop to the script's end; return what it said of the camera."""
    told: list[str] = []
    running = asyncio.ensure_future(
        tracking.TrackingLoop(camera, Blind(), lambda *_: None, told.append).run()
    )
    assert await asyncio.to_thread(camera.at_the_end.wait, WAIT_S)
    running.cancel()
    camera.given_up.set()
    with pytest.raises(asyncio.CancelledError):
        await running
    return told


async def test_each_attempt_waits_twice_as_long_up_to_five_seconds(waited_s: list[float]) -> None:
    told = await told_of(Flaky(True, False, *[False] * 6, True, True))
    assert waited_s[:7] == [0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0]
    assert told[:2] == ["camera: is pulled out; trying again", ""]


async def test_a_camera_that_opens_but_gives_nothing_is_not_hammered(waited_s: list[float]) -> None:
    told = await told_of(Flaky(False, True, False, True, False, True, True))
    assert waited_s[:3] == [0.2, 0.4, 0.8]
    assert told[:2] == ["camera: is pulled out; trying again", ""]


async def test_a_picture_ends_the_back_off(waited_s: list[float]) -> None:
    told = await told_of(Flaky(False, False, True, True, False, True, True))
    assert waited_s[:3] == [0.2, 0.4, 0.2]
    assert told[:4] == 2 * ["camera: is pulled out; trying again", ""]
