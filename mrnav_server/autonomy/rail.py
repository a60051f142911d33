"""A planned path laid out for quick look-ups at the control rate, in the vessel's plane in µm."""

import numpy as np

from mrnav_server.autonomy.path import PlannedPath
from mrnav_server.autonomy.profile import SpeedConfig, speed_limits_um_per_s
from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.vessel import VesselMap

_BEHIND, _AHEAD = 30, 60
"""The robot is looked for among this many points around its last place."""
_BEND = 10
"""Curvature is taken over this many points on either side."""


class Rail:
    """Points, tangents and speed limits by arc length (plain floats: numpy is slow on single numbers).

    Args:
        path: The planned path.
        vessel: The vessel model.
        lead_um: The magnet's friction lead.
        speed: Bounds on the speed.
        handover_um: So far from its end the operator takes over.
    """

    def __init__(
        self,
        path: PlannedPath,
        vessel: VesselMap,
        lead_um: float,
        speed: SpeedConfig,
        handover_um: float = 0.0,
    ) -> None:
        points_um = path.points_px * vessel.um_per_px
        clearance_um = _clearance_um(path, vessel)
        limits = speed_limits_um_per_s(points_um, path.tangents, clearance_um, lead_um, speed, handover_um)
        self.spacing_um = max(path.spacing_px * vessel.um_per_px, 1e-6)
        self.last = len(points_um) - 1
        self.length_um = self.last * self.spacing_um
        seconds = self.spacing_um / (0.5 * (limits[1:] + limits[:-1]))
        self._x_um: list[float] = points_um[:, 0].tolist()
        self._y_um: list[float] = points_um[:, 1].tolist()
        self._tx: list[float] = path.tangents[:, 0].tolist()
        self._ty: list[float] = path.tangents[:, 1].tolist()
        self._limit: list[float] = limits.tolist()
        self._to_go_s: list[float] = np.append(np.cumsum(seconds[::-1])[::-1], 0.0).tolist()
        self._area_s = self.time_to_go_s(self.length_um - handover_um)

    def point_um(self, arc_um: float) -> tuple[float, float]:
        """Return the path at an arc length, linear between points."""
        i = self.index(arc_um)
        j = min(i + 1, self.last)
        share = min(arc_um / self.spacing_um - i, 1.0)
        x_um, y_um = self._x_um, self._y_um
        return x_um[i] + share * (x_um[j] - x_um[i]), y_um[i] + share * (y_um[j] - y_um[i])

    def tangent(self, index: int) -> tuple[float, float]:
        """Return the unit tangent at a point."""
        return self._tx[index], self._ty[index]

    def bend_per_um(self, index: int) -> tuple[float, float]:
        """Return the tangent's change along the path around a point."""
        i, j = max(index - _BEND, 0), min(index + _BEND, self.last)
        span_um = (j - i) * self.spacing_um
        return (self._tx[j] - self._tx[i]) / span_um, (self._ty[j] - self._ty[i]) / span_um

    def limit_um_per_s(self, arc_um: float) -> float:
        """Return the speed limit at an arc length."""
        return self._limit[self.index(arc_um)]

    def time_to_go_s(self, arc_um: float) -> float:
        """Return the time from an arc length to the end at the speed limit."""
        return self._to_go_s[self.index(arc_um)]

    def time_to_handover_s(self, arc_um: float) -> float:
        """Return the time from an arc length to where the operator takes over; 0 from there on."""
        return max(self.time_to_go_s(arc_um) - self._area_s, 0.0)

    def index(self, arc_um: float) -> int:
        """Return the point at or before an arc length."""
        return min(max(int(arc_um / self.spacing_um), 0), self.last)

    def nearest(self, position_um: tuple[float, float], around: int) -> tuple[int, float]:
        """Return the nearest point among those around an index, and the distance to it in µm."""
        x_um, y_um = position_um
        best, best_um2 = around, float("inf")
        for i in range(max(around - _BEHIND, 0), min(around + _AHEAD, self.last) + 1):
            dx, dy = self._x_um[i] - x_um, self._y_um[i] - y_um
            away_um2 = dx * dx + dy * dy
            if away_um2 < best_um2:
                best, best_um2 = i, away_um2
        return best, float(best_um2**0.5)

    def cross_track_um(self, position_um: tuple[float, float], index: int) -> float:
        """Return the signed distance to the tangent at a point, positive along its normal (-ty, tx)."""
        dx, dy = position_um[0] - self._x_um[index], position_um[1] - self._y_um[index]
        return -dx * self._ty[index] + dy * self._tx[index]


def _clearance_um(path: PlannedPath, vessel: VesselMap) -> FloatArray:
    """Return the gap between rim and wall at the path's points, shape (n,)."""
    nearest = np.clip(np.rint(path.points_px).astype(np.int64), 0, vessel.size_px - 1)
    wall_px = vessel.distance_px[nearest[:, 1], nearest[:, 0]].astype(np.float64)
    return (wall_px - vessel.robot_radius_px) * vessel.um_per_px
