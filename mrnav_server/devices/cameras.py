"""A USB microscope or any other camera that Linux shows as ``/dev/videoN`` (V4L2, through OpenCV)."""

import itertools
import logging
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import DeviceError
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Frame
from mrnav_server.devices.grabber import FrameGrabber

_OPEN_S = 5.0
_CLOSE_S = 0.5
_RATE_TOLERANCE_FPS = 0.5
_MJPG = cv2.VideoWriter.fourcc(*"MJPG")
_log = logging.getLogger(__name__)


class Capture(Protocol):
    """An opened ``cv2.VideoCapture``."""

    def set(self, propId: int, value: float) -> bool:  # noqa: N803 - OpenCV's name
        """Ask for a property; tells whether the driver takes it."""

    def get(self, propId: int) -> float:  # noqa: N803 - OpenCV's name
        """Return a property; 0 or less where the driver does not tell."""

    def grab(self) -> bool:
        """Wait for the next picture; False if there is none."""

    def retrieve(self) -> tuple[bool, object]:
        """Decode the picture that was grabbed."""

    def release(self) -> None:
        """Give the camera back."""


def open_capture(index: int) -> Capture | None:
    """Open a camera through V4L2; None if that fails. OpenCV's own lines on stderr are silenced."""
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    capture = cv2.VideoCapture(index, cv2.CAP_V4L2)
    return capture if capture.isOpened() else None


class UsbCamera:
    """A camera behind ``cv2.VideoCapture``.

    One thread owns the capture from opening to release: OpenCV may block for ten seconds in a read of a
    camera that was pulled out, and releasing it meanwhile from elsewhere is not safe. So ``close`` never
    waits long, and the camera can be opened again as soon as that read has returned.

    Frames are stamped right after ``grab`` returns. That is later than the exposure by read-out and transfer,
    about one frame period, which V4L2 does not tell; it is never earlier.

    Motion JPEG is preferred: USB 2 does not carry 1600×1200 at 30 fps uncompressed. A camera without it
    delivers what it has.

    Args:
        index: N of ``/dev/videoN``.
        picture: What to ask for. Another size is refused, another rate is logged and taken.
        clock: Monotonic time in seconds.
        open_capture: Opens the camera with that index; None if it cannot be opened.
        devices: Folder that holds ``videoN``.
        open_timeout_s: How long opening may take, first picture included.
    """

    def __init__(
        self,
        index: int,
        picture: PictureFormat,
        clock: Callable[[], float],
        open_capture: Callable[[int], Capture | None] = open_capture,
        devices: Path = Path("/dev"),
        open_timeout_s: float = _OPEN_S,
    ) -> None:
        self._index = index
        self._asked = picture
        self._clock = clock
        self._open_capture = open_capture
        self._node = devices / f"video{index}"
        self._open_timeout_s = open_timeout_s
        self._name = f"USB camera {index}"
        self._grabber: FrameGrabber | None = None

    def open(self) -> None:
        """Acquire the camera and wait for its first picture.

        Raises:
            DeviceError: If it is missing, busy or silent, or gives another size, with the remedy.
        """
        if self._grabber is not None and self._grabber.alive:
            raise DeviceError(
                f"{self._name} is still held since it was opened before: pull it out and plug it in"
            )
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
        """Give the camera back; one that hangs in a read is left to end by itself."""
        if self._grabber is not None:
            self._grabber.end(_CLOSE_S)

    def _frames(self, ending: threading.Event) -> Iterator[Frame]:
        capture = self._open_capture(self._index)
        if capture is None:
            raise DeviceError(self._why_not())
        try:
            self._ask(capture)
            for number in itertools.count():
                grabbed = capture.grab()
                taken_s = self._clock()
                if ending.is_set():
                    return
                if not grabbed:
                    raise DeviceError(f"{self._name} gives no more pictures: is {self._node} pulled out?")
                decoded, image = capture.retrieve()
                if not decoded:
                    continue
                frame = Frame(number, taken_s, self._picture(np.asarray(image)))
                if number == 0:
                    self._tell_rate(capture)
                yield frame
        except cv2.error as error:
            raise DeviceError(f"{self._name} failed: {error}") from None
        finally:
            capture.release()

    def _ask(self, capture: Capture) -> None:
        for wish, value in (
            (cv2.CAP_PROP_FOURCC, _MJPG),
            (cv2.CAP_PROP_FRAME_WIDTH, self._asked.width_px),
            (cv2.CAP_PROP_FRAME_HEIGHT, self._asked.height_px),
            (cv2.CAP_PROP_FPS, self._asked.fps),
            (cv2.CAP_PROP_BUFFERSIZE, 1),
        ):
            capture.set(wish, value)

    def _tell_rate(self, capture: Capture) -> None:
        fps = capture.get(cv2.CAP_PROP_FPS)
        if abs(fps - self._asked.fps) > _RATE_TOLERANCE_FPS:
            given = f"gives {fps:g} fps" if fps > 0 else "does not tell its rate"
            _log.warning("%s %s; asked for %g fps", self._name, given, self._asked.fps)

    def _picture(self, image: ByteArray) -> ByteArray:
        """Return a picture as BGR, shape (height, width, 3), uint8; refuse any other size and kind."""
        height_px, width_px = image.shape[:2]
        asked = self._asked
        if (width_px, height_px) != (asked.width_px, asked.height_px):
            raise DeviceError(
                f"{self._name} gives pictures of {width_px}×{height_px} px; asked for "
                f"{asked.width_px}×{asked.height_px}: set camera.width_px = {width_px} and "
                f"camera.height_px = {height_px}, or take a camera that has this size"
            )
        channels = 1 if image.ndim == 2 else image.shape[2]
        if image.dtype != np.uint8 or channels not in (1, 3):
            kind = f"{channels} channels of {image.dtype}"
            raise DeviceError(
                f"{self._name} gives pictures of {kind}: take one that gives 8-bit gray or colour"
            )
        if channels == 1:
            return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR).astype(np.uint8, copy=False)
        return image

    def _why_not(self) -> str:
        asked = f"{self._name} cannot be opened"
        if not self._node.exists():
            others = sorted(
                map(str, self._node.parent.glob("video[0-9]*")), key=lambda name: (len(name), name)
            )
            if others:
                there = f"there is {', '.join(others)}: set camera.index to its number"
            else:
                there = 'no camera is connected: plug one in, or set rig.camera to "simulated"'
            return f"{asked}: {self._node} does not exist; {there}"
        if not os.access(self._node, os.R_OK | os.W_OK):
            return f"{asked}: this user may not use {self._node}: add the user to the group that owns it"
        return (
            f"{asked}: another program uses {self._node}, or it is no camera: end that program, or set "
            "camera.index to another one"
        )
