"""Virtual time: the order of real time, without its waiting."""

import asyncio
import socket
import time
from collections.abc import Awaitable, Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrnav_server.loops.ticks import ticks
from mrnav_server.sim.virtual_time import AtOnce, VirtualTimeEndedError, VirtualTimeLoop


def run(work: Callable[[VirtualTimeLoop], Awaitable[None]]) -> VirtualTimeLoop:
    loop = VirtualTimeLoop()
    try:
        loop.run_until_complete(asyncio.ensure_future(_within(work, loop), loop=loop))
    finally:
        loop.close()
    return loop


async def _within(work: Callable[[VirtualTimeLoop], Awaitable[None]], loop: VirtualTimeLoop) -> None:
    await work(loop)


@settings(deadline=None, max_examples=50)
@given(delays_s=st.lists(st.integers(0, 100_000), max_size=20))
def test_timers_fire_in_order_at_their_times(delays_s: list[int]) -> None:
    fired: list[tuple[float, int]] = []

    async def work(loop: VirtualTimeLoop) -> None:
        began_s = loop.time()

        def fire(delay_s: int) -> None:
            fired.append((loop.time() - began_s, delay_s))

        for delay_s in delays_s:
            loop.call_at(began_s + delay_s, fire, delay_s)
        await asyncio.sleep(100_001.0)

    run(work)
    assert [delay_s for _, delay_s in fired] == sorted(delays_s)
    assert all(at_s == pytest.approx(delay_s, abs=1e-6) for at_s, delay_s in fired)


def test_a_day_passes_at_once_by_the_loop_s_clock_alone() -> None:
    began_s = time.monotonic()

    async def work(loop: VirtualTimeLoop) -> None:
        before_s = loop.time()
        await asyncio.sleep(86_400.0)
        assert loop.time() - before_s == pytest.approx(86_400.0)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(3600.0):
                await asyncio.Event().wait()

    run(work)
    assert time.monotonic() - began_s < 3600.0


def test_time_stands_still_while_a_socket_has_something_to_read() -> None:
    echoes: list[tuple[bytes, float]] = []

    async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(100):
            writer.write(data)
        writer.close()

    async def work(loop: VirtualTimeLoop) -> None:
        async def tick() -> None:
            async for _ in ticks(0.001, loop.time):
                pass

        ticking = asyncio.ensure_future(tick())
        server = await asyncio.start_server(echo, "127.0.0.1", 0)
        reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
        for number in range(20):
            sent_s = loop.time()
            writer.write(b"%d" % number)
            echoes.append((await reader.read(100), loop.time() - sent_s))
            await asyncio.sleep(0.5)
        writer.close()
        await writer.wait_closed()
        await asyncio.sleep(0.1)
        ticking.cancel()
        server.close()

    run(work)
    assert [data for data, _ in echoes] == [b"%d" % number for number in range(20)]
    # A packet that the kernel delivers late on a busy machine may cost a tick or two.
    assert sorted(took_s for _, took_s in echoes)[10] == 0.0


def test_a_job_that_waits_has_its_place_in_the_order() -> None:
    seen: list[tuple[str, float]] = []

    async def work(loop: VirtualTimeLoop) -> None:
        began_s = loop.time()

        def job() -> str:
            for _ in range(3):
                loop.waiting.sleep(0.02)
                seen.append(("job", round(loop.waiting.now_s() - began_s, 6)))
            return "done"

        ended = loop.run_in_executor(None, job)
        for _ in range(3):
            await asyncio.sleep(0.015)
            seen.append(("loop", round(loop.time() - began_s, 6)))
        assert await ended == "done"

    run(work)
    assert seen == [
        ("loop", 0.015),
        ("job", 0.02),
        ("loop", 0.03),
        ("job", 0.04),
        ("loop", 0.045),
        ("job", 0.06),
    ]


def test_a_job_computes_at_no_time_and_its_error_reaches_who_awaits_it() -> None:
    async def work(loop: VirtualTimeLoop) -> None:
        def compute() -> float:
            time.sleep(0.01)
            return loop.time()

        before_s = loop.time()
        soon = asyncio.ensure_future(asyncio.sleep(0.001))
        assert await asyncio.to_thread(compute) == before_s
        assert loop.time() == before_s
        await soon
        with pytest.raises(ZeroDivisionError):
            await asyncio.to_thread(lambda: 1 // 0)

    run(work)


def test_a_job_waits_for_a_socket_or_a_time() -> None:
    async def work(loop: VirtualTimeLoop) -> None:
        here, there = socket.socketpair()
        began_s = loop.time()

        def job() -> tuple[bool, bool, float, bool]:
            waiting = loop.waiting
            early = waiting.readable(here, began_s + 0.1)
            late = waiting.readable(here, began_s + 5.0)
            return early, late, waiting.now_s() - began_s, waiting.readable(here, began_s)

        loop.call_at(began_s + 1.0, lambda: there.send(b"x"))
        early, late, at_s, again = await loop.run_in_executor(None, job)
        assert (early, late, again) == (False, True, True)
        assert at_s == pytest.approx(1.0)
        here.close()
        there.close()

    run(work)


def test_a_job_that_still_waits_at_the_end_unwinds() -> None:
    ended: list[str] = []

    async def work(loop: VirtualTimeLoop) -> None:
        def job() -> None:
            try:
                loop.waiting.sleep(1e6)
            except VirtualTimeEndedError:
                ended.append("unwound")
                raise

        loop.run_in_executor(None, job)
        await asyncio.sleep(1.0)

    loop = run(work)
    assert ended == ["unwound"]
    assert not loop.jobs


def test_only_a_job_may_wait() -> None:
    async def work(loop: VirtualTimeLoop) -> None:
        with pytest.raises(RuntimeError, match="run_in_executor"):
            loop.waiting.sleep(1.0)

    run(work)


def test_at_once_has_the_result_or_the_error() -> None:
    assert AtOnce().submit(pow, 2, 3).result(timeout=0) == 8
    assert isinstance(AtOnce().submit(lambda: 1 // 0).exception(timeout=0), ZeroDivisionError)
