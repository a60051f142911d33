"""Events: what happens once and must not be missed, next to the states, which are sampled."""

from asyncio import Event as Flag
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

Event = dict[str, Any]


class LaggingReaderError(Exception):
    """A subscriber took no events for so long that its queue is full. Reaction: drop that subscriber."""


class Subscription:
    """One reader's events, oldest first, none left out.

    Args:
        capacity: Events that may wait; one more and the reader is told that it lags.
    """

    def __init__(self, capacity: int) -> None:
        self._events: deque[Event] = deque()
        self._capacity = capacity
        self._lags = False
        self._news = Flag()

    def put(self, event: Event) -> None:
        """Append an event. Never waits."""
        if len(self._events) < self._capacity:
            self._events.append(event)
        else:
            self._lags = True
        self._news.set()

    async def get(self) -> Event:
        """Wait for the next event and return it.

        Raises:
            LaggingReaderError: If an event had to be left out.
        """
        while not self._events:
            self._news.clear()
            await self._news.wait()
        if self._lags:
            raise LaggingReaderError(f"{self._capacity} events waited and one more came")
        return self._events.popleft()


class EventBus:
    """Hands every event to every subscriber. All calls come from the event loop's thread.

    Args:
        capacity: Events that may wait for one subscriber.
    """

    def __init__(self, capacity: int = 256) -> None:
        self._capacity = capacity
        self._subscriptions: set[Subscription] = set()

    def publish(self, event: Event) -> None:
        """Give an event to everybody who subscribes now. Never waits."""
        for subscription in self._subscriptions:
            subscription.put(event)

    @contextmanager
    def subscribe(self) -> Iterator[Subscription]:
        """Receive every event from now on, for the length of a ``with`` block."""
        subscription = Subscription(self._capacity)
        self._subscriptions.add(subscription)
        try:
            yield subscription
        finally:
            self._subscriptions.discard(subscription)
