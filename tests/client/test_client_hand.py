"""The hand link's client against a small server: what it says, what it yields, how it ends."""

import json
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal

import pytest

from mrnav_server.client.errors import ConnectionEndedError
from mrnav_server.client.hand import HandLink
from mrnav_server.core.wire_hand import ClientFrame, HandMessage, Ping, parse_hello, parse_message

WELCOME: dict[str, Any] = {"type": "welcome", "v": 1, "session": "s", "lease": True, "limits": {}}
TWIN = {"type": "twin", "mode": "AUTO"}


def lines(*messages: dict[str, Any]) -> bytes:
    return b"".join(json.dumps(message).encode() + b"\n" for message in messages)


class Server:
    """Takes one connection, answers the hello, sends what it is given, and keeps every line until the end."""

    def __init__(self, answers: Sequence[bytes], *, hang_up: bool) -> None:
        self._answers, self._hang_up = answers, hang_up
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self.lines: list[bytes] = []
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        connection, _ = self._listener.accept()
        with connection, connection.makefile("rb") as file:
            self.lines.append(file.readline())
            for answer in self._answers:
                connection.sendall(answer)
            if not self._hang_up:
                self.lines += file.readlines()

    def end(self) -> None:
        self._thread.join(10)
        self._listener.close()
        assert not self._thread.is_alive()


@contextmanager
def serving(*answers: bytes, hang_up: bool = False) -> Iterator[Server]:
    server = Server(answers, hang_up=hang_up)
    yield server
    server.end()


def link(
    port: int,
    simulated_by: str = "",
    seed: int | None = None,
    frame: Literal["unity", "webxr", "stage"] = "webxr",
) -> HandLink:
    return HandLink(
        "127.0.0.1", port, "secret", client="tester", simulated_by=simulated_by, seed=seed, frame=frame
    )


def test_a_person_and_a_model_introduce_themselves() -> None:
    with serving(lines(WELCOME)) as server, link(server.port) as hand:
        assert hand.welcome["session"] == "s"
    hello = parse_hello(server.lines[0])
    assert (hello.role, hello.token, hello.client, hello.simulated) == ("operator", "secret", "tester", False)
    with serving(lines(WELCOME)) as server, link(server.port, simulated_by="steering", seed=7, frame="stage"):
        pass
    hello = parse_hello(server.lines[0])
    assert (hello.simulated, hello.model, hello.seed, hello.frame) == (True, "steering", 7, ClientFrame.STAGE)


def test_its_messages_are_what_the_server_accepts() -> None:
    with serving(lines(WELCOME)) as server, link(server.port) as hand:
        assert hand.send((0.1, 0.2, 0.3), clutch=True)
        assert hand.send((0.1, 0.2, 0.3), clutch=False, valid=False, pose=4)
        hand.ping()
    first, second, ping = (parse_message(line, ClientFrame.WEBXR) for line in server.lines[1:])
    assert isinstance(first, HandMessage)
    assert isinstance(second, HandMessage)
    assert isinstance(ping, Ping)
    assert (first.point.x_m, first.point.y_m, first.point.z_m) == (0.1, 0.2, 0.3)
    assert (first.clutch, first.valid, first.pose) == (True, True, None)
    assert (second.clutch, second.valid, second.pose) == (False, False, 4)
    assert first.seq < second.seq
    assert first.t_s <= second.t_s <= ping.t_s


def test_twins_come_one_by_one_however_the_network_cuts_them() -> None:
    whole = lines(WELCOME, TWIN | {"seq": 1}, {"type": "pong"}, TWIN | {"seq": 2})
    with serving(whole[:-30], whole[-30:]) as server, link(server.port) as hand:
        seen: list[int] = []
        while len(seen) < 2:
            seen += [twin["seq"] for twin in hand.twins(for_s=0.2)]
    assert seen == [1, 2]


def test_it_waits_no_longer_than_it_was_told() -> None:
    with serving(lines(WELCOME)) as server, link(server.port) as hand:
        began_s = time.monotonic()
        assert list(hand.twins(for_s=0.05)) == []
        assert list(hand.twins(for_s=-1.0)) == []
        assert time.monotonic() - began_s >= 0.05


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ({"type": "error", "code": "bad_token", "message": "this token is unknown"}, "this token is unknown"),
        (WELCOME | {"lease": False}, "another hand"),
    ],
)
def test_a_refusal_is_told(answer: dict[str, Any], said: str) -> None:
    with serving(lines(answer)) as server, pytest.raises(ConnectionEndedError, match=said):
        link(server.port)


def test_being_dropped_and_hung_up_on_are_told() -> None:
    dropped = {"type": "error", "code": "flood", "message": "too many lines"}
    for answer, said in ((dropped, "too many lines"), ({"type": "pong"}, r"closed the hand link|link ended")):
        with (
            serving(lines(WELCOME, answer), hang_up=True) as server,
            link(server.port) as hand,
            pytest.raises(ConnectionEndedError, match=said),
        ):
            list(hand.twins(for_s=5.0))


def test_a_server_that_is_not_there_is_told(unused_tcp_port_factory: Callable[[], int]) -> None:
    with pytest.raises(ConnectionEndedError, match="start `mrnav serve`"):
        link(unused_tcp_port_factory())


def test_a_server_that_does_not_read_is_sent_nothing_more() -> None:
    """The socket's buffers hold some megabytes at most; sending must neither wait nor break a line."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        accepted: list[socket.socket] = []

        def welcome() -> None:
            connection, _ = listener.accept()
            connection.sendall(lines(WELCOME))
            accepted.append(connection)

        thread = threading.Thread(target=welcome)
        thread.start()
        with link(listener.getsockname()[1]) as hand:
            thread.join(10)
            sent = [hand.send((0.0, 0.0, 0.0), clutch=False) for _ in range(100_000)]
        assert sent[0]
        assert not sent[-1]
        accepted[0].close()
