"""The event bus: everything in order to everybody, and a reader that lags is told."""

import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.loops.events import EventBus, LaggingReaderError


@given(before=st.integers(0, 5), during=st.integers(0, 50))
async def test_every_reader_gets_all_events_of_its_time_in_order(before: int, during: int) -> None:
    bus = EventBus(capacity=50)
    for number in range(before):
        bus.publish({"number": -number})
    with bus.subscribe() as first, bus.subscribe() as second:
        for number in range(during):
            bus.publish({"number": number})
        for reader in (first, second):
            assert [(await reader.get())["number"] for _ in range(during)] == list(range(during))


async def test_a_reader_waits_for_news() -> None:
    bus = EventBus()
    with bus.subscribe() as events:
        async with asyncio.TaskGroup() as group:
            waiting = group.create_task(events.get())
            await asyncio.sleep(0)
            assert not waiting.done()
            bus.publish({"event": "mode"})
        assert waiting.result() == {"event": "mode"}


async def test_a_lagging_reader_is_told_and_stops_no_other() -> None:
    bus = EventBus(capacity=3)
    with bus.subscribe() as lagging, bus.subscribe() as healthy:
        for number in range(4):
            bus.publish({"number": number})
            assert (await healthy.get())["number"] == number
        with pytest.raises(LaggingReaderError):
            await lagging.get()


async def test_after_the_block_nothing_arrives() -> None:
    bus = EventBus(capacity=1)
    with bus.subscribe() as events:
        pass
    bus.publish({})
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0):
            await events.get()
