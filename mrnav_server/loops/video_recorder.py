"""Records video as it was encoded for viewers: JPEGs with their capture times, in a Matroska file.

The file's stamps are true, not counted: a variable frame rate, 1 ms fine. Whoever hands over a picture never
waits; a thread writes, and what it cannot keep up with is dropped and counted.
"""

import errno
import queue
import shutil
import threading
from contextlib import ExitStack, closing
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np

from mrnav_server.core.errors import ConfigError

VIDEO_NAME = "video.mkv"
FIRST_TAKEN_KEY = "FIRST_TAKEN_S"
"""Tag of the file with the capture time of its first frame, monotonic, in seconds, as in the trial's log."""
_TICKS_PER_S = 1000
"""Matroska's usual resolution, and the one that players expect."""
MAX_WAITING_FRAMES = 60
_CHECK_SPACE_FRAMES = 30
_OPTIONS = {"cluster_time_limit": "1000", "flush_packets": "1"}
"""What a crash leaves can be played up to its last second."""


@dataclass(frozen=True, slots=True)
class VideoConfig:
    """Whether and how trials are filmed.

    Attributes:
        enabled: Film every trial; needs the extra ``video``.
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


def load_library() -> None:
    """Load what writes films; during control, a first import would stall it.

    Raises:
        ConfigError: If the extra is missing.
    """
    try:
        import av  # noqa: F401
    except ImportError:
        raise ConfigError(
            "video.enabled needs PyAV: install mrnav-server[video], or set it to false"
        ) from None


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
        fps: Nominal frames a second, for players.
        min_free_mb: Below this much free space, in MB, it stops.
    """

    def __init__(self, path: Path, fps: float, min_free_mb: float = 0.0) -> None:
        self._path = path
        self._fps = fps
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
        import av

        try:
            with ExitStack() as files:
                film: _Film | None = None
                while (item := self._waiting.get()) is not None:
                    if self._frames % _CHECK_SPACE_FRAMES == 0:
                        self._require_space()
                    if film is None:
                        film = files.enter_context(closing(_Film(self._path, self._fps, *item)))
                        self._first_s = item[0]
                    self._frames += film.add(*item)
        except (av.FFmpegError, OSError) as error:
            self._fault = f"the video {self._path} ended early: {error.strerror}"

    def _require_space(self) -> None:
        free_mb = shutil.disk_usage(self._path.parent).free / 1e6
        if free_mb < self._min_free_mb:
            raise OSError(errno.ENOSPC, f"{free_mb:.0f} MB are free, {self._min_free_mb:.0f} MB are needed")


class _Film:
    """A Matroska file that is being written.

    Args:
        path: The file, made here.
        fps: Nominal frames a second.
        taken_s: Capture time of the first frame.
        jpeg: The first frame; it sets the size.
    """

    def __init__(self, path: Path, fps: float, taken_s: float, jpeg: bytes) -> None:
        import av

        image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
        if image is None:
            raise OSError(errno.EINVAL, "the first picture is no JPEG")
        self._container = av.open(str(path), "w", format="matroska", options=_OPTIONS)
        self._container.metadata[FIRST_TAKEN_KEY] = f"{taken_s:.6f}"
        self._stream = self._container.add_stream("mjpeg", rate=Fraction(fps).limit_denominator(1001))
        self._stream.height, self._stream.width = image.shape[:2]
        self._stream.pix_fmt = "yuvj420p"
        self._stream.time_base = Fraction(1, _TICKS_PER_S)
        self._first_s = taken_s
        self._last_ticks = -1

    def add(self, taken_s: float, jpeg: bytes) -> bool:
        """Write a frame; False for one that is not later than the one before."""
        import av

        ticks = round((taken_s - self._first_s) * _TICKS_PER_S)
        if ticks <= self._last_ticks:
            return False
        packet = av.Packet(jpeg)
        packet.stream, packet.time_base = self._stream, Fraction(1, _TICKS_PER_S)
        packet.pts = packet.dts = self._last_ticks = ticks
        packet.is_keyframe = True
        self._container.mux(packet)
        return True

    def close(self) -> None:
        """Write the file's end."""
        self._container.close()
