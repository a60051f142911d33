"""Camera to track, in one worker thread: waiting, decoding and fitting never hold the event loop."""

import asyncio
import threading
import time
from collections.abc import Callable
from typing import Protocol

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.records import Frame, Track
from mrnav_server.devices.base import Camera

_FIRST_RETRY_S = 0.2
_LAST_RETRY_S = 5.0


class FrameTracker(Protocol):
    """Anything that finds the robot in a frame."""

    def update(self, frame: Frame) -> Track:
        """Return where the robot is in this frame."""


class CameraWatch(Protocol):
    """Anything that tells from its frames whether a camera is well."""

    def look(self, frame: Frame, now_s: float) -> str:
        """Return what is wrong with the camera, or ""; told when the frame arrived."""


class TrackingLoop:
    """Reads an open camera, tracks, and hands both to the event loop.

    A camera that fails is closed and reopened with back-off; meanwhile no track arrives, which holds the rig.
    A camera that delivers what must not be believed is named too; the tracker rejects those frames, so that
    the robot's last position ages by capture time, which holds the rig as well.

    Args:
        camera: Already open; closed when the loop ends.
        tracker: Finds the robot.
        on_track: Called on the event loop with every frame and its track.
        on_camera: Called on the event loop with what is wrong with the camera, whenever that changes; ""
            once it works again.
        watch: Looks at every frame; None to take them as they come.
        clock: The clock of the frames' capture times.
        sleep: How a thread waits for a time in seconds, by that clock.
    """

    def __init__(
        self,
        camera: Camera,
        tracker: FrameTracker,
        on_track: Callable[[Frame, Track], None],
        on_camera: Callable[[str], None],
        watch: CameraWatch | None = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._camera = camera
        self._tracker = tracker
        self._on_track = on_track
        self._on_camera = on_camera
        self._watch = watch
        self._clock = clock
        self._sleep = sleep
        self._told = ""
        self._ending = threading.Event()

    async def run(self) -> None:
        """Track until cancelled; a bug in the tracker ends the loop with its exception."""
        loop = asyncio.get_running_loop()
        worker = loop.run_in_executor(None, self._work, loop)
        try:
            await asyncio.shield(worker)
        finally:
            self._ending.set()
            await asyncio.wait({worker}, timeout=2.0)

    def _work(self, loop: asyncio.AbstractEventLoop) -> None:
        retry_s = _FIRST_RETRY_S
        try:
            while not self._ending.is_set():
                try:
                    while not self._ending.is_set():
                        frame = self._camera.read(timeout_s=0.5)
                        fault = self._watch.look(frame, self._clock()) if self._watch else ""
                        loop.call_soon_threadsafe(self._on_track, frame, self._tracker.update(frame))
                        self._tell(loop, fault)
                        retry_s = _FIRST_RETRY_S
                except DeviceError as error:
                    self._tell(loop, f"camera: {error}; trying again")
                    retry_s = self._reopen(retry_s)
        finally:
            self._camera.close()

    def _tell(self, loop: asyncio.AbstractEventLoop, fault: str) -> None:
        if fault != self._told:
            self._told = fault
            loop.call_soon_threadsafe(self._on_camera, fault)

    def _reopen(self, retry_s: float) -> float:
        self._camera.close()
        while self._waited(retry_s):
            retry_s = min(2 * retry_s, _LAST_RETRY_S)
            try:
                self._camera.open()
            except DeviceError:
                continue
            break
        return retry_s

    def _waited(self, seconds: float) -> bool:
        """Wait in short sleeps, for the loop's end waits for no retry; return whether it still runs."""
        for _ in range(round(seconds / _FIRST_RETRY_S)):
            if self._ending.is_set():
                return False
            self._sleep(_FIRST_RETRY_S)
        return not self._ending.is_set()
