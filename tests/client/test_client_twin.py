"""The twin's client against a small WebSocket server."""

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from websockets.sync.server import ServerConnection, serve

from mrnav_server.client.errors import ConnectionEndedError
from mrnav_server.client.twin import Twin

SNAPSHOT: dict[str, Any] = {"type": "snapshot", "session": "s", "state": {"mode": "DISARMED"}}


@contextmanager
def serving(talk: Callable[[ServerConnection], None]) -> Iterator[str]:
    with serve(talk, "127.0.0.1", 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.socket.getsockname()[1]}"
        server.shutdown()
        thread.join(10)


def test_states_are_the_newest_and_events_are_kept() -> None:
    asked: list[str] = []

    def talk(socket: ServerConnection) -> None:
        assert socket.request is not None
        asked.append(f"{socket.request.path} {socket.request.headers['Authorization']}")
        for message in (
            SNAPSHOT,
            {"type": "state", "mode": "MANUAL"},
            {"type": "event", "event": "handover_announced", "in_s": 1.5},
            {"type": "state", "mode": "AUTO"},
        ):
            socket.send(json.dumps(message))
        for _ in socket:
            pass

    with serving(talk) as url, Twin(url, "secret", rate_hz=5) as twin:
        assert twin.snapshot["session"] == "s"
        assert twin.state["mode"] == "DISARMED"
        kinds = [message["type"] for _ in range(3) if (message := twin.take(5.0)) is not None]
        assert kinds == ["state", "event", "state"]
        assert twin.state["mode"] == "AUTO"
        assert [event["in_s"] for event in twin.events] == [1.5]
        assert twin.take(0.0) is None
    assert asked == ["/ws/twin?rate_hz=5 Bearer secret"]


@pytest.mark.parametrize("heartbeat", [True, False])
def test_only_a_console_that_is_watched_sends_its_heartbeat(heartbeat: bool) -> None:
    heard: list[str] = []

    def talk(socket: ServerConnection) -> None:
        socket.send(json.dumps(SNAPSHOT))
        heard.extend(str(message) for message in socket)

    with serving(talk) as url, Twin(url, "secret", heartbeat=heartbeat) as twin:
        for _ in range(5):
            assert twin.take(0.1) is None
    assert bool(heard) is heartbeat
    assert set(heard) <= {'{"type":"heartbeat"}'}


def test_the_end_is_told(unused_tcp_port_factory: Callable[[], int]) -> None:
    def talk(socket: ServerConnection) -> None:
        socket.send(json.dumps(SNAPSHOT))

    with (
        serving(talk) as url,
        Twin(url, "secret") as twin,
        pytest.raises(ConnectionEndedError, match="the twin stream ended"),
    ):
        twin.take(5.0)
    with pytest.raises(ConnectionEndedError, match="web address"):
        Twin(f"http://127.0.0.1:{unused_tcp_port_factory()}", "secret")
