"""The policy's motion after a hand-over: on along its way, and fading out."""

import math
from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise

from mrnav_server.core.frames import StagePoint

Vector3 = tuple[float, float, float]


class Coast:
    """A way with a beginning, straight on after its end.

    Args:
        position: Where it begins.
        velocity_um_per_s: There; without a way it goes straight on in this direction.
        way_um: Steps from the beginning on, stage x and y.
    """

    def __init__(
        self,
        position: StagePoint,
        velocity_um_per_s: Vector3,
        way_um: Sequence[tuple[float, float]] = (),
    ) -> None:
        self.speed_um_per_s = math.hypot(*velocity_um_per_s)
        ahead = [(x, y, 0.0) for x, y in way_um] or [velocity_um_per_s]
        self._points: list[Vector3] = [(position.x_um, position.y_um, position.z_um)]
        self._along_um = [0.0]
        self._directions: list[Vector3] = []
        for step in ahead:
            length_um = math.hypot(*step)
            if length_um < 1e-9:
                continue
            x, y, z = self._points[-1]
            self._points.append((x + step[0], y + step[1], z + step[2]))
            self._along_um.append(self._along_um[-1] + length_um)
            self._directions.append((step[0] / length_um, step[1] / length_um, step[2] / length_um))

    def at(self, along_um: float) -> tuple[StagePoint, Vector3]:
        """Return the place so far along, and the direction there, a unit vector."""
        if not self._directions:
            return StagePoint(*self._points[0]), (0.0, 0.0, 0.0)
        leg = min(max(bisect_right(self._along_um, along_um) - 1, 0), len(self._directions) - 1)
        beyond_um = along_um - self._along_um[leg]
        (x, y, z), (dx, dy, dz) = self._points[leg], self._directions[leg]
        return StagePoint(x + beyond_um * dx, y + beyond_um * dy, z + beyond_um * dz), (dx, dy, dz)


def steps(points_um: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the steps from point to point."""
    return [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(points_um)]
