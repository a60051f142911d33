"""The real rig with its loops running: what it does when one of them fails, and what each peer may move."""

import asyncio
import json
import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from mrnav_server.app.auth import Role, session_name
from mrnav_server.app.rig import Rig
from mrnav_server.core.errors import DeviceError
from mrnav_server.core.modes import Mode
from mrnav_server.core.records import RigState
from mrnav_server.settings import RecordingConfig, ServerConfig, Settings

TOKEN = "operator-token-for-tests"


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    # Built before the event loop runs: painting the microscope's floor takes a while.
    server = ServerConfig(port=0, hand_port=0, operator_token=TOKEN)
    return Rig(Settings(server=server, recording=RecordingConfig(root=str(tmp_path))).with_tokens())


@asynccontextmanager
async def running(rig: Rig) -> AsyncIterator[None]:
    started = asyncio.Event()
    async with asyncio.timeout(30), asyncio.TaskGroup() as group:
        task = group.create_task(rig.run(started))
        await started.wait()
        yield
        task.cancel()


async def until(rig: Rig, condition: Callable[[], bool]) -> None:
    version = 0
    async with asyncio.timeout(10):
        while not condition():
            _, version = await rig.states.newer_than(version)


async def test_a_loop_that_fails_stops_the_manipulator_and_ends_the_rig(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    stops: list[str] = []
    stop = rig.bench.manipulator.stop

    def counted_stop() -> None:
        stops.append("stop")
        stop()

    monkeypatch.setattr(rig.bench.manipulator, "stop", counted_stop)

    def broken(now_s: float) -> None:
        raise ZeroDivisionError("a bug in the control loop")

    async def break_while_running() -> None:
        async with running(rig):
            monkeypatch.setattr(rig.control, "step", broken)
            await asyncio.sleep(5)

    with pytest.raises(ExceptionGroup) as ended:
        await break_while_running()
    assert ended.group_contains(ZeroDivisionError)
    assert stops
    assert rig.readiness()
    with pytest.raises(DeviceError, match="not open"):
        rig.bench.manipulator.tip()


async def test_two_hands_and_only_the_first_moves_the_rig(rig: Rig) -> None:
    async with running(rig):
        first, second = [await Hand.connect(rig.hand_port) for _ in range(2)]
        assert (first.welcome["lease"], second.welcome["lease"]) == (True, False)
        first.send(clutch=False)
        await until(rig, lambda: rig.control.facts.hand_fresh)
        await rig.console.ask("arm", session_name(first.welcome["session"], Role.OPERATOR), None)
        commands = rig.control.drive.counters["commands"]
        for step in range(20):
            second.send(clutch=True, x_m=0.002 * step)
            first.send(clutch=False)
            await asyncio.sleep(1 / 60)
        assert rig.control.drive.counters["commands"] == commands
        assert not rig.hand.clutch
        first.send(clutch=True)
        for step in range(20):
            first.send(clutch=True, x_m=0.002 * step)
            await asyncio.sleep(1 / 60)
        assert rig.control.drive.counters["commands"] > commands
        first.close()
        second.close()


def shown(rig: Rig) -> RigState:
    state = rig.states.value
    assert state is not None
    return state


@pytest.mark.parametrize("bad", ["NaN", "Infinity", "-Infinity", "1e999"])
async def test_numbers_that_are_not_finite_move_nothing_and_end_in_hold(rig: Rig, bad: str) -> None:
    async with running(rig):
        hand = await Hand.connect(rig.hand_port)
        hand.send(clutch=False)
        await until(
            rig,
            lambda: rig.hand.fresh(asyncio.get_running_loop().time()) and rig.control.scene.tip is not None,
        )
        await rig.console.ask("arm", session_name(hand.welcome["session"], Role.OPERATOR), None)
        hand.send(clutch=True)
        for _ in range(4):
            hand.raw(
                f'{{"type":"hand","seq":{hand.seq()},"t":1.0,"p":[{bad},0,0],"clutch":true,"valid":true}}'
            )
            hand.send(clutch=True)
            await asyncio.sleep(1 / 60)
        await until(rig, lambda: shown(rig).counters["non_finite"] == 4 and shown(rig).mode is Mode.HOLD)
        state = shown(rig)
        assert state.tip is not None
        assert all(map(math.isfinite, state.tip.array()))
        hand.close()


class Hand:
    """A hand link by hand."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer, self._seq = reader, writer, 0

    @classmethod
    async def connect(cls, port: int) -> "Hand":
        hand = cls(*await asyncio.open_connection("127.0.0.1", port))
        hello = {
            "type": "hello",
            "v": 1,
            "role": "operator",
            "token": TOKEN,
            "client": "test",
            "frame": "webxr",
        }
        hand.raw(json.dumps(hello | {"rate_hz": 60, "simulated": True}))
        hand.welcome = json.loads(await hand._reader.readline())
        return hand

    welcome: dict[str, Any]

    def seq(self) -> int:
        self._seq += 1
        return self._seq

    def send(self, *, clutch: bool, x_m: float = 0.0) -> None:
        t_s = asyncio.get_running_loop().time()
        message = {"type": "hand", "seq": self.seq(), "t": t_s, "p": [x_m, 0.0, 0.0]}
        self.raw(json.dumps(message | {"clutch": clutch, "valid": True}))

    def raw(self, line: str) -> None:
        self._writer.write(line.encode() + b"\n")

    def close(self) -> None:
        self._writer.close()
