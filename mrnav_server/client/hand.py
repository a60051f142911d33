"""The hand link as a client: send a fingertip, follow the twin, from one thread (docs/protocol.md).

Example:
    with HandLink("127.0.0.1", 9000, token, client="my glove") as link:
        while True:
            link.send(my_glove.position_m(), clutch=my_glove.is_pinched())
            for twin in link.twins(for_s=1 / 60):
                print(twin["mode"], twin["robot_um"])
"""

import json
import select
import socket
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Any, Literal, Self

from mrnav_server.client.errors import ConnectionEndedError
from mrnav_server.client.waiting import REAL, Waiting

_CONNECT_S = 5.0
_READ_BYTES = 65_536


class HandLink:
    """One connection to the hand link.

    Args:
        host, port: Where the server listens for hands.
        token: An operator's token.
        client: The name under which others see the sender.
        frame: The axes of the positions; "stage" is x right, y towards the operator, z up, from above.
        rate_hz: How often the twin comes, 1 to 120 Hz.
        simulated_by: Name of the model that stands in for a person; "" for a person.
        seed: Seed of that model.
        waiting: How it waits.

    Attributes:
        welcome: The server's answer: session, limits, transform.

    Raises:
        ConnectionEndedError: If nobody listens, the server refuses, or another hand has control.
    """

    def __init__(
        self,
        host: str,
        port: int,
        token: str,
        *,
        client: str,
        frame: Literal["unity", "webxr", "stage"] = "webxr",
        rate_hz: float = 60.0,
        simulated_by: str = "",
        seed: int | None = None,
        waiting: Waiting = REAL,
    ) -> None:
        self._waiting = waiting
        self._buffer = bytearray()
        self._seq = 0
        try:
            self._socket = socket.create_connection((host, port), _CONNECT_S)
        except OSError as error:
            raise ConnectionEndedError(
                f"no hand link at {host}:{port} ({error}): start `mrnav serve`"
            ) from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        hello = {
            "type": "hello",
            "v": 1,
            "role": "operator",
            "token": token,
            "client": client,
            "frame": frame,
            "rate_hz": rate_hz,
            "simulated": bool(simulated_by),
        }
        if simulated_by:
            hello |= {"model": simulated_by, "seed": seed or 0}
        try:
            self._write(hello)
            self.welcome = self._answer()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Hang up; the rig holds."""
        self._socket.close()

    def send(
        self, position_m: Sequence[float], *, clutch: bool, valid: bool = True, pose: int | None = None
    ) -> bool:
        """Send where the fingertip is; tell whether it went out. Never waits for a server that is slow.

        Args:
            position_m: x, y, z in the declared frame, cumulative: the server forms the increments.
            clutch: Whether the robot shall follow.
            valid: Whether the hand is seen.
            pose: Number of the tracker's pose; a repeated one is no motion.

        Raises:
            ConnectionEndedError: If the connection has ended.
        """
        # A server that does not read gets nothing more: later it would be stale.
        if not select.select([], [self._socket], [], 0.0)[1]:
            return False
        x_m, y_m, z_m = (round(v, 7) for v in position_m)
        message: dict[str, Any] = {
            "type": "hand",
            "seq": self._seq,
            "t": self._waiting.now_s(),
            "p": [x_m, y_m, z_m],
            "clutch": clutch,
            "valid": valid,
        }
        if pose is not None:
            message["pose"] = pose
        self._write(message)
        self._seq += 1
        return True

    def ping(self) -> None:
        """Ask for the server's time, so that it can tell the round trip."""
        self._write({"type": "ping", "t": self._waiting.now_s()})

    def twins(self, for_s: float) -> Iterator[dict[str, Any]]:
        """Yield the twin's messages as they come, for a while.

        Raises:
            ConnectionEndedError: If the connection has ended, with what the server said.
        """
        end_s = self._waiting.now_s() + for_s
        while (message := self._read(end_s)) is not None:
            if message["type"] == "error":
                raise ConnectionEndedError(f"the server ended the hand link: {message['message']}")
            if message["type"] == "twin":
                yield message

    def _answer(self) -> dict[str, Any]:
        answer = self._read(self._waiting.now_s() + _CONNECT_S)
        if answer is None:
            raise ConnectionEndedError("the server does not answer the hello: is this its hand port?")
        if answer["type"] != "welcome":
            raise ConnectionEndedError(f"the server refuses: {answer.get('message', answer)}")
        if not answer["lease"]:
            raise ConnectionEndedError("another hand controls the rig: it must give the lease back first")
        return answer

    def _read(self, until_s: float) -> dict[str, Any] | None:
        """Return the next message; None if none comes in time."""
        while (end := self._buffer.find(b"\n")) < 0:
            if not self._waiting.readable(self._socket, until_s):
                return None
            try:
                received = self._socket.recv(_READ_BYTES)
            except OSError as error:
                raise ConnectionEndedError(f"the hand link ended ({error})") from None
            if not received:
                raise ConnectionEndedError("the server closed the hand link")
            self._buffer += received
        line = bytes(self._buffer[:end])
        del self._buffer[: end + 1]
        message: dict[str, Any] = json.loads(line)
        return message

    def _write(self, message: dict[str, Any]) -> None:
        try:
            self._socket.sendall(json.dumps(message, separators=(",", ":")).encode() + b"\n")
        except OSError as error:
            raise ConnectionEndedError(f"the hand link ended ({error})") from None
