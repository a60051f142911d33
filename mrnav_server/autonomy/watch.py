"""Where the robot is now and how the magnet holds it, from camera frames and tip readings."""

import math
from collections import deque
from dataclasses import replace

from mrnav_server.autonomy.leash import HoldLog
from mrnav_server.autonomy.observer import Coupling, ObserverConfig, bounded_lead_um, bounded_um, observed
from mrnav_server.autonomy.plane import Plane
from mrnav_server.core.records import TipReading, Track
from mrnav_server.core.vessel import VesselMap

Vector = tuple[float, float]
_STILL: Vector = (0.0, 0.0)
_LONGEST_GAP_S = 0.15
"""Two sightings further apart than this tell no velocity."""
_FASTEST_UM_PER_S = 8000.0
"""Anything faster is the tracker that found the robot again elsewhere."""
_LEAST_LEASH_UM = 10.0
_STICKING_UM_PER_S = 300.0
_FREE_UM = 30.0
"""A robot nearer to the wall may lean on it, and then tells nothing about the magnet."""


class RobotWatch:
    """Keeps the last sightings and hold points, and learns the coupling from a moving robot.

    Args:
        vessel: The vessel model.
        plane: Maps between the vessel's plane and the stage.
        config: Gains of the observer.
        coupling: What is known of magnet and robot.

    Attributes:
        coupling: What has been learnt so far.
    """

    def __init__(self, vessel: VesselMap, plane: Plane, config: ObserverConfig, coupling: Coupling) -> None:
        self.coupling = coupling
        self._vessel = vessel
        self._plane = plane
        self._config = config
        self._holds = HoldLog()
        self._sightings: deque[tuple[float, float, float]] = deque(maxlen=32)
        self._lag_um = _STILL
        self._moving = False
        self._speed_um_per_s = 0.0

    @property
    def seen_s(self) -> float:
        """When the robot was last seen; minus infinity before."""
        return self._sightings[-1][0] if self._sightings else -math.inf

    @property
    def seen_um(self) -> Vector:
        """Where the robot was last seen."""
        return self._sightings[-1][1:]

    @property
    def hold_um(self) -> Vector:
        """The newest hold point."""
        return self._holds.newest_um

    @property
    def sticks(self) -> bool:
        """Whether the robot did not get on when it was last seen."""
        return self._speed_um_per_s < _STICKING_UM_PER_S

    @property
    def lag_um(self) -> Vector:
        """The hold point minus the robot, when the robot was last seen."""
        return self._lag_um

    @property
    def leash_um(self) -> Vector:
        """The hold point less its offset error, minus the robot, when the robot was last seen."""
        bx, by = self.coupling.offset_um
        return self._lag_um[0] - bx, self._lag_um[1] - by

    def take(
        self,
        track: Track | None,
        tip: TipReading,
        acceleration_um_per_s2: Vector = _STILL,
        *,
        learn: bool = True,
    ) -> bool:
        """Take in the newest track and reading, and learn from a new sighting of a moving robot.

        Args:
            track: One that was seen before, or without a position, is passed over.
            tip: The newest reading.
            acceleration_um_per_s2: The robot's planned acceleration.
            learn: Whether the robot may be taken to trail the magnet steadily, as it does not at break-away.

        Returns:
            Whether the robot was sighted anew and rests.
        """
        self._holds.record(tip.taken_s, self._plane.hold_um(tip.position))
        if track is None or track.vessel is None or track.taken_s <= self.seen_s:
            return False
        robot_um = self._plane.point_um(track.vessel)
        velocity = self._velocity_um_per_s(track.taken_s, robot_um)
        hold_um = self._holds.at(track.taken_s)
        self._lag_um = (hold_um[0] - robot_um[0], hold_um[1] - robot_um[1])
        self._sightings.append((track.taken_s, *robot_um))
        self._speed_um_per_s = math.hypot(*velocity)
        self._moving = self._speed_um_per_s > self._config.moving_um_per_s
        if learn and self._moving and self._vessel.clearance_um(track.vessel) > _FREE_UM:
            self.coupling = observed(
                self.coupling, self._lag_um, velocity, acceleration_um_per_s2, self._config
            )
        return not self._moving

    def learn_breakaway(self, rest_lag_um: Vector, moved_um: Vector) -> None:
        """Learn the offset error across the way on which a resting robot broke away.

        It went where the magnet drew it: hold point less offset error, minus robot, points along its first
        motion. Along it, offset error and lead look alike.

        Args:
            rest_lag_um: Hold point minus robot when it was last seen at rest.
            moved_um: Its motion since.
        """
        span_um = math.hypot(*moved_um)
        nx, ny = -moved_um[1] / span_um, moved_um[0] / span_um
        bx, by = self.coupling.offset_um
        across_um = (rest_lag_um[0] - bx) * nx + (rest_lag_um[1] - by) * ny
        self.coupling = replace(
            self.coupling, offset_um=bounded_um((bx + across_um * nx, by + across_um * ny), self._config)
        )

    def learn_lead(self, breakaway_um: float) -> None:
        """Take the leash at which a resting robot broke away, or did not, for the lead of a moving one."""
        lead_um = bounded_lead_um(breakaway_um / self._config.breakaway_ratio, self._config)
        self.coupling = replace(self.coupling, lead_um=lead_um)

    def robot_now_um(self) -> Vector:
        """Return where the robot is now: its last sighting, drawn along by the hold points since."""
        taut_um = math.hypot(*self.leash_um)
        lead_um = self.coupling.lead_um
        if self._moving or taut_um > lead_um:
            lead_um = max(taut_um, _LEAST_LEASH_UM)
        return self._holds.drawn(self.seen_um, self.seen_s, self.coupling.offset_um, lead_um)

    def at_rest(self, span_s: float, noise_um: float) -> bool:
        """Tell whether camera and manipulator both saw no motion for a while."""
        seen_s, x_um, y_um = self._sightings[-1]
        for before_s, before_x_um, before_y_um in reversed(self._sightings):
            if math.hypot(x_um - before_x_um, y_um - before_y_um) > noise_um:
                return False
            if seen_s - before_s >= span_s:
                return math.hypot(*self._holds.travel_um(span_s)) < noise_um
        return False

    def mean_um(self, span_s: float) -> Vector:
        """Return the mean of the last sightings."""
        recent = [sighting for sighting in self._sightings if self.seen_s - sighting[0] <= span_s]
        return sum(s[1] for s in recent) / len(recent), sum(s[2] for s in recent) / len(recent)

    def stopping_point_um(self, stopping_s: float) -> Vector:
        """Return where the hold point will be after a time at its present velocity."""
        x_um, y_um = self._holds.newest_um
        dx_um, dy_um = self._holds.travel_um(stopping_s)
        return x_um + dx_um, y_um + dy_um

    def _velocity_um_per_s(self, taken_s: float, robot_um: Vector) -> Vector:
        gap_s = taken_s - self.seen_s
        if gap_s > _LONGEST_GAP_S or math.dist(robot_um, self.seen_um) > _FASTEST_UM_PER_S * gap_s:
            return _STILL
        return (robot_um[0] - self.seen_um[0]) / gap_s, (robot_um[1] - self.seen_um[1]) / gap_s
