"""A USB microscope or any other camera that Linux shows as ``/dev/videoN`` (V4L2, through OpenCV)."""

import itertools
import logging
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Frame
from mrnav_server.devices.grabber import GrabbedCamera
from mrnav_server.devices.pictures import RateMeter, is_another_rate, to_bgr
from mrnav_server.devices.v4l2 import AUTOMATIC, Capture, Controls, choose_mode, open_capture, set_controls

_OPEN_S = 5.0
_log = logging.getLogger(__name__)


class UsbCamera(GrabbedCamera):
    """A camera behind ``cv2.VideoCapture``.

    One thread owns the capture from opening to release: OpenCV may block for ten seconds in a read of a
    camera that was pulled out, and releasing it meanwhile from elsewhere is not safe.

    Frames are stamped right after ``grab`` returns. That is later than the exposure by read-out and transfer,
    about one frame period, which V4L2 does not tell; it is never earlier.

    Raw pictures are preferred where the camera promises them at the size and rate that are asked for, which
    takes USB 3 at 1600×1200 and 30 fps; Motion JPEG otherwise. The rate is measured over the first frames,
    since a camera in poor light keeps its exposure rather than its promise.

    Args:
        index: N of ``/dev/videoN``.
        picture: What to ask for. Another size is refused, another rate is named and taken.
        clock: Monotonic time in seconds.
        controls: Exposure and gain.
        open_capture: Opens the camera with that index; None if it cannot be opened.
        devices: Folder that holds ``videoN``.
        open_timeout_s: How long opening may take, first picture included.
    """

    def __init__(
        self,
        index: int,
        picture: PictureFormat,
        clock: Callable[[], float],
        controls: Controls = AUTOMATIC,
        open_capture: Callable[[int], Capture | None] = open_capture,
        devices: Path = Path("/dev"),
        open_timeout_s: float = _OPEN_S,
    ) -> None:
        super().__init__(f"USB camera {index}", open_timeout_s, "pull it out and plug it in")
        self._index = index
        self._asked = picture
        self._clock = clock
        self._controls = controls
        self._open_capture = open_capture
        self._node = devices / f"video{index}"
        self._format = ""

    @property
    def format(self) -> str:
        """What the camera really gives, in words; "" before it was opened. The rate is measured by and by."""
        return self._format

    def _frames(self, ending: threading.Event) -> Iterator[Frame]:
        capture = self._open_capture(self._index)
        if capture is None:
            raise DeviceError(self._why_not())
        try:
            yield from self._grab(capture, ending)
        except cv2.error as error:
            raise DeviceError(f"{self._name} failed: {error}") from None
        finally:
            capture.release()

    def _grab(self, capture: Capture, ending: threading.Event) -> Iterator[Frame]:
        mode = choose_mode(capture, self._asked)
        controls = set_controls(capture, self._controls, self._name)
        self._format = ", ".join(filter(None, (str(mode), controls)))
        meter = RateMeter()
        for number in itertools.count():
            grabbed = capture.grab()
            taken_s = self._clock()
            if ending.is_set():
                return
            if not grabbed:
                raise DeviceError(f"{self._name} gives no more pictures: is {self._node} pulled out?")
            decoded, image = capture.retrieve()
            fps = meter.add(taken_s)
            if fps is not None:
                self._tell_rate(fps)
            if not decoded:
                continue
            frame = Frame(number, taken_s, to_bgr(np.asarray(image), self._asked, self._name))
            if number == 0:
                _log.info("%s: %s", self._name, self._format)
            yield frame

    def _tell_rate(self, fps: float) -> None:
        self._format += f", measured {fps:.1f} fps"
        if is_another_rate(fps, self._asked):
            fault = f"gives {fps:.1f} fps, not {self._asked.fps:g}"
            remedy = (
                "lower camera.exposure_ms or add light, and use a USB 3 port of its own"
                if fps < self._asked.fps
                else f"set camera.fps = {fps:.0f}"
            )
            self._format += f": {remedy}"
            _log.warning("%s %s: %s", self._name, fault, remedy)

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
