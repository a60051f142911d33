"""Clients of a WebSocket in a process of their own: how old each message is that they get.

Run by the benchmark of the twin: ``python -m benchmarks._twin_clients PORT PATH CLIENTS SECONDS [...]``.
Frames are read by hand on one selector, for a client's own work must not be what is measured. The system's
monotonic clock is the same for every process of a machine, so a message's age is a difference.
"""

import argparse
import base64
import json
import os
import re
import selectors
import socket
import time

_TIME = re.compile(rb'"t":([0-9.]+)')
_STATE = b'"type":"state"'
_TEXT, _CLOSE, _PING, _PONG = 1, 8, 9, 10


class Client:
    """One connection that only listens.

    Args:
        port: Of the server on this machine.
        path: With its query.
        protocol: WebSocket subprotocol; "" for none.
        subscribe: What to send first; "" for nothing.
        receive_bytes: What the system may keep for it; None for its own choice.
    """

    def __init__(
        self, port: int, path: str, protocol: str, subscribe: str, receive_bytes: int | None = None
    ) -> None:
        self.ages_ms: list[float] = []
        self.socket = socket.socket()
        self.socket.settimeout(20.0)
        if receive_bytes is not None:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
        self.socket.connect(("127.0.0.1", port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        key = base64.b64encode(os.urandom(16)).decode()
        head = [
            f"GET {path} HTTP/1.1",
            f"Host: 127.0.0.1:{port}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            f"Sec-WebSocket-Key: {key}",
            "Sec-WebSocket-Version: 13",
            *([f"Sec-WebSocket-Protocol: {protocol}"] if protocol else []),
        ]
        self.socket.sendall(("\r\n".join(head) + "\r\n\r\n").encode())
        self._bytes = b""
        while b"\r\n\r\n" not in self._bytes:
            self._bytes += self.socket.recv(4096) or self._refused()
        answer, self._bytes = self._bytes.split(b"\r\n\r\n", 1)
        if not answer.startswith(b"HTTP/1.1 101"):
            raise ConnectionError(answer.decode(errors="replace"))
        if subscribe:
            self._send(_TEXT, subscribe.encode())
        self.socket.setblocking(False)

    def read(self, now_s: float) -> None:
        """Take what has come, at a time in seconds."""
        data = self.socket.recv(1 << 20)
        if not data:
            self._refused()
        self._bytes += data
        while len(self._bytes) >= 2:
            length, start = self._bytes[1] & 0x7F, 2
            if length >= 126:
                start = 4 if length == 126 else 10
                length = int.from_bytes(self._bytes[2:start], "big")
            if len(self._bytes) < start + length:
                return
            self._take(self._bytes[0] & 0x0F, self._bytes[start : start + length], now_s)
            self._bytes = self._bytes[start + length :]

    def _take(self, kind: int, message: bytes, now_s: float) -> None:
        if kind == _CLOSE:
            self._refused(message[2:])
        elif kind == _PING:
            self._send(_PONG, message)
        elif message.find(_STATE, 0, 64) >= 0 and (found := _TIME.search(message)):
            self.ages_ms.append(1000.0 * (now_s - float(found[1])))

    def _send(self, kind: int, payload: bytes) -> None:
        # A mask of zeros leaves the bytes as they are.
        self.socket.sendall(bytes([0x80 | kind, 0x80 | len(payload), 0, 0, 0, 0]) + payload)

    def _refused(self, reason: bytes = b"") -> bytes:
        raise ConnectionError(f"the server closed the connection {reason.decode(errors='replace')}")


def listen(clients: list[Client], seconds: float) -> float:
    """Read all clients for a time; return how long it was, in seconds."""
    with selectors.DefaultSelector() as selector:
        for client in clients:
            selector.register(client.socket, selectors.EVENT_READ, client)
        began_s = now_s = time.monotonic()
        while now_s < began_s + seconds:
            for key, _ in selector.select(0.1):
                key.data.read(time.monotonic())
            now_s = time.monotonic()
    return now_s - began_s


def main() -> None:
    """Connect, wait until all are served, say so, and measure when told to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("port", type=int)
    parser.add_argument("path")
    parser.add_argument("clients", type=int)
    parser.add_argument("seconds", type=float)
    parser.add_argument("--protocol", default="")
    parser.add_argument("--subscribe", default="")
    asked = parser.parse_args()
    clients: list[Client] = []
    for _ in range(asked.clients):
        clients.append(Client(asked.port, asked.path, asked.protocol, asked.subscribe))
        # Those that are connected must not look asleep meanwhile.
        listen(clients, 0.01)
    listen(clients, 1.0)
    print("ready", flush=True)
    for client in clients:
        client.ages_ms.clear()
    took_s = listen(clients, asked.seconds)
    rates_hz = [len(client.ages_ms) / took_s for client in clients]
    ages_ms = [round(age_ms, 3) for client in clients for age_ms in client.ages_ms]
    print(json.dumps({"rates_hz": rates_hz, "ages_ms": ages_ms}))


if __name__ == "__main__":
    main()
