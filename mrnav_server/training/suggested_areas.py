"""Suggested critical areas of models that nobody chose any for."""

import numpy as np

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.vessels import AREA_CLEARANCE_PX


def suggest_areas(vessel: VesselMap, points_px: FloatArray, count: int = 3) -> tuple[VesselPoint, ...]:
    """Choose among points those that lie farthest apart, where the robot has room around it.

    Args:
        vessel: The vessel model.
        points_px: Grid pixels (x, y) to choose from, shape (n, 2).
        count: How many at most.

    Returns:
        Points of the free space with at least 250 µm between the robot and the wall.
    """
    x, y = np.rint(points_px).astype(np.int64).T
    roomy = vessel.distance_px[y, x] - vessel.robot_radius_px >= AREA_CLEARANCE_PX
    left = points_px[vessel.free[y, x] & roomy]
    if not len(left):
        return ()
    apart_px = np.hypot(*(left - left.mean(axis=0)).T)
    chosen: list[VesselPoint] = []
    for _ in range(count):
        best = int(apart_px.argmax())
        if chosen and apart_px[best] < 4 * vessel.robot_radius_px:
            break
        away_px = np.hypot(*(left - left[best]).T)
        apart_px = np.minimum(apart_px, away_px) if chosen else away_px
        chosen.append(VesselPoint(float(left[best][0]), float(left[best][1])))
    return tuple(chosen)
