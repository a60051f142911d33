"""The way that a simulated operator means to steer: a middle line with the room to either side."""

import numpy as np

from mrnav_server.core.arrays import FloatArray

_SPACING_UM = 50.0
_LEAST_CLEARANCE_UM = 20.0


class Route:
    """A polyline on the stage; the last point is the target.

    Args:
        points_um: Stage x, y along the middle, shape (n, 2), n >= 2, no two neighbours alike.
        clearance_um: Room between rim and wall at each, shape (n,).

    Attributes:
        length_um: From the first point to the target.
        target_um: The last point, shape (2,).
    """

    def __init__(self, points_um: FloatArray, clearance_um: FloatArray) -> None:
        along_um = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points_um, axis=0).T))])
        self.length_um = float(along_um[-1])
        self._s_um = np.linspace(0.0, self.length_um, max(2, round(self.length_um / _SPACING_UM) + 1))
        self._points_um = np.stack([np.interp(self._s_um, along_um, axis) for axis in points_um.T], axis=1)
        room_um = np.interp(self._s_um, along_um, clearance_um)
        self._clearance_um = np.maximum(room_um, _LEAST_CLEARANCE_UM)
        slopes = np.gradient(self._points_um, axis=0)
        self._tangents = slopes / np.hypot(*slopes.T)[:, None]
        self.target_um: FloatArray = self._points_um[-1]

    def project(self, point_um: FloatArray, near_um: float | None = None) -> float:
        """Return how far along the nearest place lies, in µm.

        Args:
            point_um: Shape (2,).
            near_um: Look no further than 1.5 mm back and 3 mm ahead of here; None looks everywhere.
        """
        if near_um is None:
            first, last = 0, len(self._s_um)
        else:
            first = int(np.searchsorted(self._s_um, near_um - 1500.0))
            last = int(np.searchsorted(self._s_um, near_um + 3000.0)) + 1
        away = ((self._points_um[first:last] - point_um) ** 2).sum(axis=1)
        return float(self._s_um[first + int(np.argmin(away))])

    def point_um(self, s_um: float) -> FloatArray:
        """Return the point so far along, shape (2,)."""
        point_um: FloatArray = self._points_um[self._index(s_um)]
        return point_um

    def tangent(self, s_um: float) -> FloatArray:
        """Return the direction so far along, a unit vector."""
        tangent: FloatArray = self._tangents[self._index(s_um)]
        return tangent

    def offset_um(self, point_um: FloatArray, s_um: float) -> float:
        """Return how far a point lies to the side of the middle: along (−t_y, t_x) of the tangent t."""
        x, y = point_um - self.point_um(s_um)
        tx, ty = self.tangent(s_um)
        return float(-x * ty + y * tx)

    def clearance_um(self, from_um: float, to_um: float) -> float:
        """Return the least room between two places."""
        return float(self._clearance_um[self._index(from_um) : self._index(to_um) + 1].min())

    def _index(self, s_um: float) -> int:
        step_um = self.length_um / (len(self._s_um) - 1)
        return min(max(round(s_um / step_um), 0), len(self._s_um) - 1)
