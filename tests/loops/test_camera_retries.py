"""A camera that fails is opened again with back-off; no time passes."""

import asyncio
import threading
from contextlib import suppress

import numpy as np
import pytest

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.records import Frame, Track, TrackState
from mrnav_server.loops.tracking import TrackingLoop
from mrnav_server.sim.virtual_time import VirtualTimeLoop

PICTURE = np.zeros((4, 4, 3), np.uint8)
WAIT_S = 30.0


class Flaky:
    """A camera whose every opening and reading goes as the script says; at its end it is read for ever."""

    def __init__(self, *script: bool) -> None:
        self._script = list(script)
        self.at_the_end = threading.Event()
        self.given_up = threading.Event()
        self.number = 0
        self.waited_s: list[float] = []
        """Before each attempt to open it again."""
        self._slept_s = 0.0

    def sleep(self, seconds: float) -> None:
        self._slept_s += seconds

    def open(self) -> None:
        self.waited_s.append(round(self._slept_s, 6))
        self._slept_s = 0.0
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


async def told_of(camera: Flaky) -> list[str]:
    """Run the loop to the script's end; return what it said of the camera."""
    told: list[str] = []
    running = asyncio.ensure_future(
        TrackingLoop(camera, Blind(), lambda *_: None, told.append, sleep=camera.sleep).run()
    )
    assert await asyncio.to_thread(camera.at_the_end.wait, WAIT_S)
    running.cancel()
    camera.given_up.set()
    with pytest.raises(asyncio.CancelledError):
        await running
    return told


async def test_each_attempt_waits_twice_as_long_up_to_five_seconds() -> None:
    camera = Flaky(True, False, *[False] * 6, True, True)
    told = await told_of(camera)
    assert camera.waited_s[:7] == [0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0]
    assert told[:2] == ["camera: is pulled out; trying again", ""]


async def test_a_camera_that_opens_but_gives_nothing_is_not_hammered() -> None:
    camera = Flaky(False, True, False, True, False, True, True)
    told = await told_of(camera)
    assert camera.waited_s[:3] == [0.2, 0.4, 0.8]
    assert told[:2] == ["camera: is pulled out; trying again", ""]


async def test_a_picture_ends_the_back_off() -> None:
    camera = Flaky(False, False, True, True, False, True, True)
    told = await told_of(camera)
    assert camera.waited_s[:3] == [0.2, 0.4, 0.2]
    assert told[:4] == 2 * ["camera: is pulled out; trying again", ""]


def test_a_camera_that_stays_away_does_not_stop_virtual_time() -> None:
    class Away(Flaky):
        def read(self, timeout_s: float) -> Frame:
            raise DeviceError("is pulled out")

    loop = VirtualTimeLoop()
    camera = Away()
    tracking = TrackingLoop(camera, Blind(), lambda *_: None, lambda _: None, sleep=loop.waiting.sleep)

    async def a_while() -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(20.0):
                await tracking.run()

    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        runner.run(a_while())
    assert len(camera.waited_s) == 7
