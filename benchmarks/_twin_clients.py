"""Clients of a WebSocket in a process of their own: how old each message is that they get.

Run by the benchmark of the twin: ``python -m benchmarks._twin_clients PORT PATH CLIENTS SECONDS [...]``.
Frames are read by hand on one selector, for a client's own work must not be what is measured. The system's
monotonic clock is the same for every process of a machine, so a message's age is a difference.
"""

import argparse
import base64
import gc
import json
import os
import re
import selectors
import socket
import time

_TIME = re.compile(rb'"t":([0-9.]+)')
_STATE = b'"type":"state"'
_READ_BYTES = 65_536
"""For one read: Python takes as much memory at once, which costs more than the reading if it is much."""
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
        self._states: list[tuple[float, bytes]] = []
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
        answer = b""
        while b"\r\n\r\n" not in answer:
            answer += self.socket.recv(4096) or self._refused()
        answer, self._rest = answer.split(b"\r\n\r\n", 1)
        if not answer.startswith(b"HTTP/1.1 101"):
            raise ConnectionError(answer.decode(errors="replace"))
        if subscribe:
            self._send(_TEXT, subscribe.encode())
        self.socket.setblocking(False)

    def read(self, now_s: float) -> None:
        """Take what has come, at a time in seconds."""
        data = self.socket.recv(_READ_BYTES)
        if not data:
            self._refused()
        data, at = self._rest + data, 0
        while len(data) - at >= 2:
            length, start = data[at + 1] & 0x7F, at + 2
            if length >= 126:
                start += 2 if length == 126 else 8
                length = int.from_bytes(data[at + 2 : start], "big")
            if len(data) < start + length:
                break
            self._take(data[at] & 0x0F, data[start : start + length], now_s)
            at = start + length
        self._rest = data[at:]

    def _take(self, kind: int, message: bytes, now_s: float) -> None:
        if kind == _CLOSE:
            self._refused(message[2:])
        elif kind == _PING:
            self._send(_PONG, message)
        else:
            self._states.append((now_s, message))

    def forget(self) -> None:
        """Forget what came until now."""
        self._states.clear()

    def ages_ms(self) -> list[float]:
        """Return how old each state was when it came, in ms."""
        return [
            1000.0 * (came_s - float(found[1]))
            for came_s, message in self._states
            if message.find(_STATE, 0, 64) >= 0 and (found := _TIME.search(message))
        ]

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
    gc.disable()
    clients: list[Client] = []
    for _ in range(asked.clients):
        clients.append(Client(asked.port, asked.path, asked.protocol, asked.subscribe))
        # Those that are connected must not look asleep meanwhile.
        listen(clients, 0.01)
    listen(clients, 1.0)
    print("ready", flush=True)
    for client in clients:
        client.forget()
    took_s = listen(clients, asked.seconds)
    ages_ms = [client.ages_ms() for client in clients]
    rates_hz = [len(ages) / took_s for ages in ages_ms]
    print(json.dumps({"rates_hz": rates_hz, "ages_ms": [round(age, 3) for ages in ages_ms for age in ages]}))


if __name__ == "__main__":
    main()
