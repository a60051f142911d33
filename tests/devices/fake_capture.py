"""A ``cv2.VideoCapture`` whose pictures come when the test gives them."""

import queue
import threading
from collections.abc import Callable

import cv2

from mrnav_server.core.arrays import ByteArray

PULLED_OUT = None


class FakeCapture:
    """Grabbing waits for the next picture that is given, and takes until the time that is given with it."""

    def __init__(self, *pictures: ByteArray | str | None, fps: float = 30.0) -> None:
        self.asked: dict[int, float] = {}
        self.now_s = 0.0
        self.released = threading.Event()
        self._fps = fps
        self._given: queue.Queue[tuple[float, ByteArray | str | None]] = queue.Queue()
        self._grabbed: ByteArray | str | None = None
        self._last: ByteArray | str | None = PULLED_OUT
        self._first = True
        self._flowing = False
        for picture in pictures:
            self.give(picture)

    def give(self, picture: ByteArray | str | None, at_s: float = 0.0) -> None:
        """Give a picture, text for one that cannot be decoded, or ``PULLED_OUT``."""
        self._last = picture
        self._given.put((at_s, picture))

    def settle(self) -> None:
        """Wait until every picture that was given is handed on and the next one is waited for."""
        self._given.join()

    def flow(self) -> None:
        """Repeat the last picture from now on without waiting."""
        self._flowing = True
        self.give(self._last)

    def set(self, propId: int, value: float) -> bool:
        self.asked[propId] = value
        return True

    def get(self, propId: int) -> float:
        return self._fps if propId == cv2.CAP_PROP_FPS else -1.0

    def grab(self) -> bool:
        if not self._first:
            self._given.task_done()
        self._first = False
        if self._flowing and self._given.empty():
            self.give(self._last)
        self.now_s, self._grabbed = self._given.get()
        return self._grabbed is not PULLED_OUT

    def retrieve(self) -> tuple[bool, object]:
        self.now_s += 1000.0
        return not isinstance(self._grabbed, str), self._grabbed

    def release(self) -> None:
        self.released.set()


class Socket:
    """Where cameras are plugged in: opening takes the next one; None is an empty socket."""

    def __init__(self, *captures: FakeCapture | None) -> None:
        self._captures = list(captures)
        self.indices: list[int] = []

    def __call__(self, index: int) -> FakeCapture | None:
        self.indices.append(index)
        return self._captures.pop(0) if self._captures else None


def clock_of(capture: FakeCapture) -> Callable[[], float]:
    return lambda: capture.now_s
