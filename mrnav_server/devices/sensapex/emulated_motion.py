"""How an emulated manipulator moves: each axis on a trapezoid of speed, in closed form.

Told the time and nothing else; a motion is computed when it is asked for, its course read off later.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

TRAVEL_UM = 20_000.0
"""Every axis goes from 0 to here; its ends are hard."""

Leg = tuple[float, float]
"""A stretch of constant acceleration: how long in s, how much in µm/s²."""


@dataclass(frozen=True, slots=True)
class Goal:
    """Where one axis shall go.

    Attributes:
        target_um: Absolute position in µm.
        speed_um_per_s: Highest speed, > 0.
        acceleration_um_per_s2: Acceleration and deceleration, > 0.
    """

    target_um: float
    speed_um_per_s: float
    acceleration_um_per_s2: float


def trapezoid(at_um: float, velocity_um_per_s: float, goal: Goal) -> tuple[Leg, ...]:
    """Return the quickest motion to rest at a goal: towards the speed, cruise, brake.

    Args:
        at_um: Position at the start.
        velocity_um_per_s: Velocity at the start; may point away from the goal or be above its speed.
        goal: Where to, and how fast.
    """
    a = goal.acceleration_um_per_s2
    gap = goal.target_um - at_um
    toward = 1.0 if gap >= velocity_um_per_s * abs(velocity_um_per_s) / (2 * a) else -1.0
    gap, v = toward * gap, toward * velocity_um_per_s
    peak = min(goal.speed_um_per_s, math.sqrt(max(a * gap + v * v / 2, 0.0)))
    if peak == 0.0:
        return ((abs(v) / a, -math.copysign(a, v) * toward),) if v else ()
    first = math.copysign(a, peak - v)
    cruise_um = gap - (peak * peak - v * v) / (2 * first) - peak * peak / (2 * a)
    return (
        (abs(peak - v) / a, first * toward),
        (max(cruise_um, 0.0) / peak, 0.0),
        (peak / a, -a * toward),
    )


class Axis:
    """One axis of a manipulator.

    Args:
        at_um: Where it stands.
    """

    def __init__(self, at_um: float) -> None:
        self._target_um = self._start_um = at_um
        self._start_s = self.ends_s = -math.inf
        self._velocity_um_per_s = 0.0
        self._legs: tuple[Leg, ...] = ()
        self._goal: Goal | None = None
        self._stalled = False

    def state(self, now_s: float) -> tuple[float, float]:
        """Return position in µm and velocity in µm/s."""
        if now_s >= self.ends_s:
            return self._target_um, 0.0
        at_um, v, left_s = self._start_um, self._velocity_um_per_s, now_s - self._start_s
        for duration_s, acceleration in self._legs:
            t = min(left_s, duration_s)
            at_um += v * t + acceleration * t * t / 2
            v += acceleration * t
            left_s -= t
            if left_s <= 0:
                break
        return min(max(at_um, 0.0), TRAVEL_UM), v

    def moving(self, now_s: float) -> bool:
        """Whether it works towards a goal that it has not reached."""
        return now_s < self.ends_s

    def go(self, goal: Goal, now_s: float) -> None:
        """Take a new goal from the present position and velocity; it is clipped to the travel."""
        at_um, v = self.state(now_s)
        goal = Goal(
            min(max(goal.target_um, 0.0), TRAVEL_UM), goal.speed_um_per_s, goal.acceleration_um_per_s2
        )
        self._goal = goal
        if self._stalled:
            self._course(at_um, 0.0, (), goal.target_um, now_s)
            if at_um != goal.target_um:
                self.ends_s = math.inf
            return
        at_um, v, acceleration = _able_to_brake(at_um, v, goal.acceleration_um_per_s2)
        able = Goal(goal.target_um, goal.speed_um_per_s, acceleration)
        self._course(at_um, v, trapezoid(at_um, v, able), goal.target_um, now_s)

    def halt(self, acceleration_um_per_s2: float, now_s: float) -> None:
        """Brake to rest and forget the goal."""
        at_um, v, a = _able_to_brake(*self.state(now_s), acceleration_um_per_s2)
        self._goal = None
        rest_um = min(max(at_um + v * abs(v) / (2 * a), 0.0), TRAVEL_UM)
        self._course(at_um, v, ((abs(v) / a, -math.copysign(a, v)),) if v else (), rest_um, now_s)

    def cut(self, now_s: float) -> None:
        """Stand still at once, as without power."""
        at_um, _ = self.state(now_s)
        self._goal = None
        self._course(at_um, 0.0, (), at_um, now_s)

    def stall(self, stalled: bool, now_s: float) -> None:
        """Get stuck where it is, or come free and go on to the goal."""
        if stalled == self._stalled:
            return
        goal = self._goal if self.moving(now_s) else None
        self.cut(now_s)
        self._stalled = stalled
        if goal is not None:
            self.go(goal, now_s)

    def _course(self, at_um: float, v: float, legs: tuple[Leg, ...], rest_um: float, now_s: float) -> None:
        self._start_um, self._velocity_um_per_s, self._legs = at_um, v, legs
        self._start_s, self._target_um = now_s, rest_um if legs else at_um
        self.ends_s = now_s + sum(duration_s for duration_s, _ in legs)


class Stage:
    """Axes that move together or one after another.

    Args:
        start_um: Where each axis stands, 3 or 4 values.
        acceleration_um_per_s2: What a halt brakes with.
    """

    def __init__(self, start_um: Sequence[float], acceleration_um_per_s2: float) -> None:
        self._axes = [Axis(at_um) for at_um in start_um]
        self._acceleration_um_per_s2 = acceleration_um_per_s2
        self._waiting: list[tuple[int, Goal]] = []
        self._turn = 0

    def positions_um(self, now_s: float) -> list[float]:
        """Return where the axes are."""
        return [axis.state(now_s)[0] for axis in self._axes]

    def velocities_um_per_s(self, now_s: float) -> list[float]:
        """Return how fast the axes are."""
        return [axis.state(now_s)[1] for axis in self._axes]

    def moving(self, now_s: float) -> list[bool]:
        """Return which axes work towards a goal."""
        return [axis.moving(now_s) for axis in self._axes]

    def at_rest(self, now_s: float) -> bool:
        """Whether nothing moves and nothing waits to move."""
        return not self._waiting and not any(self.moving(now_s))

    def next_change_s(self, now_s: float) -> float:
        """Return when the next axis arrives; infinity if none will."""
        return min((axis.ends_s for axis in self._axes if axis.moving(now_s)), default=math.inf)

    def advance(self, now_s: float) -> None:
        """Start the axes whose turn has come, each at the moment when the one before arrived."""
        while self._waiting and not self._axes[self._turn].moving(now_s):
            free_s = self._axes[self._turn].ends_s
            self._turn, goal = self._waiting.pop(0)
            self._axes[self._turn].go(goal, free_s)

    def go(self, goals: Mapping[int, Goal], together: bool, now_s: float) -> None:
        """Take new goals; an axis without one keeps what it does.

        Args:
            goals: One for each axis that shall move, by its number from 0.
            together: All at once, or one after another in the order of their numbers.
            now_s: Monotonic time.
        """
        ordered = sorted(goals.items())
        self._waiting = [] if together else ordered[1:]
        for number, goal in ordered if together else ordered[:1]:
            self._axes[number].go(goal, now_s)
            self._turn = number
        for number, _ in self._waiting:
            self._axes[number].halt(self._acceleration_um_per_s2, now_s)

    def halt(self, now_s: float) -> None:
        """Brake all axes to rest."""
        self._waiting = []
        for axis in self._axes:
            axis.halt(self._acceleration_um_per_s2, now_s)

    def cut(self, now_s: float) -> None:
        """Stand still at once."""
        self._waiting = []
        for axis in self._axes:
            axis.cut(now_s)

    def stall(self, stalled: Iterable[int], now_s: float) -> None:
        """Let these axes be stuck, and the others free."""
        stuck = set(stalled)
        for number, axis in enumerate(self._axes):
            axis.stall(number in stuck, now_s)


def _able_to_brake(at_um: float, v: float, acceleration: float) -> tuple[float, float, float]:
    """Return position, velocity and an acceleration that brakes before the end of the travel."""
    room_um = TRAVEL_UM - at_um if v > 0 else at_um
    if v and room_um <= 0:
        return at_um, 0.0, acceleration
    return at_um, v, max(acceleration, v * v / (2 * room_um) if v else 0.0)
