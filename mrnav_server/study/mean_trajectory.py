"""The average of several paths: by arc length, its spread perpendicular to it (docs/report.md).

Paths of the same shape at other speeds differ in time and not in space, so time plays no part. Whoever drove
several times is averaged first.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mrnav_server.core.arrays import FloatArray

POINTS = 201


@dataclass(frozen=True)
class MeanTrajectory:
    """An average path and its spread.

    Attributes:
        xy_um: The mean path, shape (n, 2), evenly over the share of the way done.
        normal: Unit vectors perpendicular to it, shape (n, 2).
        sd_um: Standard deviation between operators along ``normal``, shape (n,); NaN for a single operator.
        each_um: Each operator's own mean, shape (operators, n, 2).
        paths: How many paths they drove.
    """

    xy_um: FloatArray
    normal: FloatArray
    sd_um: FloatArray
    each_um: FloatArray
    paths: int

    @property
    def operators(self) -> int:
        """How many it is the mean of."""
        return len(self.each_um)

    def band_um(self) -> tuple[FloatArray, FloatArray]:
        """Return the two edges of mean ± one standard deviation, shape (n, 2) each."""
        aside = self.normal * self.sd_um[:, None]
        return self.xy_um + aside, self.xy_um - aside


def mean_trajectory(paths_um: Mapping[str, Sequence[FloatArray]], points: int = POINTS) -> MeanTrajectory:
    """Average paths.

    Args:
        paths_um: The paths of each operator, shape (m, 2) each, in the order driven; at least one in all.
        points: How many points the mean has, at least 3.

    Raises:
        ValueError: If there is no path.
    """
    driven = {who: paths for who, paths in paths_um.items() if len(paths)}
    if not driven:
        raise ValueError("a mean needs at least one path")
    each = np.array(
        [np.mean([by_arc_length(path, points) for path in paths], axis=0) for paths in driven.values()]
    )
    mean_um = each.mean(axis=0)
    normal = _normals(mean_um)
    aside_um = np.einsum("onk,nk->on", each - mean_um, normal)
    sd_um = aside_um.std(axis=0, ddof=1) if len(each) > 1 else np.full(points, np.nan)
    return MeanTrajectory(mean_um, normal, sd_um, each, sum(map(len, driven.values())))


def by_arc_length(xy_um: FloatArray, points: int) -> FloatArray:
    """Return a path at evenly spaced shares of its length, shape (points, 2).

    Args:
        xy_um: Shape (m, 2), m >= 1, finite.
        points: How many, at least 2.
    """
    steps_um = np.hypot(*np.diff(xy_um, axis=0).T)
    along_um = np.concatenate([[0.0], np.cumsum(steps_um)])
    wanted_um = np.linspace(0.0, along_um[-1], points)
    return np.stack([np.interp(wanted_um, along_um, axis) for axis in xy_um.T], axis=1)


def _normals(xy_um: FloatArray) -> FloatArray:
    tangent = np.gradient(xy_um, axis=0, edge_order=2)
    length = np.maximum(np.hypot(*tangent.T), 1e-9)[:, None]
    normal: FloatArray = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / length
    return normal
