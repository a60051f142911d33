"""The simulated world's thin clock: lets as much time pass in the world as passed outside."""

from collections.abc import Callable

from mrnav_server.sim.world import SimulatedWorld


class WorldClock:
    """Keeps a world on real time.

    Args:
        world: The world.
        clock: Monotonic time in seconds.
    """

    def __init__(self, world: SimulatedWorld, clock: Callable[[], float]) -> None:
        self._world = world
        self._clock = clock
        self._caught_up_s: float | None = None

    def catch_up(self) -> None:
        """Advance the world to now; the first call only sets its clock."""
        now_s = self._clock()
        if self._caught_up_s is None:
            self._world.set_time(now_s)
        else:
            self._world.advance(now_s - self._caught_up_s)
        self._caught_up_s = now_s
