"""A video file in the camera's place: in real time by its own time stamps, or as fast as it is read."""

import logging
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from mrnav_server.core.errors import DeviceError, DeviceTimeoutError
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Frame
from mrnav_server.devices.pictures import RateMeter, is_another_rate, to_bgr

_log = logging.getLogger(__name__)


class VideoFileCamera:
    """Plays a film that OpenCV reads (AVI, MP4, Matroska and others).

    A frame's capture time is its time stamp in the file, counted from the moment of opening, so that a film
    at a variable rate keeps its own. In real time a frame is delivered when it is due, and a reader that
    comes late misses frames, which the numbers show. As fast as possible every frame is delivered at once,
    and the capture times run ahead of the clock.

    A gap in a film that is longer than the reader waits is a timeout, as with a camera.

    Args:
        path: The film.
        picture: The size that it must have; another rate is named and taken.
        clock: Monotonic time in seconds.
        loop: Begin anew at the end; numbers and capture times go on.
        as_fast_as_possible: Wait for no frame and skip none.
        sleep: Waits for a time in seconds.
    """

    def __init__(
        self,
        path: Path,
        picture: PictureFormat,
        clock: Callable[[], float],
        *,
        loop: bool = False,
        as_fast_as_possible: bool = False,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._path = path
        self._asked = picture
        self._clock = clock
        self._loop = loop
        self._real_time = not as_fast_as_possible
        self._sleep = sleep
        self._name = f"the video {path}"
        self._format = ""
        self._capture: cv2.VideoCapture | None = None
        self._ended = False
        self._grabbed = False
        self._number = 0
        self._taken_s = self._base_s = self._first_stamp_s = 0.0
        self._period_s = 1.0 / picture.fps
        self._meter = RateMeter()

    @property
    def format(self) -> str:
        """What the file gives, in words; "" before it was opened. The rate is measured by and by."""
        return self._format

    def open(self) -> None:
        """Begin with the file's first frame, which is due now.

        Raises:
            DeviceError: If there is no such video, it has another size, or it was played to its end before.
        """
        self.close()
        if self._ended:
            raise DeviceError(self._end())
        self._capture = self._opened()
        self._number, self._period_s = 0, 1.0 / self._asked.fps
        self._base_s = self._taken_s = self._clock()
        self._first_stamp_s = self._stamp_s()
        self._grabbed = True
        self._meter = RateMeter()
        self._meter.add(self._taken_s)
        self._format = f"video file {self._asked.width_px}×{self._asked.height_px}"

    def read(self, timeout_s: float) -> Frame:
        """Return the next frame when it is due; in real time those that are overdue are skipped.

        Raises:
            DeviceTimeoutError: If the next frame is due only later.
            DeviceError: If the video is not open or has ended.
        """
        if not self._grabbed:
            self._advance()
        if self._real_time:
            # Decided once: a machine that decodes slower than the film runs must not skip for ever.
            for _ in range(int((self._clock() - self._taken_s) / self._period_s)):
                self._advance()
            early_s = self._taken_s - self._clock()
            if early_s > 0.0:
                self._sleep(min(early_s, timeout_s))
            if early_s > timeout_s:
                raise DeviceTimeoutError(f"{self._name} has no frame within {timeout_s:g} s")
        self._grabbed = False
        decoded, image = self._opened_capture().retrieve()
        if not decoded:
            raise DeviceError(f"{self._name} is damaged at frame {self._number}")
        return Frame(self._number, self._taken_s, to_bgr(np.asarray(image), self._asked, self._name))

    def close(self) -> None:
        """Give the file back."""
        if self._capture is not None:
            self._capture.release()
        self._capture, self._grabbed = None, False

    def _opened(self) -> cv2.VideoCapture:
        """Return the film with its first frame grabbed and found to be of the right size."""
        if not self._path.is_file():
            raise DeviceError(f"{self._name} does not exist: set camera.file to a video file")
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        # FFmpeg alone: other readers of OpenCV take a name with digits for a series of pictures.
        capture = cv2.VideoCapture(str(self._path), cv2.CAP_FFMPEG)
        try:
            decoded, image = capture.retrieve() if capture.grab() else (False, None)
            if not decoded:
                raise DeviceError(
                    f"{self._name} cannot be read: set camera.file to an AVI, MP4 or Matroska file"
                )
            to_bgr(np.asarray(image), self._asked, self._name)
        except DeviceError:
            capture.release()
            raise
        return capture

    def _opened_capture(self) -> cv2.VideoCapture:
        if self._capture is None:
            raise DeviceError(f"{self._name} is not open: open it first")
        return self._capture

    def _advance(self) -> None:
        """Go to the next frame and its capture time."""
        before_s = self._taken_s
        if self._opened_capture().grab():
            stamp_s = self._base_s + self._stamp_s() - self._first_stamp_s
            # Some films have no stamps.
            self._taken_s = stamp_s if stamp_s > before_s else before_s + self._period_s
            self._period_s = self._taken_s - before_s
        elif self._loop:
            self.close()
            self._capture = self._opened()
            self._first_stamp_s = self._stamp_s()
            self._base_s = self._taken_s = before_s + self._period_s
        else:
            self._ended = True
            raise DeviceError(self._end())
        self._grabbed = True
        self._number += 1
        self._tell_rate(self._meter.add(self._taken_s))

    def _stamp_s(self) -> float:
        return 1e-3 * self._opened_capture().get(cv2.CAP_PROP_POS_MSEC)

    def _tell_rate(self, fps: float | None) -> None:
        if fps is None:
            return
        self._format += f" at {fps:.1f} fps"
        if is_another_rate(fps, self._asked):
            remedy = f"set camera.fps = {fps:.0f}"
            self._format += f", not {self._asked.fps:g}: {remedy}"
            _log.warning("%s gives %.1f fps, not %g: %s", self._name, fps, self._asked.fps, remedy)

    def _end(self) -> str:
        return f"{self._name} has ended: set camera.loop = true to play it again and again, or choose another"
