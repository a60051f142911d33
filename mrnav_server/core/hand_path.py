"""From the hand's poses to a goal for the tip: dead band, jumps, gain, and a bound that is a speed."""

import math
from dataclasses import dataclass

from mrnav_server.core.frames import HandPoint

_LONGEST_S = 0.1
"""A hand unseen for longer is lost anyway; it buys no further motion."""
_SLIDE_S = 0.03
"""The goal takes so long to a new pose, a little less than the time between two of them."""
_SHORTEST_S = 1.0 / 120.0
"""Poses that come closer than this are bunched, not fast."""


@dataclass(frozen=True, slots=True)
class PathBounds:
    """What one pose may do.

    Attributes:
        dead_band_um: Play between hand and goal: the hand must leave it to move anything.
        jump_m_per_s: No hand is faster; what is faster is a tracker that jumped.
        speed_um_per_s: Largest speed of the goal.
    """

    dead_band_um: float
    jump_m_per_s: float
    speed_um_per_s: float


class HandPath:
    """The goal, as an offset from where the hand engaged.

    The dead band is play (backlash) in the cumulative pose, and never a threshold on each difference, which
    would throw a slow hand's motion away: beyond the play everything arrives, however slow.

    Args:
        bounds: What one pose may do.
    """

    def __init__(self, bounds: PathBounds) -> None:
        self._bounds = bounds
        self._pose: HandPoint | None = None
        self._centre = HandPoint(0.0, 0.0, 0.0)
        self._sender_s = self._received_s = 0.0
        self._room_um = self._slide_s = 0.0
        self._goal_um = self._slid_um = (0.0, 0.0, 0.0)

    def zero(self) -> None:
        """Count from the newest pose on."""
        self._goal_um = self._slid_um = (0.0, 0.0, 0.0)
        self._slide_s = 0.0
        self._room_um = self._bounds.speed_um_per_s * _LONGEST_S
        if self._pose is not None:
            self._centre = self._pose

    def forget(self) -> None:
        """The next pose is the first."""
        self._pose = None

    def note(self, pose: HandPoint, sender_s: float, received_s: float) -> None:
        """Know where the hand is without moving anything."""
        self._pose = self._centre = pose
        self._sender_s, self._received_s = sender_s, received_s

    def follow(
        self, pose: HandPoint, sender_s: float, received_s: float, gains: tuple[float, float, float]
    ) -> bool:
        """Move the goal by what the hand moved; tell whether the hand jumped, which moves nothing.

        Args:
            pose: A new one.
            sender_s: On the sender's clock.
            received_s: On the server's clock.
            gains: Tip motion per hand motion for hand x, y, z.
        """
        before = self._pose
        if before is None:
            self.note(pose, sender_s, received_s)
            return False
        elapsed_s = min(max(sender_s - self._sender_s, 0.0), _LONGEST_S)
        waited_s = max(received_s - self._received_s, 0.0)
        self._pose, self._sender_s, self._received_s = pose, sender_s, received_s
        jump_m = self._bounds.jump_m_per_s * max(elapsed_s, _SHORTEST_S)
        if math.dist(_xyz(before), _xyz(pose)) > jump_m:
            self._centre = pose
            return True
        moved_m = self._beyond_play(pose)
        # The operator looks down on the picture: hand right is stage x, towards the body is stage y.
        right, up, back = (1e6 * gain * m for gain, m in zip(gains, moved_m, strict=True))
        self._add((right, back, up), elapsed_s, waited_s)
        return False

    @property
    def sliding_s(self) -> float:
        """How long the goal is still on its way to the newest pose; 0 where it has arrived."""
        return self._slide_s

    def slide(self, dt_s: float) -> tuple[float, float, float]:
        """Let the goal move on evenly towards the newest pose, and return it.

        Thirty poses a second are thirty steps a second: unless they become slopes again, the setpoint's jerk
        limit is busy with the steps, and tremor passes.

        Args:
            dt_s: How much time passes.
        """
        share = min(1.0, dt_s / self._slide_s) if self._slide_s > 0.0 else 1.0
        x, y, z = (a + share * (b - a) for a, b in zip(self._slid_um, self._goal_um, strict=True))
        self._slid_um = (x, y, z)
        self._slide_s = max(self._slide_s - dt_s, 0.0)
        return self._slid_um

    def _beyond_play(self, pose: HandPoint) -> tuple[float, float, float]:
        """Drag the play's centre along and return how far it went, in metres."""
        centre, at = _xyz(self._centre), _xyz(pose)
        away_m = math.dist(centre, at)
        play_m = 1e-6 * self._bounds.dead_band_um
        if away_m <= play_m:
            return (0.0, 0.0, 0.0)
        share = 1.0 - play_m / away_m
        x, y, z = (share * (b - a) for a, b in zip(centre, at, strict=True))
        self._centre = HandPoint(centre[0] + x, centre[1] + y, centre[2] + z)
        return (x, y, z)

    def _add(self, step_um: tuple[float, float, float], elapsed_s: float, waited_s: float) -> None:
        top_um_per_s = self._bounds.speed_um_per_s
        # By the sender's clock jitter costs nothing; by the server's a wrong clock gains nothing.
        self._room_um = min(self._room_um + top_um_per_s * waited_s, top_um_per_s * _LONGEST_S)
        most_um = min(top_um_per_s * elapsed_s, self._room_um)
        length_um = math.hypot(*step_um)
        share = min(1.0, most_um / length_um) if length_um > 0.0 else 0.0
        self._room_um -= share * length_um
        x, y, z = (goal + share * step for goal, step in zip(self._goal_um, step_um, strict=True))
        self._goal_um = (x, y, z)
        self._slide_s = _SLIDE_S


def _xyz(point: HandPoint) -> tuple[float, float, float]:
    return (point.x_m, point.y_m, point.z_m)
