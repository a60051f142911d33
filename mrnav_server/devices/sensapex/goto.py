"""From a target in µm to what a uMp is told: checked, rounded once, with a speed for each axis."""

import math
from dataclasses import dataclass

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.frames import StagePoint
from mrnav_server.devices.sensapex.smcp1 import UNDEFINED, Block

TRAVEL_UM = 20_000.0
"""Travel of each axis of a uMp, from 0; neither the vendor's library nor the controller checks it."""
_SLOWEST_UM_PER_S = 1.0
"""A uMp does not take less."""
_FASTEST_UM_PER_S = 20_000.0
_TOGETHER = 1
_NM_PER_UM = 1000


@dataclass(frozen=True, slots=True)
class Goto:
    """An absolute move of X, Y and Z; W is left alone.

    Attributes:
        positions_nm: Target of each axis.
        speeds_um_per_s: Whole speed of each axis, at least 1.
        speed_um_per_s: Whole speed along the line.
    """

    positions_nm: tuple[int, int, int]
    speeds_um_per_s: tuple[int, int, int]
    speed_um_per_s: int

    @property
    def target(self) -> StagePoint:
        """The target after rounding."""
        x_nm, y_nm, z_nm = self.positions_nm
        return StagePoint(x_nm / _NM_PER_UM, y_nm / _NM_PER_UM, z_nm / _NM_PER_UM)

    @property
    def blocks(self) -> tuple[Block, Block]:
        """The arguments: target, fastest axis for old firmware, mode; then a speed for each axis."""
        fastest = max(self.speeds_um_per_s)
        return Block((*self.positions_nm, UNDEFINED, fastest, _TOGETHER)), Block(self.speeds_um_per_s)


def goto(target: StagePoint, speed_um_per_s: float, start: StagePoint, slack_um: float = 0.0) -> Goto:
    """Plan a move along the straight line from where the tip is.

    Each axis gets the share of the speed that its distance has of the whole, so that all of them arrive
    together. All three axes are always given: what an axis does that a newer move leaves out is not known.

    Args:
        target: Where to, within 0..20000 µm on each axis.
        speed_um_per_s: Along the line, 1..20000.
        start: The newest position.
        slack_um: How far the tip may have moved since; an axis that seems to be there already is not
            slowed down to less than this distance needs.

    Raises:
        DeviceError: If target or speed is not finite or out of range, naming it.
    """
    wished_um = (target.x_um, target.y_um, target.z_um)
    for axis, value_um in zip("xyz", wished_um, strict=True):
        if not math.isfinite(value_um):
            raise DeviceError(f"the manipulator refuses the target {axis} = {value_um} µm: not finite")
        if not 0.0 <= value_um <= TRAVEL_UM:
            raise DeviceError(
                f"the manipulator refuses the target {axis} = {value_um:.1f} µm: its travel is "
                f"0..{TRAVEL_UM:.0f} µm; set limits.workspace_min_um and limits.workspace_max_um within it"
            )
    if not _SLOWEST_UM_PER_S <= speed_um_per_s <= _FASTEST_UM_PER_S:
        raise DeviceError(
            f"the manipulator refuses the speed {speed_um_per_s} µm/s: "
            f"it takes {_SLOWEST_UM_PER_S:.0f}..{_FASTEST_UM_PER_S:.0f}"
        )
    away_um = [
        abs(to_um - from_um)
        for to_um, from_um in zip(wished_um, (start.x_um, start.y_um, start.z_um), strict=True)
    ]
    whole_um = math.hypot(*away_um)
    x, y, z = (
        max(1, round(speed_um_per_s * min(1.0, (part_um + slack_um) / whole_um if whole_um else 1.0)))
        for part_um in away_um
    )
    x_nm, y_nm, z_nm = (round(value_um * _NM_PER_UM) for value_um in wished_um)
    return Goto((x_nm, y_nm, z_nm), (x, y, z), round(speed_um_per_s))
