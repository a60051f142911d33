"""A WebSocket that one thread reads and writes: nothing is answered, not even a ping, while nobody reads."""

import socket
import ssl
from collections import deque

from websockets.client import ClientProtocol
from websockets.frames import Frame, Opcode
from websockets.protocol import State
from websockets.uri import parse_uri

from mrnav_server.client.waiting import Waiting

_READ_BYTES = 65_536


class WebSocket:
    """One connection, open.

    Args:
        address: ``ws://`` or ``wss://``.
        headers: Sent with the request.
        open_s: Longest wait for the connection.
        waiting: How it waits.

    Raises:
        OSError: If nobody listens, or nobody answers.
        WebSocketException: If the server refuses.
    """

    def __init__(self, address: str, headers: dict[str, str], open_s: float, waiting: Waiting) -> None:
        uri = parse_uri(address)
        self._waiting = waiting
        self._parts: list[bytes] = []
        self._texts: deque[str] = deque()
        self._protocol = ClientProtocol(uri, max_size=None)
        self._socket = socket.create_connection((uri.host, uri.port), open_s)
        try:
            if uri.secure:
                context = ssl.create_default_context()
                self._socket = context.wrap_socket(self._socket, server_hostname=uri.host)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            request = self._protocol.connect()
            request.headers.update(headers)
            self._protocol.send_request(request)
            self._flush()
            deadline_s = waiting.now_s() + open_s
            while self._protocol.state is State.CONNECTING:
                if not self._read(deadline_s):
                    raise TimeoutError(f"no answer within {open_s:g} s")
        except BaseException:
            self._socket.close()
            raise

    def receive(self, timeout_s: float) -> str | None:
        """Return the next message; None if none comes in time.

        Raises:
            OSError: If the connection broke.
            WebSocketException: If it was closed.
        """
        until_s = self._waiting.now_s() + timeout_s
        while not self._texts:
            if self._protocol.state is State.CLOSED:
                raise self._protocol.close_exc
            if not self._read(until_s):
                return None
        return self._texts.popleft()

    def send(self, text: str) -> None:
        """Send a message.

        Raises:
            OSError: If the connection broke.
        """
        self._protocol.send_text(text.encode())
        self._flush()

    def close(self) -> None:
        """Say goodbye and hang up; does not wait for an answer."""
        try:
            if self._protocol.state is State.OPEN:
                self._protocol.send_close()
                self._flush()
        except OSError:
            pass
        finally:
            self._socket.close()

    def _read(self, until_s: float) -> bool:
        """Take what has come; tell whether anything came in time."""
        buffered = isinstance(self._socket, ssl.SSLSocket) and self._socket.pending() > 0
        if not buffered and not self._waiting.readable(self._socket, until_s):
            return False
        if data := self._socket.recv(_READ_BYTES):
            self._protocol.receive_data(data)
        else:
            self._protocol.receive_eof()
        self._flush()
        if self._protocol.handshake_exc is not None:
            raise self._protocol.handshake_exc
        for event in self._protocol.events_received():
            if isinstance(event, Frame):
                self._take(event)
        return True

    def _take(self, frame: Frame) -> None:
        if frame.opcode in (Opcode.TEXT, Opcode.CONT):
            self._parts.append(bytes(frame.data))
            if frame.fin:
                self._texts.append(b"".join(self._parts).decode())
                self._parts.clear()

    def _flush(self) -> None:
        for data in self._protocol.data_to_send():
            if data:
                self._socket.sendall(data)
