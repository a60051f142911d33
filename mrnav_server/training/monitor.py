"""What remains of a training's progress: a CSV file of its episodes, and TensorBoard where it is wanted."""

import json
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic
from typing import Any

from mrnav_server.core.errors import ConfigError
from mrnav_server.training.experience import Episodes
from mrnav_server.training.progress import Report

MONITOR_FILE = "monitor.csv"


class MonitorFile:
    """One row for every episode that ended, in the monitor format of Stable-Baselines3.

    The first line is a comment with JSON; the columns are ``r`` (sum of the published rewards), ``l``
    (steps), ``t`` (seconds since the start, at the end of the iteration), ``is_success`` and ``s``
    (environment steps of the whole run when the episode ended).

    Args:
        folder: Where ``monitor.csv`` goes.
        about: More of the first line: what is trained and how.
        size: Bytes to keep of a file that is there, from `size` at a checkpoint; 0 begins anew.
        before_s: Seconds of training before this process.
    """

    def __init__(self, folder: Path, about: dict[str, Any], size: int = 0, before_s: float = 0.0) -> None:
        path = folder / MONITOR_FILE
        self._began_s = monotonic() - before_s
        if size and path.is_file():
            with path.open("r+b") as file:
                file.truncate(size)
            self._file = path.open("a", encoding="utf-8", newline="\n")
            return
        self._file = path.open("w", encoding="utf-8", newline="\n")
        head = {"t_start": datetime.now(UTC).timestamp(), **about}
        self._file.write(f"#{json.dumps(head)}\nr,l,t,is_success,s\n")

    @property
    def size(self) -> int:
        """Bytes written so far."""
        self._file.flush()
        return self._file.tell()

    def add(self, episodes: Episodes, before_steps: int) -> None:
        """Write the episodes of an iteration, and how many steps the run had before it."""
        time_s = monotonic() - self._began_s
        rows = zip(
            episodes.rewards,
            episodes.steps,
            episodes.arrived,
            before_steps + episodes.ended_after,
            strict=True,
        )
        self._file.writelines(f"{r:.6f},{n},{time_s:.6f},{bool(won)},{s}\n" for r, n, won, s in rows)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class Board:
    """TensorBoard's event files in the folder ``tensorboard``.

    Args:
        folder: The training's output folder.

    Raises:
        ConfigError: If TensorBoard is not installed.
    """

    def __init__(self, folder: Path) -> None:
        try:
            from torch.utils.tensorboard.writer import SummaryWriter
        except ModuleNotFoundError:
            raise ConfigError(
                "--tensorboard needs TensorBoard: pip install 'mrnav-server[tensorboard]'"
            ) from None
        self._writer = SummaryWriter(str(folder / "tensorboard"))

    def add(self, report: Report) -> None:
        """Write what a report says."""
        values = {"success": report.success, "reward_per_step": report.reward, "loss": report.loss}
        for name, value in values.items():
            if value is not None:
                self._writer.add_scalar(f"{report.stage}/{name}", value, report.steps)

    def close(self) -> None:
        """Write what is left and close."""
        self._writer.close()
