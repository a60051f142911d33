"""Requests for motion as an emulated manipulator reads them: numbers on the wire → goals of the axes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mrnav_server.devices.sensapex.emulated_motion import Goal
from mrnav_server.devices.sensapex.smcp1 import UNDEFINED, Message

_ALL_AXES = 0x0F


@dataclass(frozen=True, slots=True)
class Goals:
    """What a request wants.

    Attributes:
        of_axes: Goals by the axes' numbers from 0; an axis without one is left alone.
        together: All at once, or one axis after another.
    """

    of_axes: Mapping[int, Goal]
    together: bool


@dataclass(frozen=True, slots=True)
class Limits:
    """What the device can do.

    Attributes:
        axes: How many axes it has.
        usual_um_per_s: Speed where none is asked for.
        fastest_um_per_s: Highest speed.
        acceleration_um_per_s2: Highest acceleration.
    """

    axes: int
    usual_um_per_s: float
    fastest_um_per_s: float
    acceleration_um_per_s2: float

    def goal(self, target_um: float, speed: int, acceleration_um_per_s2: int) -> Goal:
        """Return a goal within the limits.

        Args:
            target_um: Where to.
            speed: µm/s, or nm/s if negative; 0 or UNDEFINED is the usual speed.
            acceleration_um_per_s2: 0 or UNDEFINED is the highest.
        """
        speed_um_per_s = float(speed) if speed > 0 else -speed / 1000
        if speed in (0, UNDEFINED):
            speed_um_per_s = self.usual_um_per_s
        asked = acceleration_um_per_s2 if acceleration_um_per_s2 > 0 else self.acceleration_um_per_s2
        return Goal(
            target_um,
            min(speed_um_per_s, self.fastest_um_per_s),
            min(float(asked), self.acceleration_um_per_s2),
        )


def goto_goals(message: Message, limits: Limits, shift_um: float) -> Goals:
    """Return the goals of a goto: positions, common speed, mode, acceleration; then own speeds.

    Args:
        message: The request.
        limits: What the device can do.
        shift_um: From positions as the device counts them to true ones.

    Raises:
        ValueError: If it names no position.
    """
    values = message.values
    if not values:
        raise ValueError("a goto names a position")
    common, mode, acceleration = _filled(values[4:7], 3)
    own = message.blocks[1].values if len(message.blocks) > 1 else ()
    goals = {
        axis: limits.goal(
            at_nm / 1000 + shift_um, own[axis] if any(own[axis : axis + 1]) else common, acceleration
        )
        for axis, at_nm in enumerate(values[: min(limits.axes, 4)])
        if at_nm != UNDEFINED
    }
    return Goals(goals, bool(mode))


def memory_goals(message: Message, limits: Limits, stored_um: Sequence[float]) -> Goals:
    """Return the goals of a goto to a stored position: slot, speed, mode, acceleration."""
    _, speed, mode, acceleration = _filled(message.values, 4)
    return Goals(
        {axis: limits.goal(at_um, speed, acceleration) for axis, at_um in enumerate(stored_um)}, bool(mode)
    )


def step_goals(message: Message, limits: Limits, at_um: Sequence[float]) -> Goals:
    """Return the goals of a step from where the axes are: four distances, four speeds, mode, acceleration.

    Raises:
        ValueError: If distances or speeds are missing.
    """
    values = message.values
    if len(values) < 8:
        raise ValueError("a step names four distances and four speeds")
    goals = {
        axis: limits.goal(at_um[axis] + values[axis] / 1000, values[4 + axis], _filled(values, 10)[9])
        for axis in range(limits.axes)
        if values[axis] not in (0, UNDEFINED)
    }
    return Goals(goals, True)


def zero_goals(message: Message, limits: Limits) -> Goals:
    """Return the goals of a drive to zero: a mask of axes, 0 or nothing for all."""
    chosen = _filled(message.values, 1)[0] or _ALL_AXES
    return Goals({axis: limits.goal(0.0, 0, 0) for axis in range(limits.axes) if chosen & 1 << axis}, True)


def _filled(values: Sequence[int], count: int) -> tuple[int, ...]:
    return (*values, *(0,) * count)[:count]
