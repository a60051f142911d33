"""What no command may exceed: finite, inside the workspace, above the critical height, near the vessel."""

import math
from dataclasses import dataclass

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import Calibration, StagePoint
from mrnav_server.core.vessel import VesselMap


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds on the commanded motion of the tip.

    Attributes:
        speed_um_per_s: Largest speed in MANUAL.
        autonomy_speed_um_per_s: Largest speed in AUTO.
        acceleration_um_per_s2: Largest acceleration (length of the vector).
        jerk_um_per_s3: Largest jerk (length of the vector).
        workspace_min_um: Lower corner of the manipulator's travel, stage x, y, z.
        workspace_max_um: Upper corner of the manipulator's travel, stage x, y, z.
        height_margin_um: How far above the critical height the magnet stays.
        lead_um: How far the magnet's hold point may leave the vessel.
        ahead_s: A setpoint is never further ahead of the tip than the tip can travel in this time.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    speed_um_per_s: float = 3000.0
    autonomy_speed_um_per_s: float = 4500.0
    acceleration_um_per_s2: float = 30_000.0
    jerk_um_per_s3: float = 600_000.0
    workspace_min_um: tuple[float, float, float] = (0.0, 0.0, 0.0)
    workspace_max_um: tuple[float, float, float] = (20_000.0, 20_000.0, 20_000.0)
    height_margin_um: float = 150.0
    lead_um: float = 1600.0
    ahead_s: float = 0.1


def require_finite(point: StagePoint) -> StagePoint:
    """Return the point unchanged.

    Clamping comes after this: ``max(lo, min(hi, nan))`` is ``hi``, a full-speed move.

    Raises:
        RefusedError: If a coordinate is NaN or infinite.
    """
    if not (math.isfinite(point.x_um) and math.isfinite(point.y_um) and math.isfinite(point.z_um)):
        raise RefusedError("non_finite", "a target with NaN or infinity moves nothing")
    return point


def allowed_target(
    target: StagePoint, limits: Limits, calibration: Calibration, vessel: VesselMap
) -> StagePoint:
    """Return the allowed target nearest to a wish.

    The magnet's hold point stays within ``lead_um`` of the lumen, the magnet above the critical height
    plus its margin, and everything inside the manipulator's travel, which is applied last.

    Raises:
        RefusedError: If the wish is not finite.
    """
    x_um, y_um = _near_vessel(require_finite(target), limits, calibration, vessel)
    z_um = max(target.z_um, calibration.floor_z_um + calibration.critical_height_um + limits.height_margin_um)
    low, high = limits.workspace_min_um, limits.workspace_max_um
    return StagePoint(
        min(max(x_um, low[0]), high[0]),
        min(max(y_um, low[1]), high[1]),
        min(max(z_um, low[2]), high[2]),
    )


def _near_vessel(
    target: StagePoint, limits: Limits, calibration: Calibration, vessel: VesselMap
) -> tuple[float, float]:
    held = calibration.held_point(target)
    outside_px = -vessel.wall_distance_px(held.x_px, held.y_px) - limits.lead_um / vessel.um_per_px
    if outside_px <= 0:
        return target.x_um, target.y_um
    gx, gy = vessel.wall_gradient(held.x_px, held.y_px)
    to_um = calibration.stage_from_vessel
    dx_um = (to_um.a * gx + to_um.b * gy) * outside_px
    dy_um = (to_um.c * gx + to_um.d * gy) * outside_px
    return target.x_um + dx_um, target.y_um + dy_um
