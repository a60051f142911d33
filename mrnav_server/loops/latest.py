"""The newest value of a stream: readers never queue up behind each other."""

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

T = TypeVar("T")


class Latest(Generic[T]):
    """Holds the newest value; any number of readers may wait for a newer one.

    All calls come from the event loop's thread; a worker thread hands over with
    ``loop.call_soon_threadsafe(latest.put, value)``.
    """

    def __init__(self) -> None:
        self._value: T | None = None
        self._version = 0
        self._waiters: set[asyncio.Future[None]] = set()
        self._listeners: list[Callable[[], object]] = []

    @property
    def value(self) -> T | None:
        """The newest value, or None before the first."""
        return self._value

    @property
    def version(self) -> int:
        """How many values were put."""
        return self._version

    def put(self, value: T) -> None:
        """Replace the value and wake every waiting reader."""
        self._value = value
        self._version += 1
        for waiter in self._waiters:
            if not waiter.done():
                waiter.set_result(None)
        self._waiters.clear()
        for listener in self._listeners:
            listener()

    @contextmanager
    def told(self, listener: Callable[[], object]) -> Iterator[None]:
        """Call a listener after each put meanwhile; it must be quick, for the writer waits."""
        self._listeners.append(listener)
        try:
            yield
        finally:
            self._listeners.remove(listener)

    async def newer_than(self, version: int) -> tuple[T, int]:
        """Wait for a value newer than ``version``; return it with its own version."""
        while self._version <= version or self._value is None:
            waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            self._waiters.add(waiter)
            try:
                await waiter
            finally:
                self._waiters.discard(waiter)
        return self._value, self._version
