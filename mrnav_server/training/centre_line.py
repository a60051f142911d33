"""The centre line of a vessel model: its branches, junctions, widths and length."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from mrnav_server.core.arrays import BoolArray, FloatArray, IntArray
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.skeleton_graph import SkeletonGraph

_SPECK_PX = 100
"""Holes of fewer pixels (0.01 mm²) are specks."""
_SMOOTH_PX = 8.0
"""A chain of pixels is up to 8 % longer than the line it stands for; smoothed over this it is not."""


@dataclass(frozen=True, slots=True)
class Branch:
    """A vessel between two junctions or ends.

    Attributes:
        path_px: The centre line's grid pixels (x, y) in order, shape (n, 2); at an end of the vessel it goes
            on to the end wall.
        width_px: Width of the lumen at each of them, shape (n,); up to the end wall, that before the end.
        length_px: Length of the centre line.
    """

    path_px: IntArray
    width_px: FloatArray
    length_px: float


@dataclass(frozen=True, slots=True)
class CentreLine:
    """The centre line of a lumen.

    Attributes:
        branches: The vessels between junctions and ends.
        junctions_px: Where at least three branches meet (x, y), shape (n, 2).
        ends: How many branches end without a junction.
    """

    branches: tuple[Branch, ...]
    junctions_px: FloatArray
    ends: int

    @property
    def length_px(self) -> float:
        """Length of all branches."""
        return sum(branch.length_px for branch in self.branches)


def centre_line(vessel: VesselMap) -> CentreLine:
    """Thin the lumen to its centre line.

    Side branches that are shorter than they are wide do not count, and two junctions whose inscribed discs
    hold each other's centre are one.
    """
    # It lacks annotations; the picture's edge is a wall here as everywhere.
    thin: Callable[[BoolArray], BoolArray] = importlib.import_module("skimage.morphology").skeletonize
    solid = _without_specks(vessel.lumen)
    graph = SkeletonGraph(thin(np.pad(solid, 1))[1:-1, 1:-1], vessel.distance_px)
    degree = graph.degrees()
    branches = [
        _branch(edge.path_px, vessel, open_tail=degree[edge.tail] == 1, open_head=degree[edge.head] == 1)
        for edge in graph.edges
    ]
    junctions = [graph.nodes_px[node] for node, count in degree.items() if count >= 3]
    return CentreLine(
        tuple(branches),
        np.array(junctions, dtype=np.float64).reshape(-1, 2),
        sum(count == 1 for count in degree.values()),
    )


def _without_specks(lumen: BoolArray) -> BoolArray:
    """Fill the specks around which a centre line would otherwise wind."""
    gaps = (~lumen).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(gaps, connectivity=4)
    return np.asarray(lumen | (stats[labels, cv2.CC_STAT_AREA] < _SPECK_PX))


def _branch(line_px: FloatArray, vessel: VesselMap, *, open_tail: bool, open_head: bool) -> Branch:
    path = np.rint(line_px).astype(np.int64)
    before = _to_wall(line_px[::-1], vessel.lumen)[::-1] if open_tail else path[:0]
    after = _to_wall(line_px, vessel.lumen) if open_head else path[:0]
    width_px = 2.0 * vessel.distance_px[path[:, 1], path[:, 0]].astype(np.float64)
    line = np.vstack([before[:1], _smoothed(line_px), after[-1:]])
    return Branch(
        np.vstack([before, path, after]),
        np.pad(width_px, (len(before), len(after)), mode="edge"),
        float(np.hypot(*np.diff(line, axis=0).T).sum()),
    )


def _smoothed(path_px: FloatArray) -> FloatArray:
    """Smooth a line between its ends, which stay."""
    from scipy.ndimage import gaussian_filter1d

    smooth = np.asarray(gaussian_filter1d(path_px, _SMOOTH_PX, axis=0, mode="nearest"))
    smooth[0], smooth[-1] = path_px[0], path_px[-1]
    return smooth


def _to_wall(path_px: FloatArray, lumen: BoolArray) -> IntArray:
    """Return the pixels from a branch's last point straight on to the wall, shape (n, 2)."""
    back = path_px[max(len(path_px) - 41, 0) : max(len(path_px) - 10, 1)].mean(axis=0)
    way = path_px[-1] - back
    if not way.any():
        return np.zeros((0, 2), dtype=np.int64)
    steps = np.arange(1, lumen.shape[0])[:, None]
    points = np.rint(path_px[-1] + steps * way / np.hypot(*way)).astype(np.int64)
    points = points[((points >= 0) & (points < lumen.shape[0])).all(axis=1)]
    outside = ~lumen[points[:, 1], points[:, 0]]
    return np.asarray(points[: int(outside.argmax())] if outside.any() else points)
