"""When autonomy does not get anywhere: it stands, dithers, turns in circles, or takes for ever."""

import math

from mrnav_server.core.frames import VesselPoint

_MOVED_UM = 50.0
"""Less than this is noise, or a robot that trembles."""
_REVERSED_COS = -0.5
"""Two moves that enclose more than 120° are a reversal."""


class Progress:
    """Watches one task.

    Args:
        patience_s: The robot must move, and the way left must shrink, within this time.
        most_reversals: So often the robot may turn back without getting nearer.
        longest_s: A task takes no longer.
        um_per_px: Size of a grid pixel.
    """

    def __init__(self, patience_s: float, most_reversals: int, longest_s: float, um_per_px: float) -> None:
        self._patience_s = patience_s
        self._most_reversals = most_reversals
        self._longest_s = longest_s
        self._um_per_px = um_per_px
        self._began_s = self._moved_s = self._nearer_s = math.inf
        self._reversals = 0

    def begin(self, robot: VesselPoint, now_s: float) -> None:
        """Begin a task."""
        self._began_s = now_s
        self.restart(robot, now_s)

    def restart(self, robot: VesselPoint, now_s: float) -> None:
        """Measure the way left anew: the task goes on along another path."""
        self._robot = robot
        self._heading = (0.0, 0.0)
        self._best_um = math.inf
        self._moved_s = self._nearer_s = now_s
        self._reversals = 0

    def note(self, robot: VesselPoint, left_um: float | None, now_s: float) -> None:
        """Take note of where the robot is.

        Args:
            robot: The robot.
            left_um: The way left; None while there is no path.
            now_s: Now.
        """
        dx, dy = robot.x_px - self._robot.x_px, robot.y_px - self._robot.y_px
        moved_px = math.hypot(dx, dy)
        if moved_px * self._um_per_px > _MOVED_UM:
            hx, hy = dx / moved_px, dy / moved_px
            self._reversals += hx * self._heading[0] + hy * self._heading[1] < _REVERSED_COS
            self._robot, self._heading, self._moved_s = robot, (hx, hy), now_s
        if left_um is not None and left_um < self._best_um - _MOVED_UM:
            self._best_um, self._nearer_s, self._reversals = left_um, now_s, 0

    def objection(self, now_s: float) -> str:
        """Return why the task should be given up, or ""."""
        if now_s - self._moved_s > self._patience_s:
            return f"no progress: the robot has not moved for {self._patience_s:.0f} s"
        if now_s - self._nearer_s > self._patience_s:
            return f"no progress: the robot has come no nearer for {self._patience_s:.0f} s"
        if self._reversals > self._most_reversals:
            return f"no progress: the robot turned back {self._reversals} times"
        if now_s - self._began_s > self._longest_s:
            return f"the task has taken longer than {self._longest_s:.0f} s"
        return ""
