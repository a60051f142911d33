"""A steady beat on absolute deadlines: sleeping for a period each time would drift and slow down."""

import asyncio
from collections.abc import AsyncIterator, Callable


async def ticks(period_s: float, clock: Callable[[], float]) -> AsyncIterator[float]:
    """Yield the time at every beat; beats that were missed are skipped, never caught up.

    Args:
        period_s: Time between beats.
        clock: The event loop's monotonic clock.
    """
    due_s = clock() + period_s
    while True:
        await asyncio.sleep(max(0.0, due_s - clock()))
        now_s = clock()
        yield now_s
        due_s += period_s
        if due_s <= now_s:
            due_s = now_s + period_s
