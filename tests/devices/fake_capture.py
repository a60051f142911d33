"""A ``cv2.VideoCapture`` whose pictures come when the test gives them."""

import queue
import threading
from collections.abc import Callable, Collection, Mapping

import cv2

from mrnav_server.core.arrays import ByteArray

PULLED_OUT = None


class FakeCapture:
    """Grabbing waits for the next picture that is given, and takes until the time that is given with it.

    Args:
        pictures: Given at once.
        modes: Width, height and rate by pixel format; an unknown format falls back to the first.
        refuses: Properties that the driver does not take.
    """

    def __init__(
        self,
        *pictures: ByteArray | str | None,
        modes: Mapping[str, tuple[int, int, float]] | None = None,
        refuses: Collection[int] = (),
    ) -> None:
        self.asked: dict[int, float] = {}
        self._modes = modes or {"MJPG": (80, 64, 30.0)}
        self._refuses = refuses
        self.now_s = 0.0
        self.released = threading.Event()
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

    @property
    def code(self) -> str:
        """The pixel format that it is set to."""
        number = int(self.asked.get(cv2.CAP_PROP_FOURCC, 0))
        asked = number.to_bytes(4, "little").decode()
        return asked if asked in self._modes else next(iter(self._modes))

    def set(self, propId: int, value: float) -> bool:
        if propId in self._refuses:
            return False
        self.asked[propId] = value
        return True

    def get(self, propId: int) -> float:
        width_px, height_px, fps = self._modes[self.code]
        known = {
            cv2.CAP_PROP_FOURCC: cv2.VideoWriter.fourcc(*self.code),
            cv2.CAP_PROP_FRAME_WIDTH: width_px,
            cv2.CAP_PROP_FRAME_HEIGHT: height_px,
            cv2.CAP_PROP_FPS: fps,
        }
        return known.get(propId, self.asked.get(propId, -1.0))

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
