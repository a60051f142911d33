"""The operator's process at the hand link: what it says, and how it ends."""

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest

from mrnav_server.cli import operate
from mrnav_server.cli.operate import Seat, run_operator
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.wire_hand import ClientFrame, HandMessage, Ping, parse_hello, parse_message
from mrnav_server.sim.operator import OperatorModel, SimulatedOperator

WELCOME = {"type": "welcome", "v": 1, "session": "s", "lease": True, "limits": {}, "transform": {}}
TWIN = {"type": "twin", "mode": "AUTO", "critical_area": "area-1", "robot_um": [1.0, 2.0]}


class HandLink:
    """A hand link that answers the hello with fixed lines, keeps some messages and hangs up."""

    def __init__(self, answers: list[dict[str, Any]], messages: int) -> None:
        self._answers = answers
        self._messages = messages
        self.hello = b""
        self.lines: list[bytes] = []

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.hello = await reader.readline()
        for answer in self._answers:
            writer.write(json.dumps(answer).encode() + b"\n")
        while len(self.lines) < self._messages:
            self.lines.append(await reader.readline())
        writer.close()

    @asynccontextmanager
    async def seat(self) -> AsyncIterator[Seat]:
        server = await asyncio.start_server(self.serve, "127.0.0.1", 0)
        async with server:
            port = server.sockets[0].getsockname()[1]
            yield Seat("127.0.0.1", port, "http://127.0.0.1:1", "secret", "tester")


def operator() -> SimulatedOperator:
    return SimulatedOperator(OperatorModel(), 7)


async def test_it_says_hello_as_simulated_with_its_seed() -> None:
    link = HandLink([WELCOME], messages=1)
    async with link.seat() as seat:
        await run_operator(seat, operator(), 7)
    hello = parse_hello(link.hello)
    assert (hello.role, hello.token, hello.simulated, hello.seed) == ("operator", "secret", True, 7)
    assert hello.model
    assert hello.frame is ClientFrame.WEBXR


async def test_its_messages_are_what_the_server_accepts_and_poses_repeat() -> None:
    link = HandLink([WELCOME], messages=20)
    async with link.seat() as seat:
        await run_operator(seat, operator(), 7)
    parsed = [parse_message(line, ClientFrame.WEBXR) for line in link.lines]
    hands = [message for message in parsed if isinstance(message, HandMessage)]
    assert all(isinstance(message, HandMessage | Ping) for message in parsed)
    numbers = [message.seq for message in hands]
    assert numbers == sorted(set(numbers))
    times = [message.t_s for message in hands]
    assert times == sorted(times)
    assert len({message.pose for message in hands}) < len(hands)
    assert not any(message.clutch for message in hands)


async def test_it_asks_for_the_place_of_the_active_area(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def center(_: Seat, area: str) -> tuple[float, float]:
        asked.append(area)
        return (0.0, 0.0)

    monkeypatch.setattr(operate, "area_center_um", center)
    link = HandLink([WELCOME, TWIN, TWIN], messages=15)
    async with link.seat() as seat:
        await run_operator(seat, operator(), 7)
    assert asked == ["area-1"]


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ({"type": "error", "code": "bad_token", "message": "this token is unknown"}, "this token is unknown"),
        (WELCOME | {"lease": False}, "another hand"),
    ],
)
async def test_a_refusal_is_told(answer: dict[str, Any], said: str) -> None:
    link = HandLink([answer], messages=0)
    async with link.seat() as seat:
        with pytest.raises(ConfigError, match=said):
            await run_operator(seat, operator(), 7)


async def test_being_dropped_is_told() -> None:
    link = HandLink([WELCOME, {"type": "error", "code": "flood", "message": "too many lines"}], messages=100)
    async with link.seat() as seat:
        with pytest.raises(ConfigError, match="too many lines"):
            await run_operator(seat, operator(), 7)


async def test_a_server_that_is_not_there_is_told(unused_tcp_port_factory: Callable[[], int]) -> None:
    seat = Seat("127.0.0.1", unused_tcp_port_factory(), "http://127.0.0.1:1", "secret", "tester")
    with pytest.raises(ConfigError, match="start `mrnav serve`"):
        await run_operator(seat, operator(), 7)
