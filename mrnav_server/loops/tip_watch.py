"""Does the tip do what it was told? Judged by positions alone: a device's own "completed" is no proof.

At every reading the tip must lie, on each axis, between the targets that were in force lately. That holds
for any device that follows without overshoot, whatever its lag, and for none that stalls, stops short or
strays.
"""

import math
from collections import deque
from itertools import pairwise

from mrnav_server.core.frames import StagePoint
from mrnav_server.core.records import MotionCommand, TipReading
from mrnav_server.loops.guards import GuardConfig

_Xyz = tuple[float, float, float]

_STILL_UM = 2.0
"""What changes by less has not moved: noise of a reading."""


class TipWatch:
    """The targets of the last moments, and what the readings say to them.

    Args:
        config: Bounds and durations.
    """

    def __init__(self, config: GuardConfig) -> None:
        self._config = config
        self._targets: deque[tuple[float, _Xyz]] = deque()
        self._readings: deque[tuple[float, _Xyz]] = deque()
        self._behind_since_s: float | None = None
        self._fault = ""

    def begin(self, tip: TipReading) -> None:
        """Forget what was, and expect the tip where it is: it was told nothing yet."""
        self._targets = deque([(-math.inf, _xyz(tip.position))])
        self._readings.clear()
        self._behind_since_s = None
        self._fault = ""

    def sent(self, command: MotionCommand) -> None:
        """Expect the tip at a target from now on."""
        self._targets.append((command.sent_s, _xyz(command.target)))

    def fault(self, tip: TipReading) -> str:
        """Return how the tip disobeys, or "" while it follows. Call :meth:`begin` first.

        Args:
            tip: The newest reading; one that was judged already changes nothing.
        """
        if self._readings and tip.taken_s <= self._readings[-1][0]:
            return self._fault
        at_um = _xyz(tip.position)
        self._readings.append((tip.taken_s, at_um))
        _forget(self._readings, tip.taken_s - self._config.off_target_s)
        _forget(self._targets, tip.taken_s - self._config.off_target_s)
        self._fault = self._off_target(at_um) or self._following_error(tip.taken_s, at_um)
        return self._fault

    def _off_target(self, at_um: _Xyz) -> str:
        """Return which axis is neither at its target nor on its way there, or ""."""
        _, first_um = self._readings[0]
        for axis, name in enumerate("XYZ"):
            told_um = [target_um[axis] for _, target_um in self._targets]
            off_um = max(min(told_um) - at_um[axis], at_um[axis] - max(told_um))
            if off_um <= self._config.off_target_um:
                continue
            away_um = abs(told_um[-1] - at_um[axis])
            asked = max(told_um) - min(told_um) > _STILL_UM
            moved = abs(at_um[axis] - first_um[axis]) > _STILL_UM
            if asked and not moved:
                return (
                    f"the manipulator does not move although it was told to: its {name} axis is"
                    f" {away_um:.0f} µm away and stood still for {1000 * self._config.off_target_s:.0f} ms"
                )
            if not asked and not moved:
                return f"the manipulator rests {away_um:.0f} µm from its target on its {name} axis"
            return f"the manipulator is not where it was told to be: its {name} axis is {away_um:.0f} µm off"
        return ""

    def _following_error(self, taken_s: float, at_um: _Xyz) -> str:
        """Return that the tip has been too far behind for too long, or ""."""
        since_s = taken_s - self._config.following_lag_s
        replaced = [replaced_s for _, (replaced_s, _) in pairwise(self._targets)] + [math.inf]
        gap_um = min(
            math.dist(target_um, at_um)
            for (_, target_um), replaced_s in zip(self._targets, replaced, strict=True)
            if replaced_s > since_s
        )
        if gap_um <= self._config.following_error_um:
            self._behind_since_s = None
            return ""
        if self._behind_since_s is None:
            self._behind_since_s = taken_s
        if taken_s - self._behind_since_s < self._config.following_s:
            return ""
        return f"the manipulator does not follow: {gap_um:.0f} µm behind its setpoint"


def _xyz(point: StagePoint) -> _Xyz:
    return (point.x_um, point.y_um, point.z_um)


def _forget(history: deque[tuple[float, _Xyz]], oldest_s: float) -> None:
    """Drop what was no longer in force at a time."""
    while len(history) > 1 and history[1][0] <= oldest_s:
        history.popleft()
