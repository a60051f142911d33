"""A thread that waits for a camera, so that nobody else hangs on it."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator

from mrnav_server.core.errors import DeviceError, DeviceTimeoutError
from mrnav_server.core.records import Frame

_CLOSE_S = 1.0


class FrameGrabber:
    """Takes frames in a thread of its own and keeps the newest; starts at once and ends for good.

    Args:
        name: The camera's name in messages.
        frames: Acquires the camera, yields its frames until the event is set, and gives the camera back.
    """

    def __init__(self, name: str, frames: Callable[[threading.Event], Iterator[Frame]]) -> None:
        self._name = name
        self._ending = threading.Event()
        self._changed = threading.Condition()
        self._newest: Frame | None = None
        self._fault = ""
        # A daemon: a driver that never returns must not keep the process alive either.
        self._thread = threading.Thread(target=self._run, args=(frames,), name=name, daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread still holds the camera."""
        return self._thread.is_alive()

    def wait(self, timeout_s: float) -> Frame:
        """Return the newest frame that was not taken yet, and leave it; wait if there is none.

        Raises:
            DeviceTimeoutError: If none arrives in time.
            DeviceError: If the camera fails, or the grabber was ended.
        """
        with self._changed:
            self._changed.wait_for(
                lambda: self._newest is not None or self._fault or self._ending.is_set(), timeout_s
            )
            if self._ending.is_set():
                raise DeviceError(f"{self._name} is not open: open it first")
            if self._newest is not None:
                return self._newest
            if self._fault:
                raise DeviceError(self._fault)
            raise DeviceTimeoutError(
                f"{self._name} gives no picture within {timeout_s:g} s: check its cable and its USB port"
            )

    def take(self, timeout_s: float) -> Frame:
        """Return the newest frame, each one once; as ``wait`` otherwise."""
        with self._changed:
            frame = self.wait(timeout_s)
            self._newest = None
            return frame

    def end(self, timeout_s: float) -> None:
        """Have the camera given back; wait for it, but not for longer than told."""
        with self._changed:
            self._ending.set()
            self._changed.notify_all()
        self._thread.join(timeout_s)

    def _run(self, frames: Callable[[threading.Event], Iterator[Frame]]) -> None:
        fault = f"{self._name} stopped"
        try:
            for frame in frames(self._ending):
                with self._changed:
                    self._newest = frame
                    self._changed.notify_all()
        except DeviceError as error:
            fault = str(error)
        finally:
            with self._changed:
                self._fault = fault
                self._changed.notify_all()


class GrabbedCamera(ABC):
    """A camera that one thread has from opening to closing; the newest picture wins.

    ``close`` never waits long for a driver that hangs; the camera can be opened again as soon as its thread
    has ended.

    Args:
        name: The camera's name in messages.
        open_timeout_s: How long opening may take, first picture included.
        remedy: What helps against a driver that still hangs when the camera is opened again.
    """

    def __init__(self, name: str, open_timeout_s: float, remedy: str) -> None:
        self._name = name
        self._open_timeout_s = open_timeout_s
        self._remedy = remedy
        self._grabber: FrameGrabber | None = None

    def open(self) -> None:
        """Acquire the camera and wait for its first picture.

        Raises:
            DeviceError: If it is missing, busy or silent, or gives other pictures, with the remedy.
        """
        if self._grabber is not None and self._grabber.alive:
            raise DeviceError(f"{self._name} is still held since it was opened before: {self._remedy}")
        self._grabber = FrameGrabber(self._name, self._frames)
        try:
            self._grabber.wait(self._open_timeout_s)
        except DeviceError:
            self.close()
            raise

    def read(self, timeout_s: float) -> Frame:
        """Return the newest frame that was not read yet; wait for one if there is none.

        Frames that nobody read in time are dropped; the numbers show the gap.

        Raises:
            DeviceTimeoutError: If none arrives in time.
            DeviceError: If the camera is not open, was pulled out or fails.
        """
        if self._grabber is None:
            raise DeviceError(f"{self._name} is not open: open it first")
        return self._grabber.take(timeout_s)

    def close(self) -> None:
        """Give the camera back; one that hangs is left to end by itself."""
        if self._grabber is not None:
            self._grabber.end(_CLOSE_S)

    @abstractmethod
    def _frames(self, ending: threading.Event) -> Iterator[Frame]:
        """Acquire the camera, yield its frames until the event is set, and give it back."""
