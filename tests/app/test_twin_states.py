"""Which states a client is sent, in virtual time: as often as asked, fresh, and the last one always."""

import asyncio
from collections.abc import Awaitable, Callable

import orjson
import pytest

from mrnav_server.app.twin_states import TwinStates
from mrnav_server.sim.virtual_time import VirtualTimeLoop
from tests.app.fake_rig import FakeRig


class Connection:
    """Notes which state came when; takes nothing while it is stuck."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self.came: list[tuple[int, float]] = []
        self.stuck = False

    def write(self, frame: bytes) -> bool:
        if not self.stuck:
            self.came.append((orjson.loads(frame[frame.index(b"{") :])["seq"], self._loop.time()))
        return not self.stuck


def played(rig: FakeRig, rate_hz: float, play: Callable[[Connection], Awaitable[None]]) -> Connection:
    """Serve one connection while something is played."""
    loop = VirtualTimeLoop()
    connection = Connection(loop)

    async def serve() -> None:
        async with TwinStates(rig).sent_to(connection.write, rate_hz) as group:
            await play(connection)
            group.create_task(_ends())

    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        try:
            runner.run(serve())
        except* _EndError:
            pass
    return connection


class _EndError(Exception):
    """The client leaves."""


async def _ends() -> None:
    raise _EndError


@pytest.mark.parametrize("rate_hz", [7.0, 30.0, 60.0, 90.0])
def test_a_client_gets_fresh_states_at_its_rate(rig: FakeRig, rate_hz: float) -> None:
    published_s: dict[int, float] = {}

    async def publish(connection: Connection) -> None:
        for number in range(900):
            published_s[number] = asyncio.get_running_loop().time()
            rig.publish(number)
            await asyncio.sleep(0.01)

    connection = played(rig, rate_hz, publish)
    assert len(connection.came) == pytest.approx(9.0 * rate_hz, abs=2.0)
    assert all(at_s == published_s[number] for number, at_s in connection.came)


def test_the_last_state_comes_though_it_came_too_early(rig: FakeRig) -> None:
    async def publish(connection: Connection) -> None:
        for number in (1, 2):
            rig.publish(number)
            await asyncio.sleep(0.001)
        await asyncio.sleep(1.0)

    assert [number for number, _ in played(rig, 10.0, publish).came] == [1, 2]


def test_who_is_stuck_gets_the_newest_afterwards_and_nothing_in_between(rig: FakeRig) -> None:
    async def publish(connection: Connection) -> None:
        for number in range(100):
            connection.stuck = 10 <= number < 70
            rig.publish(number)
            await asyncio.sleep(0.02)

    numbers = [number for number, _ in played(rig, 60.0, publish).came]
    assert numbers == [*range(10), *range(70, 100)]


def test_who_is_stuck_for_long_is_given_up(rig: FakeRig) -> None:
    async def publish(connection: Connection) -> None:
        connection.stuck = True
        for number in range(1000):
            rig.publish(number)
            await asyncio.sleep(0.02)

    with pytest.raises(ExceptionGroup) as given_up:
        played(rig, 60.0, publish)
    assert given_up.group_contains(TimeoutError)
