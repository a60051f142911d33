"""Records video as it was encoded for viewers: JPEGs with their capture times, in a Matroska file.

The file's stamps are true, not counted: a variable frame rate, 1 ms fine. Whoever hands over a picture never
waits; a thread writes, and what it cannot keep up with is dropped and counted.
"""

import errno
import logging
import queue
import shutil
import threading
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from mrnav_server.loops.matroska import TICKS_PER_S, MatroskaMuxer

VIDEO_NAME = "video.mkv"
FIRST_TAKEN_KEY = "FIRST_TAKEN_S"
"""Tag of the file with the capture time of its first frame, monotonic, in seconds, as in the trial's log."""
MAX_WAITING_FRAMES = 60
_CHECK_SPACE_FRAMES = 30
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class VideoConfig:
    """Whether and how trials are filmed.

    Attributes:
        enabled: Film every trial.
        width_px: Width of the film, 64..4096; at the width and quality that viewers ask for (800 and 75) it
            costs no encoding of its own.
        quality: JPEG quality, 10..95.
        min_free_mb: Below this much free space, in MB, filming stops; far above the bound at which the log
            is in danger.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    enabled: bool = False
    width_px: int = 800
    quality: int = 75
    min_free_mb: float = 2000.0

    def __post_init__(self) -> None:
        if not 64 <= self.width_px <= 4096:
            raise ValueError("width_px must lie between 64 and 4096")
        if not 10 <= self.quality <= 95:
            raise ValueError("quality must lie between 10 and 95")
        if not self.min_free_mb >= 0.0:
            raise ValueError("min_free_mb must not be negative")


@dataclass(frozen=True, slots=True)
class VideoSummary:
    """What became of a recording.

    Attributes:
        frames: Frames in the file.
        dropped: Frames that were handed over but are not in the file.
        first_taken_s: Capture time of the file's first frame, monotonic, in seconds; None without frames.
        fault: Why it ended early, in plain words; "" if it did not.
    """

    frames: int
    dropped: int
    first_taken_s: float | None
    fault: str


class VideoRecorder:
    """Writes one film. Starts at once; ``finish`` closes the file.

    Args:
        path: The file; it appears with the first frame.
        min_free_mb: Below this much free space, in MB, it stops.
    """

    def __init__(self, path: Path, min_free_mb: float = 0.0) -> None:
        self._path = path
        self._min_free_mb = min_free_mb
        self._waiting: queue.Queue[tuple[float, bytes] | None] = queue.Queue()
        self._added = self._frames = 0
        self._first_s: float | None = None
        self._fault = ""
        self._thread = threading.Thread(target=self._run, name="video recorder", daemon=True)
        self._thread.start()

    @property
    def fault(self) -> str:
        """Why nothing is recorded any more, in plain words; "" while all is well."""
        return self._fault

    def add(self, taken_s: float, jpeg: bytes) -> None:
        """Record a picture; never waits.

        Args:
            taken_s: Its capture time, monotonic, in seconds.
            jpeg: The picture. All pictures of a film have the same size.
        """
        self._added += 1
        if self._waiting.qsize() < MAX_WAITING_FRAMES:
            self._waiting.put((taken_s, jpeg))

    def finish(self) -> VideoSummary:
        """Write what waits, close the file and tell what is in it. Waits for the disk."""
        self._waiting.put(None)
        self._thread.join()
        return VideoSummary(self._frames, self._added - self._frames, self._first_s, self._fault)

    def _run(self) -> None:
        film: _Film | None = None
        try:
            with ExitStack() as files:
                for number, (taken_s, jpeg) in enumerate(iter(self._waiting.get, None)):
                    if number % _CHECK_SPACE_FRAMES == 0:
                        self._require_space()
                    if film is None:
                        film = files.enter_context(closing(_Film(self._path, taken_s, jpeg)))
                    film.add(taken_s, jpeg)
        except OSError as error:
            self._fault = f"the video {self._path} ended early: {error.strerror}"
            _log.warning("%s", self._fault)
        if film is not None and film.frames:
            self._frames, self._first_s = film.frames, film.first_s

    def _require_space(self) -> None:
        free_mb = shutil.disk_usage(self._path.parent).free / 1e6
        if free_mb < self._min_free_mb:
            raise OSError(errno.ENOSPC, f"{free_mb:.0f} MB are free, {self._min_free_mb:.0f} MB are needed")


class _Film:
    """A Matroska file that is being written.

    Args:
        path: The file, made here.
        taken_s: Capture time of the first frame.
        jpeg: The first frame; it sets the size.
    """

    def __init__(self, path: Path, taken_s: float, jpeg: bytes) -> None:
        image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
        if image is None:
            raise OSError(errno.EINVAL, "the first picture is no JPEG")
        height_px, width_px = image.shape[:2]
        self._muxer = MatroskaMuxer(width_px, height_px, {FIRST_TAKEN_KEY: f"{taken_s:.6f}"})
        # Unbuffered: a cluster is the system's, whatever happens to this process, once it is written.
        self._file = path.open("wb", buffering=0)
        self.first_s = taken_s
        self.frames = 0
        """Frames that are in the file."""
        self._last_ticks = -1
        self._failed = False
        try:
            self._append(self._muxer.head)
        except OSError:
            self._file.close()
            raise

    def add(self, taken_s: float, jpeg: bytes) -> None:
        """Take a frame, unless it is not later than the one before."""
        ticks = round((taken_s - self.first_s) * TICKS_PER_S)
        if ticks > self._last_ticks:
            self._last_ticks = ticks
            self._append(self._muxer.add(ticks, jpeg))

    def close(self) -> None:
        """Write the file's end; after a failure, leave it as a crash would, which plays as well."""
        with self._file:
            if self._failed:
                return
            self._append(self._muxer.tail())
            for offset, content in self._muxer.patches():
                self._file.seek(offset)
                self._write(content)

    def _append(self, content: bytes) -> None:
        """Write all of it or, on a full disk, none: half a cluster would swallow what follows it."""
        end = self._file.tell()
        try:
            self._write(content)
        except OSError:
            self._file.seek(end)
            self._file.truncate()
            self._failed = True
            raise
        self.frames = self._muxer.frames

    def _write(self, content: bytes) -> None:
        rest = memoryview(content)
        while rest:
            rest = rest[self._file.write(rest) :]
