"""A hand on the hand link: a thread sends 60 messages a second, and closes the clutch when it is told."""

import json
import socket
import threading
import time
from contextlib import suppress
from typing import Any, Self

_PERIOD_S = 1 / 60


class HandClient:
    """Connects, says hello, and sends a hand that rests or moves.

    Args:
        port: Of the hand link.
        token: The operator's.
    """

    def __init__(self, port: int, token: str) -> None:
        self._lock = threading.Lock()
        self._velocity_m_per_s = (0.0, 0.0, 0.0)
        self._at_m = [0.0, 0.0, 0.0]
        self._moved_s = time.monotonic()
        self._clutch = False
        self._seq = 0
        self._ended = threading.Event()
        self._socket = socket.create_connection(("127.0.0.1", port), 5.0)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        hello = {"type": "hello", "v": 1, "role": "operator", "token": token, "client": "hand"}
        self._write(hello | {"frame": "stage", "rate_hz": 60, "simulated": True, "model": "still", "seed": 0})
        self._lines = self._socket.makefile("rb")
        self.welcome: dict[str, Any] = json.loads(self._lines.readline())
        self._threads = [
            threading.Thread(target=self._run, daemon=True),
            threading.Thread(target=self._drain, daemon=True),
        ]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._threads[0].join(2.0)
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def close_clutch(self, velocity_m_per_s: tuple[float, float, float]) -> float:
        """Close the clutch and move; return when the packet was sent, monotonic."""
        with self._lock:
            self._clutch, self._velocity_m_per_s = True, velocity_m_per_s
            return self._send()

    def open_clutch(self) -> None:
        """Open the clutch and rest."""
        with self._lock:
            self._clutch, self._velocity_m_per_s = False, (0.0, 0.0, 0.0)
            self._send()

    def _run(self) -> None:
        due_s = time.monotonic()
        while not self._ended.wait(max(due_s - time.monotonic(), 0.0)):
            due_s = max(due_s + _PERIOD_S, time.monotonic())
            with self._lock, suppress(OSError):
                self._send()

    def _send(self) -> float:
        now_s = time.monotonic()
        dt_s, self._moved_s = now_s - self._moved_s, now_s
        self._at_m = [at + v * dt_s for at, v in zip(self._at_m, self._velocity_m_per_s, strict=True)]
        self._seq += 1
        self._write(
            {"type": "hand", "seq": self._seq, "t": now_s, "p": self._at_m}
            | {"clutch": self._clutch, "valid": True}
        )
        return now_s

    def _write(self, message: dict[str, Any]) -> None:
        self._socket.sendall(json.dumps(message).encode() + b"\n")

    def _drain(self) -> None:
        with suppress(OSError, ValueError):
            while self._lines.readline():
                pass
