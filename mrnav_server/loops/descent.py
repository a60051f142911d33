"""Brings a magnet that hangs too high to draw the robot down over it, before autonomy drives."""

import math
from dataclasses import dataclass

from mrnav_server.core.frames import Calibration, StagePoint, VesselPoint
from mrnav_server.core.shaping import Reference

_ASIDE_UM = 300.0
"""Further than this from above the robot the magnet keeps its height: on its way down it would draw it."""
_THERE_UM = 30.0


@dataclass(frozen=True, slots=True)
class HeightConfig:
    """At which height autonomy drives.

    Attributes:
        working: Share of the critical height to which a magnet that hangs too high is lowered (1.02-1.2).
        highest: Share of the critical height above which it hangs too high (1.02-2).
        speed_um_per_s: Speed of the way down (100-4500).
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    working: float = 1.04
    highest: float = 1.06
    speed_um_per_s: float = 2000.0

    def __post_init__(self) -> None:
        for name, least, most in (
            ("working", 1.02, 1.2),
            ("highest", self.working, 2.0),
            ("speed_um_per_s", 100.0, 4500.0),
        ):
            if not least <= getattr(self, name) <= most:
                raise ValueError(f"{name} must lie between {least:g} and {most:g}")


class Descent:
    """One way down at a time: first over the robot, then down.

    Args:
        config: The heights.
        calibration: Where the magnet holds the robot, and its critical height.
    """

    def __init__(self, config: HeightConfig, calibration: Calibration) -> None:
        self._config = config
        self._calibration = calibration
        self._under_way = False

    def recalibrate(self, calibration: Calibration) -> None:
        """Go by another calibration."""
        self._calibration = calibration

    def begin(self) -> None:
        """Forget the last way down: autonomy begins."""
        self._under_way = False

    def reference(self, robot: VesselPoint | None, tip: StagePoint, setpoint: StagePoint) -> Reference | None:
        """Return where the tip goes before autonomy drives; None once it may.

        Args:
            robot: Where the robot is; None while nobody knows.
            tip: Where the tip is.
            setpoint: Where it is asked to be, and rests for the moment if the robot is not seen.
        """
        config, calibration = self._config, self._calibration
        if (
            not self._under_way
            and calibration.height_um(tip) <= config.highest * calibration.critical_height_um
        ):
            return None
        self._under_way = True
        if robot is None:
            return Reference(setpoint, (0.0, 0.0, 0.0), config.speed_um_per_s)
        x_um, y_um = calibration.stage_xy_um(robot)
        x_um, y_um = x_um + calibration.magnet_offset_um[0], y_um + calibration.magnet_offset_um[1]
        z_um = calibration.floor_z_um + config.working * calibration.critical_height_um
        if abs(tip.z_um - z_um) <= _THERE_UM:
            self._under_way = False
            return None
        if math.hypot(tip.x_um - x_um, tip.y_um - y_um) > _ASIDE_UM:
            z_um = setpoint.z_um
        return Reference(StagePoint(x_um, y_um, z_um), (0.0, 0.0, 0.0), config.speed_um_per_s)
