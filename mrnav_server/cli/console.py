"""The twin stream as a console sees it: it keeps the lease alive and waits for what should happen."""

import json
import time
from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Self

from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from mrnav_server.core.errors import MrnavError

State = dict[str, Any]
_HEARTBEAT_S = 0.2
_OPEN_S = 10.0


class TrialFailedError(MrnavError):
    """The trial cannot go on. Reaction: it counts as not completed, for the reason given."""


class TwinConsole:
    """One connection to ``/ws/twin``.

    Args:
        url: The server's web address.
        token: An operator's token.
        alive: Asked often; raises if a process that the trial needs has ended.

    Attributes:
        snapshot: The first message.
        state: The newest state.
        modes: Every mode that was shown, in order, repeats left out.
        events: Every event, in order.
    """

    def __init__(self, url: str, token: str, alive: Callable[[], None]) -> None:
        address = url.replace("http", "ws", 1).rstrip("/") + "/ws/twin"
        headers = {"Authorization": f"Bearer {token}"}
        self._alive = alive
        self._stack = ExitStack()
        self._socket = self._stack.enter_context(
            connect(address, additional_headers=headers, open_timeout=_OPEN_S, max_size=None, proxy=None)
        )
        self.snapshot: dict[str, Any] = json.loads(self._socket.recv(timeout=_OPEN_S))
        self.state: State = self.snapshot["state"] or {}
        self.modes: list[str] = []
        self.events: list[dict[str, Any]] = []
        self._beaten_s = 0.0
        self._watchers: list[Callable[[State], None]] = []
        self._mode_watchers: list[Callable[[State], None]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def watch(self, watcher: Callable[[State], None]) -> None:
        """Have a function called with every state from now on."""
        self._watchers.append(watcher)

    def watch_modes(self, watcher: Callable[[State], None]) -> None:
        """Have a function called with the first state of every new mode from now on."""
        self._mode_watchers.append(watcher)

    def until(self, condition: Callable[[State], bool], timeout_s: float, what: str) -> State:
        """Take messages until a state satisfies a condition; return that state.

        Raises:
            TrialFailedError: If it takes too long, or the connection ends.
        """
        deadline_s = time.monotonic() + timeout_s
        while not (self.state and condition(self.state)):
            if time.monotonic() > deadline_s:
                reason = self.state.get("reason") or self.state.get("auto_refusal") or "no reason given"
                raise TrialFailedError(f"{what}: not within {timeout_s:g} s ({reason})")
            self._take()
        return self.state

    def wait(self, duration_s: float) -> None:
        """Take messages for a while."""
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s:
            self._take()

    def _take(self) -> None:
        self._alive()
        now_s = time.monotonic()
        try:
            if now_s - self._beaten_s > _HEARTBEAT_S:
                self._beaten_s = now_s
                self._socket.send('{"type":"heartbeat"}')
            message = json.loads(self._socket.recv(timeout=_HEARTBEAT_S))
        except TimeoutError:
            return
        except (WebSocketException, OSError) as error:
            raise TrialFailedError(f"the twin stream ended ({error})") from None
        if message["type"] == "event":
            self.events.append(message)
        elif message["type"] == "state":
            self.state = message
            if not self.modes or self.modes[-1] != message["mode"]:
                self.modes.append(message["mode"])
                for tell in self._mode_watchers:
                    tell(message)
            for watcher in self._watchers:
                watcher(message)
