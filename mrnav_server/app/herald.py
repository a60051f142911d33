"""What happens once: everybody is told, and it is recorded."""

from collections.abc import Callable, Mapping

from mrnav_server.core import wire_twin
from mrnav_server.loops.events import EventBus
from mrnav_server.loops.recorder import Recorder

_OWN_TOPIC = ("mode", "trial")
"""Events with a topic of their own in the log; all others share one."""


class Herald:
    """Tells and records.

    Args:
        events: Reaches every twin client.
        recorder: Writes the running trial's log.
        clock: Monotonic time in seconds.
    """

    def __init__(self, events: EventBus, recorder: Recorder, clock: Callable[[], float]) -> None:
        self._events = events
        self._recorder = recorder
        self._clock = clock

    def announce(self, name: str, fields: Mapping[str, object]) -> None:
        """Tell everybody what happened, and record it."""
        self._events.publish(wire_twin.event(name, self._clock(), fields))
        self.record(name if name in _OWN_TOPIC else "event", {"event": name, **fields})

    def record(self, topic: str, data: Mapping[str, object]) -> None:
        """Write a line of the running trial's log; without a trial it is dropped."""
        self._recorder.record(topic, data)
