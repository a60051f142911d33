"""The twin stream as a client: a snapshot, then states and events (docs/protocol.md)."""

import json
from types import TracebackType
from typing import Any, Self

from websockets.exceptions import WebSocketException

from mrnav_server.client.errors import ConnectionEndedError
from mrnav_server.client.waiting import REAL, Waiting
from mrnav_server.client.web_socket import WebSocket

Message = dict[str, Any]
_OPEN_S = 10.0
_HEARTBEAT_S = 0.2


class Twin:
    """One connection to ``/ws/twin``.

    Args:
        url: The server's web address.
        token: An operator's or a viewer's token.
        rate_hz: States a second at most; events always come.
        heartbeat: Whether reading also tells the server that a console is watched; only where somebody does.
        waiting: How it waits.

    Attributes:
        snapshot: The first message: vessel, calibration, limits, critical areas.
        state: The newest state; empty before the first.
        events: Every event, in order.

    Raises:
        ConnectionEndedError: If the server is not there or refuses.
    """

    def __init__(
        self, url: str, token: str, rate_hz: float = 60.0, *, heartbeat: bool = False, waiting: Waiting = REAL
    ) -> None:
        address = f"{url.replace('http', 'ws', 1).rstrip('/')}/ws/twin?rate_hz={rate_hz:g}"
        headers = {"Authorization": f"Bearer {token}"}
        self.waiting = waiting
        self._heartbeat = heartbeat
        self._beaten_s = waiting.now_s()
        try:
            self._socket = WebSocket(address, headers, _OPEN_S, waiting)
            self.snapshot = self._first()
        except (WebSocketException, OSError) as error:
            raise ConnectionEndedError(
                f"no twin at {url} ({error}): name the server's web address and token"
            ) from None
        self.state: Message = self.snapshot["state"] or {}
        self.events: list[Message] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._socket.close()

    def take(self, timeout_s: float) -> Message | None:
        """Return the next message, noted in ``state`` or ``events``; None if none comes in time.

        Raises:
            ConnectionEndedError: If the connection has ended.
        """
        try:
            now_s = self.waiting.now_s()
            if self._heartbeat and now_s - self._beaten_s > _HEARTBEAT_S:
                self._beaten_s = now_s
                self._socket.send('{"type":"heartbeat"}')
            text = self._socket.receive(timeout_s)
        except (WebSocketException, OSError) as error:
            raise ConnectionEndedError(f"the twin stream ended ({error})") from None
        if text is None:
            return None
        message: Message = json.loads(text)
        if message["type"] == "event":
            self.events.append(message)
        elif message["type"] == "state":
            self.state = message
        return message

    def _first(self) -> Message:
        try:
            text = self._socket.receive(_OPEN_S)
            if text is None:
                raise TimeoutError(f"no snapshot within {_OPEN_S:g} s")
        except BaseException:
            self._socket.close()
            raise
        snapshot: Message = json.loads(text)
        return snapshot
