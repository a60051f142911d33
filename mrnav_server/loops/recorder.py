"""Records a trial: the control loop appends to a queue, one thread encodes it and writes it to disk.

Nothing here may hold up the loop, so a full or failing disk shows as ``fault``, which the loop asks for.
"""

import logging
import os
import shutil
import threading
from asyncio import to_thread
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from mrnav_server.core.errors import RefusedError
from mrnav_server.loops.trial_log import (
    CLOSED_TOPIC,
    LOG_NAME,
    TrialHeader,
    header_line,
    log_line,
    mark_interrupted,
    new_trial_id,
)

_log = logging.getLogger(__name__)

_MAX_WAITING_LINES = 200_000
_PART_SUFFIX = ".part"

_Line = tuple[int, float, str, Mapping[str, object]]
"""Number, monotonic time in s, topic, data."""


@dataclass(frozen=True, slots=True)
class RecorderConfig:
    """How trials are written.

    Attributes:
        flush_s: What is recorded is on its way to the disk after this long, 0.02 to 1 s.
        min_free_mb: Below this much free space, in MB, a trial does not start and a running one is flagged.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    flush_s: float = 0.1
    min_free_mb: float = 500.0

    def __post_init__(self) -> None:
        if not 0.02 <= self.flush_s <= 1.0:
            raise ValueError("flush_s must lie between 0.02 and 1 s")
        if not self.min_free_mb >= 0.0:
            raise ValueError("min_free_mb must not be negative")


class Recorder:
    """Writes one append-only log per trial under ``root/<trial-id>/log.jsonl``.

    Args:
        root: Folder of all trials; made when the first one starts.
        clock: Monotonic time in seconds.
        config: How trials are written.
        wall_clock: Local time, for ids and labels.
    """

    def __init__(
        self,
        root: Path,
        clock: Callable[[], float],
        config: RecorderConfig | None = None,
        wall_clock: Callable[[], datetime] = lambda: datetime.now(UTC).astimezone(),
    ) -> None:
        self._root = root
        self._clock = clock
        self._config = config or RecorderConfig()
        self._wall_clock = wall_clock
        self._seq = 0
        self._trial: str | None = None
        self._writer: _Writer | None = None

    @property
    def trial(self) -> str | None:
        """Id of the running trial; None without one."""
        return self._trial

    @property
    def fault(self) -> str:
        """Why the running trial is not being kept, in plain words; "" while all is well."""
        return self._writer.fault if self._writer else ""

    def recover(self) -> list[str]:
        """Mark the trials that a crash left open as interrupted; return their ids. Call once, at start."""
        return mark_interrupted(self._root, self._clock(), self._wall_clock().timestamp())

    def start_trial(
        self, header: TrialHeader, beginning: Mapping[str, Mapping[str, object]] | None = None
    ) -> str:
        """Begin a log and return the new trial's id.

        Args:
            header: What a reader must know first.
            beginning: The first messages by their topics; with the header they are on disk at once.

        Raises:
            RefusedError: ``trial_running``, ``bad_participant``, ``disk_full`` or ``disk_error``.
        """
        if self._trial is not None:
            raise RefusedError("trial_running", f"end trial {self._trial} first")
        now, now_s = self._wall_clock(), self._clock()
        # Wall time follows the monotonic clock from here on: a clock that is set back reorders nothing.
        wall_offset_s = now.timestamp() - now_s
        trial_id = new_trial_id(self._root, header.participant, now)
        folder = self._root / trial_id
        lines = [header_line(trial_id, header)]
        for topic, data in (beginning or {}).items():
            lines.append(log_line(len(lines), now_s, now.timestamp(), topic, data))
        try:
            self._root.mkdir(parents=True, exist_ok=True)
            shortage = _shortage(self._root, self._config.min_free_mb)
            if shortage:
                raise RefusedError("disk_full", f"{shortage}; free some or set another trials folder")
            folder.mkdir()
            self._writer = _Writer(folder / LOG_NAME, b"".join(lines), wall_offset_s, self._config)
        except OSError as error:
            raise RefusedError("disk_error", f"{folder} cannot be written: {error.strerror}") from None
        self._seq = len(lines) - 1
        self._trial = trial_id
        self._writer.start()
        return trial_id

    def record(self, topic: str, data: Mapping[str, object]) -> None:
        """Note one message of the running trial; without one, nothing happens. Never waits.

        Args:
            topic: What it is.
            data: Fields ready for JSON, which nobody changes any more: they are encoded later. Numbers that
                are not finite become null.
        """
        if self._writer is None:
            return
        self._seq += 1
        self._writer.append((self._seq, self._clock(), topic, data))

    async def end_trial(self) -> Path | None:
        """Close the log safely on disk; return the trial's folder, None if no trial runs."""
        writer, trial_id = self._writer, self._trial
        if writer is None or trial_id is None:
            return None
        self.record(CLOSED_TOPIC, {"status": "ended", "lost_lines": writer.lost_lines})
        self._writer = self._trial = None
        await to_thread(writer.finish)
        return self._root / trial_id


class _Writer(threading.Thread):
    """Writes the beginning at once and queued lines every ``flush_s``, and syncs at the end.

    What a write did not take stays first in line, so the file is always a prefix of the log.
    """

    def __init__(self, path: Path, beginning: bytes, wall_offset_s: float, config: RecorderConfig) -> None:
        super().__init__(name="recorder", daemon=True)
        self._config = config
        self._folder = path.parent
        self._wall_offset_s = wall_offset_s
        part = path.with_suffix(_PART_SUFFIX)
        self._file = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644)
        while beginning:
            beginning = beginning[os.write(self._file, beginning) :]
        # A crash leaves either no log, or one with its whole beginning.
        part.rename(path)
        self._lines: deque[_Line] = deque()
        self._unwritten = b""
        self._ending = threading.Event()
        self.lost_lines = 0
        self.fault = ""

    def append(self, line: _Line) -> None:
        if len(self._lines) >= _MAX_WAITING_LINES:
            self.lost_lines += 1
        else:
            self._lines.append(line)

    def finish(self) -> None:
        self._ending.set()
        self.join()

    def run(self) -> None:
        while not self._ending.wait(self._config.flush_s):
            self._write()
        self._write()
        try:
            os.fsync(self._file)
        except OSError as error:
            self.fault = f"the trial's log cannot be kept: {error.strerror}"
        os.close(self._file)

    def _write(self) -> None:
        if not self._unwritten:
            self._unwritten = b"".join(self._encoded(self._lines.popleft()) for _ in range(len(self._lines)))
        try:
            while self._unwritten:
                self._unwritten = self._unwritten[os.write(self._file, self._unwritten) :]
            self.fault = _shortage(self._folder, self._config.min_free_mb)
        except OSError as error:
            self.fault = f"the trial's log cannot be written: {error.strerror}"

    def _encoded(self, line: _Line) -> bytes:
        seq, t_s, topic, data = line
        try:
            return log_line(seq, t_s, t_s + self._wall_offset_s, topic, data)
        except TypeError as error:
            _log.error("a line of topic %s is no JSON and was left out: %s", topic, error)
            self.lost_lines += 1
            return b""


def _shortage(folder: Path, min_free_mb: float) -> str:
    """Return what is wrong with the free space, in plain words; "" if there is enough."""
    free_mb = shutil.disk_usage(folder).free / 1e6
    if free_mb >= min_free_mb:
        return ""
    return f"only {free_mb:.0f} MB are free for trials, {min_free_mb:.0f} MB are needed"
