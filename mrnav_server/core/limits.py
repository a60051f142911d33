"""What no command may exceed: finite, inside the workspace, above the critical height, near the vessel."""

import math
from dataclasses import dataclass

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import Calibration, StagePoint
from mrnav_server.core.vessel import VesselMap

_DESCENTS = 12
"""Steps down the distance to the vessel; one is enough unless the point lies between two branches."""


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
    within = _in_workspace(require_finite(target), limits)
    x_um, y_um = _near_vessel(within, limits, calibration, vessel)
    z_um = max(within.z_um, calibration.floor_z_um + calibration.critical_height_um + limits.height_margin_um)
    return _in_workspace(StagePoint(x_um, y_um, z_um), limits)


def outside_um(point: StagePoint, limits: Limits, calibration: Calibration, vessel: VesselMap) -> float:
    """Return how far a point is from where the tip may be; 0 where it may be.

    Raises:
        RefusedError: If the point is not finite.
    """
    near = allowed_target(point, limits, calibration, vessel)
    return math.hypot(near.x_um - point.x_um, near.y_um - point.y_um, near.z_um - point.z_um)


def _in_workspace(point: StagePoint, limits: Limits) -> StagePoint:
    low, high = limits.workspace_min_um, limits.workspace_max_um
    return StagePoint(
        min(max(point.x_um, low[0]), high[0]),
        min(max(point.y_um, low[1]), high[1]),
        min(max(point.z_um, low[2]), high[2]),
    )


def _near_vessel(
    target: StagePoint, limits: Limits, calibration: Calibration, vessel: VesselMap
) -> tuple[float, float]:
    held = calibration.held_point(target)
    x_px, y_px = held.x_px, held.y_px
    lead_px, top_px = limits.lead_um / vessel.um_per_px, float(vessel.size_px - 1)
    last_px = math.inf
    for _ in range(_DESCENTS):
        # Beyond the grid the way back to it counts on top.
        edge_x_px, edge_y_px = min(max(x_px, 0.0), top_px), min(max(y_px, 0.0), top_px)
        beyond_px = math.hypot(x_px - edge_x_px, y_px - edge_y_px)
        outside_px = beyond_px - vessel.wall_distance_px(edge_x_px, edge_y_px) - lead_px
        if outside_px <= 0.0:
            break
        if beyond_px > 0.0:
            share = min(1.0, outside_px / beyond_px)
            x_px, y_px = x_px + share * (edge_x_px - x_px), y_px + share * (edge_y_px - y_px)
            continue
        gx, gy = vessel.wall_gradient(x_px, y_px)
        if outside_px < max(0.9 * last_px, 1.0) and (gx or gy):
            step_px = last_px = outside_px
        else:
            # Midway between two walls, where either side will do: a small step aside decides.
            gx, gy = (-gy, gx) if gx or gy else (0.8, 0.6)
            step_px, last_px = 2.0, math.inf
        x_px, y_px = x_px + gx * step_px, y_px + gy * step_px
    dx_px, dy_px = x_px - held.x_px, y_px - held.y_px
    to_um = calibration.stage_from_vessel
    return (
        target.x_um + to_um.a * dx_px + to_um.b * dy_px,
        target.y_um + to_um.c * dx_px + to_um.d * dy_px,
    )
