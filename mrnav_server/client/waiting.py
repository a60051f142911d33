"""How a client waits: in real time, or in the virtual time of a simulated rig in the same process."""

import select
import socket
import time
from typing import Protocol


class Waiting(Protocol):
    """Tells the time and waits. Every client of one process takes the same."""

    def now_s(self) -> float:
        """Return the time in seconds, from a clock that never goes back."""

    def sleep(self, duration_s: float) -> None:
        """Wait for a while."""

    def readable(self, source: socket.socket, until_s: float) -> bool:
        """Wait until there is something to read, at most until a time; tell whether there is."""


class RealWaiting:
    """Waits as long as it takes."""

    def now_s(self) -> float:
        """Return the monotonic time in seconds."""
        return time.monotonic()

    def sleep(self, duration_s: float) -> None:
        """Wait for a while."""
        time.sleep(duration_s)

    def readable(self, source: socket.socket, until_s: float) -> bool:
        """Wait until there is something to read, at most until a time; tell whether there is."""
        return bool(select.select([source], [], [], max(until_s - self.now_s(), 0.0))[0])


REAL: Waiting = RealWaiting()
