"""Bridges the camera's delay: the magnet's recent path, and a robot that it draws along like a stone."""

import math
from collections import deque


class HoldLog:
    """Where the hold point was over the last second, in the vessel's plane in µm.

    Args:
        size: Readings that are kept.
    """

    def __init__(self, size: int = 128) -> None:
        self._readings: deque[tuple[float, float, float]] = deque(maxlen=size)

    def record(self, taken_s: float, hold_um: tuple[float, float]) -> None:
        """Add a reading; one that is not newer than the last is ignored."""
        if not self._readings or taken_s > self._readings[-1][0]:
            self._readings.append((taken_s, *hold_um))

    @property
    def newest_um(self) -> tuple[float, float]:
        """The newest hold point."""
        return self._readings[-1][1:]

    def at(self, taken_s: float) -> tuple[float, float]:
        """Return the hold point at a time, linear between readings, constant beyond them.

        Raises:
            IndexError: If nothing was recorded.
        """
        later = self._readings[-1]
        for earlier in reversed(self._readings):
            if earlier[0] <= taken_s:
                span_s = later[0] - earlier[0]
                share = min((taken_s - earlier[0]) / span_s, 1.0) if span_s > 0.0 else 0.0
                return (
                    earlier[1] + share * (later[1] - earlier[1]),
                    earlier[2] + share * (later[2] - earlier[2]),
                )
            later = earlier
        return later[1], later[2]

    def travel_um(self, span_s: float) -> tuple[float, float]:
        """Return how the hold point moved over the last ``span_s`` seconds of readings, as a vector."""
        newest_s, x_um, y_um = self._readings[-1]
        before_x_um, before_y_um = self.at(newest_s - span_s)
        return x_um - before_x_um, y_um - before_y_um

    def drawn(
        self, robot_um: tuple[float, float], seen_s: float, offset_um: tuple[float, float], leash_um: float
    ) -> tuple[float, float]:
        """Return where the robot is now: a stone on a leash, drawn along the readings since it was seen.

        Args:
            robot_um: Where it was seen.
            seen_s: When it was there.
            offset_um: Error of the hold point.
            leash_um: Length of the leash.
        """
        since: list[tuple[float, float, float]] = []
        for reading in reversed(self._readings):
            if reading[0] <= seen_s:
                break
            since.append(reading)
        x_um, y_um = robot_um
        for _, hold_x_um, hold_y_um in reversed(since):
            dx_um, dy_um = hold_x_um - offset_um[0] - x_um, hold_y_um - offset_um[1] - y_um
            away_um = math.hypot(dx_um, dy_um)
            if away_um > leash_um:
                pull = 1.0 - leash_um / away_um
                x_um += pull * dx_um
                y_um += pull * dy_um
        return x_um, y_um
