"""uvicorn's connections with deadlines: a peer that neither talks nor reads is dropped."""

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING, cast

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.protocol import State

if TYPE_CHECKING:
    from starlette.types import Scope
    from uvicorn._types import ASGISendEvent

WriteFrame = Callable[[bytes], bool]
"""Writes one whole WebSocket frame; False, and nothing is written, if the last one is still on its way."""
SLOW_READER_S = 2.0
"""Who takes nothing for so long is dropped."""
HEADER_DEADLINE_S = 5.0
PING_S = 1.0
PONG_DEADLINE_S = 2.0
"""A peer that does not read answers no ping: seconds of states may fit the kernels' buffers unseen."""
_LINGER_S = 1.0
_FRAMES = "frames"
SEND_BUFFER_BYTES = 65_536
"""Kernel's send buffer of a connection: what a slow reader can pile up unseen."""


class TimedHttp(H11Protocol):
    """HTTP/1.1 whose request headers must arrive within the deadline; uvicorn alone waits for ever."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the deadline of the first request."""
        super().connection_made(transport)
        self._watch()

    def data_received(self, data: bytes) -> None:
        """Start the deadline of a further request, or end it once its headers are complete."""
        super().data_received(data)
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the deadline."""
        self._forget()
        super().connection_lost(exc)

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Hand over to the WebSocket's protocol, which sets its own deadlines."""
        self._forget()
        super().handle_websocket_upgrade(event)

    def _watch(self) -> None:
        if self.conn.their_state is not h11.IDLE or self.transport.get_protocol() is not self:
            self._forget()
        elif self._deadline is None:
            self._deadline = self.loop.call_later(HEADER_DEADLINE_S, self.transport.abort)

    def _forget(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


class TimedWebSocket(WebSocketsSansIOProtocol):
    """A WebSocket that buffers nothing beyond the kernel and is gone soon after its handler returned."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Make every send wait until the kernel took it: then a slow reader is seen at once."""
        super().connection_made(transport)
        cast(asyncio.Transport, transport).set_write_buffer_limits(0)
        self.close_timeout = _LINGER_S

    async def send(self, message: "ASGISendEvent") -> None:
        """Send; a refusal completes the handshake too, which uvicorn would log as the app's error."""
        await super().send(message)
        if message["type"] == "websocket.http.response.body" and self.close_sent:
            self.handshake_complete = True

    def keepalive_timeout(self) -> None:
        """Drop a peer that does not answer; a closing would wait behind what it does not read."""
        super().keepalive_timeout()
        self.transport.abort()

    def write_frame(self, frame: bytes) -> bool:
        """Write a frame that is complete already; see ``WriteFrame``."""
        if self.conn.state is not State.OPEN or self.transport.get_write_buffer_size():
            return False
        self.transport.write(frame)
        return True

    async def run_asgi(self) -> None:
        """Run the handler; a closing that a peer does not read is cut short."""
        self.scope["extensions"][_FRAMES] = {"write": self.write_frame}
        await super().run_asgi()
        self.loop.call_later(_LINGER_S, self.transport.abort)


def frame_writer(scope: "Scope") -> WriteFrame:
    """Return how to write whole frames to a WebSocket of this server."""
    return cast(WriteFrame, scope["extensions"][_FRAMES]["write"])
