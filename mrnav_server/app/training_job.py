"""A command that computes for minutes: in a process of its own, behind everything that the server does."""

import os
import subprocess
import sys
import threading
from collections.abc import Sequence
from typing import IO, Any

import orjson

_NICENESS = 15
_END_S = 5.0


class Job:
    """One running ``mrnav`` command that prints lines of JSON.

    It does not outlive the server: its next line finds no reader.

    Args:
        arguments: The command and its options.
    """

    def __init__(self, arguments: Sequence[str]) -> None:
        self.told: dict[str, Any] = {}
        """The newest line of JSON."""
        self.cancelled = False
        self._said = ""
        self._process = subprocess.Popen(
            [sys.executable, "-m", "mrnav_server.cli.main", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            creationflags=getattr(subprocess, "BELOW_NORMAL_PRIORITY_CLASS", 0),
        )
        if hasattr(os, "setpriority"):
            os.setpriority(os.PRIO_PROCESS, self._process.pid, _NICENESS)
        assert self._process.stdout is not None
        self._reader = threading.Thread(target=self._read, args=(self._process.stdout,), name="training")
        self._reader.daemon = True
        self._reader.start()

    @property
    def running(self) -> bool:
        """Whether there is more to come."""
        return self._reader.is_alive()

    @property
    def failure(self) -> str:
        """Why it ended without a result, in the command's own words; "" while it runs, and if it did well."""
        if self.running or self._process.wait() == 0:
            return ""
        return self._said or f"the command ended with {self._process.returncode}, without a word"

    def end(self) -> None:
        """End it, and wait until it has ended."""
        self.cancelled = self.cancelled or self.running
        self._process.terminate()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join()

    def _read(self, output: IO[bytes]) -> None:
        with output:
            for line in output:
                if line.startswith(b"{"):
                    self.told = orjson.loads(line)
                elif text := line.decode(errors="replace").strip():
                    self._said = text.removeprefix("error:").strip()
