"""Child processes that never outlive the command that started them."""

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from mrnav_server.cli.console import TrialFailedError

_STOP_S = 10.0
_TAIL_CHARS = 2000


class Child:
    """One running `mrnav` command.

    Args:
        name: For messages.
        process: The process.
        log: Where its output goes.
    """

    def __init__(self, name: str, process: subprocess.Popen[bytes], log: Path) -> None:
        self._name = name
        self._process = process
        self._log = log

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def check(self) -> None:
        """Check that it still runs.

        Raises:
            TrialFailedError: If it has ended, with the last that it said.
        """
        code = self._process.poll()
        if code is not None:
            said = self._log.read_text(errors="replace")[-_TAIL_CHARS:].strip()
            raise TrialFailedError(f"{self._name} ended with {code}: {said or 'it said nothing'}")

    def end(self) -> None:
        """Ask it to stop; after ten seconds, kill it."""
        if self._process.poll() is None:
            self._process.terminate()
        try:
            self._process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


@contextmanager
def mrnav_child(name: str, arguments: Sequence[str], env: Mapping[str, str], log: Path) -> Iterator[Child]:
    """Run `mrnav` with arguments for the length of a ``with`` block.

    Args:
        name: For messages.
        arguments: The command and its options.
        env: Variables on top of this process's own.
        log: File that gets everything it prints.
    """
    # A session of its own: Ctrl-C reaches this process alone, which then ends its children in order.
    with log.open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "mrnav_server.cli.main", *arguments],
            env={**os.environ, **env},
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    child = Child(name, process, log)
    try:
        yield child
    finally:
        child.end()
