"""What a simulated operator knows of the vessel: the picture of it, and so the middle of every way."""

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from mrnav_server.autonomy.path import PathConfig, PathPlanner
from mrnav_server.client.rest import Rest
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.sim.operator_route import Route
from mrnav_server.vision.vessel_model import vessel_map

MIDDLE = PathConfig(
    wanted_clearance_um=600.0,
    end_nudge_um=0.0,
    coast_um=0.0,
    geodesic_clearance_weight=8.0,
    geodesic_clearance_um=600.0,
)
"""A person keeps to the middle, and does not cut corners as the autonomy does."""


class Chart:
    """Ways along the middle of a running server's vessel.

    Args:
        rest: Asked once, for the vessel's picture.
        snapshot: The twin's first message.

    Raises:
        RestError: If the server does not answer.
    """

    def __init__(self, rest: Rest, snapshot: dict[str, Any]) -> None:
        vessel = snapshot["vessel"]
        picture = np.frombuffer(rest.get_bytes("/api/v1/vessel.png"), dtype=np.uint8)
        mask = np.asarray(cv2.imdecode(picture, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
        self._vessel = vessel_map(vessel["name"], mask, vessel["um_per_px"], vessel["robot_radius_um"])
        self._planner = PathPlanner(self._vessel, MIDDLE)
        (a, b, tx), (c, d, ty) = snapshot["calibration"]["stage_from_vessel"]
        self._turn = np.array([[a, c], [b, d]])
        self._shift_um = np.array([tx, ty])

    def route(self, robot_px: Sequence[float], target: dict[str, float]) -> Route | None:
        """Return the way from the robot to a target, both in the vessel's grid; None if there is none."""
        end = VesselPoint(target["x_px"], target["y_px"])
        try:
            points_px = self._planner.plan(VesselPoint(robot_px[0], robot_px[1]), end).points_px
        except RefusedError:
            return None
        if math.dist(points_px[-1], (end.x_px, end.y_px)) > 0.1:
            points_px = np.concatenate([points_px, [[end.x_px, end.y_px]]])
        clearance_um = [self._vessel.clearance_um(VesselPoint(float(x), float(y))) for x, y in points_px]
        return Route(points_px @ self._turn + self._shift_um, np.array(clearance_um))
