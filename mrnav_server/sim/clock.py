"""The simulated world's thin clock: lets as much time pass in the world as passed outside."""

from collections.abc import Callable

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.frames import StagePoint
from mrnav_server.sim.world import SimulatedWorld


class WorldClock:
    """Keeps a world on real time.

    Args:
        world: The world.
        clock: Monotonic time in seconds.
        tip: Where a manipulator outside the world reports its tip, which the world's magnet then follows;
            None leaves the magnet to the world's own manipulator.
    """

    def __init__(
        self,
        world: SimulatedWorld,
        clock: Callable[[], float],
        tip: Callable[[], StagePoint] | None = None,
    ) -> None:
        self._world = world
        self._clock = clock
        self._tip = tip
        self._caught_up_s: float | None = None

    def catch_up(self) -> None:
        """Advance the world to now; the first call only sets its clock, and its magnet to the tip."""
        now_s = self._clock()
        tip = self._reported_tip()
        if self._caught_up_s is None:
            self._world.set_time(now_s)
            if tip is not None:
                self._world.place_tip(tip)
        else:
            if tip is not None:
                self._world.follow(tip)
            self._world.advance(now_s - self._caught_up_s)
        self._caught_up_s = now_s

    def _reported_tip(self) -> StagePoint | None:
        if self._tip is None:
            return None
        try:
            return self._tip()
        except DeviceError:
            return None  # the magnet stays where it was last seen; the control loop tells the fault
