"""Shortest paths for the robot's centre: a visibility graph on a coarse grid over the free space."""

from functools import cached_property
from math import gcd, hypot
from typing import TYPE_CHECKING

import numpy as np

from mrnav_server.core.arrays import BoolArray, FloatArray, IntArray
from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.vessel import VesselMap

if TYPE_CHECKING:
    from scipy.sparse import csr_array

ATTACH_CELLS = 3
"""A point joins the graph through the nodes that it sees within this many cells."""


class DistanceField:
    """How far a target is from everywhere in the free space, along the shortest way.

    Args:
        nodes_px: The graph's nodes, shape (n, 2).
        distances_px: From each to the target, shape (n,).
        cell_px: Grid spacing of the nodes.
    """

    def __init__(self, nodes_px: IntArray, distances_px: FloatArray, cell_px: int) -> None:
        column, row = (nodes_px // cell_px).T
        size = int(max(column.max(), row.max())) + 1
        self._cell_px = cell_px
        self._field_px = np.full((size + 2, size + 2), np.inf)
        self._field_px[row + 1, column + 1] = distances_px

    def at_px(self, x_px: float, y_px: float) -> float:
        """Return the distance from a point, to within a cell; inf where no node is near."""
        top = len(self._field_px) - 2
        i = min(max(int(x_px // self._cell_px) + 1, 1), top)
        j = min(max(int(y_px // self._cell_px) + 1, 1), top)
        here_px = float(self._field_px[j, i])
        return here_px if np.isfinite(here_px) else float(self._field_px[j - 1 : j + 2, i - 1 : i + 2].min())


class GridGraph:
    """Nodes every few pixels of the free space, edges between near nodes that see each other.

    An edge costs its length times ``1 + clearance_weight · max(0, 1 − c/clearance_px)²``, averaged over its
    two nodes, where c is the gap between the robot's rim and the wall.

    Args:
        vessel: The vessel model.
        cell_px: Grid spacing in vessel pixels.
        reach: Edges span at most this many cells in x and y; a larger reach gives more directions and so
            shorter paths (2.7 % too long at worst with reach 2, 0.6 % with 5).
        clearance_weight: How dear it is to touch the wall; 0 counts length alone.
        clearance_px: Gap beyond which clearance is worth nothing more, in vessel pixels.

    Attributes:
        nodes_px: The nodes' pixels (x, y), shape (n, 2).

    Raises:
        ConfigError: If no node fits into the free space.
    """

    def __init__(
        self,
        vessel: VesselMap,
        cell_px: int = 4,
        reach: int = 2,
        clearance_weight: float = 0.0,
        clearance_px: float = 30.0,
    ) -> None:
        if cell_px < 1 or reach < 1 or clearance_weight < 0.0 or clearance_px <= 0.0:
            raise ConfigError(
                "grid graph: cell_px and reach must be at least 1, clearance_weight at least 0 and"
                f" clearance_px above 0, not {cell_px}, {reach}, {clearance_weight}, {clearance_px}"
            )
        self._free = vessel.free
        self._cell_px = cell_px
        self._reach = reach
        self._weight = clearance_weight
        rows, columns = np.nonzero(vessel.free[cell_px // 2 :: cell_px, cell_px // 2 :: cell_px])
        if rows.size == 0:
            raise ConfigError(
                f"vessel model {vessel.name}: no grid node fits at {cell_px} px; use a finer grid"
            )
        self.nodes_px: IntArray = np.stack([columns, rows], axis=1) * cell_px + cell_px // 2
        gap_px = vessel.distance_px[self.nodes_px[:, 1], self.nodes_px[:, 0]] - vessel.robot_radius_px
        self._cost = (
            1.0 + clearance_weight * np.clip(1.0 - gap_px / clearance_px, 0.0, 1.0).astype(float) ** 2
        )

    @cached_property
    def matrix(self) -> "csr_array[np.float64, tuple[int, int]]":
        """Edge costs as a symmetric sparse matrix over the nodes, in cost-weighted pixels, shape (n, n)."""
        from scipy.sparse import csr_array

        size = self._free.shape[0] // self._cell_px + 1
        index = np.full((size + 2 * self._reach, size + 2 * self._reach), -1, dtype=np.int64)
        column, row = (self.nodes_px // self._cell_px + self._reach).T
        index[row, column] = np.arange(len(self.nodes_px))
        tails, heads, costs = [], [], []
        for dx, dy in _half_directions(self._reach):
            tail = np.arange(len(self.nodes_px))
            head = index[row + dy, column + dx]
            tail, head = tail[head >= 0], head[head >= 0]
            seen = self._see_each_other(self.nodes_px[tail], self.nodes_px[head])
            tail, head = tail[seen], head[seen]
            tails.append(tail)
            heads.append(head)
            costs.append(hypot(dx, dy) * self._cell_px * 0.5 * (self._cost[tail] + self._cost[head]))
        tail, head, cost = np.concatenate(tails), np.concatenate(heads), np.concatenate(costs)
        both = (np.concatenate([tail, head]), np.concatenate([head, tail]))
        shape = (len(self.nodes_px), len(self.nodes_px))
        return csr_array((np.concatenate([cost, cost]), both), shape=shape)

    def nearest(self, x_px: float, y_px: float) -> int:
        """Return the node nearest to a pixel (as the crow flies)."""
        return int(np.argmin((self.nodes_px[:, 0] - x_px) ** 2 + (self.nodes_px[:, 1] - y_px) ** 2))

    def distances_px(self, target: VesselPoint) -> FloatArray:
        """Return the cost of the shortest path from every node to a target.

        Args:
            target: Any point; outside the free space it counts from its nearest node.

        Returns:
            Shape (n,), in cost-weighted pixels (plain pixels at clearance_weight 0); inf if cut off.
        """
        return self._search(target)[0]

    def field(self, target: VesselPoint) -> DistanceField:
        """Return how far the target is from everywhere; see `distances_px`."""
        return DistanceField(self.nodes_px, self.distances_px(target), self._cell_px)

    def path(self, start: VesselPoint, end: VesselPoint) -> FloatArray:
        """Return the shortest path between two points.

        Returns:
            Points from start to end, both included, shape (n, 2), n >= 2, in vessel pixels.

        Raises:
            RefusedError: ``no_path`` if the two are not connected.
        """
        ends_px = np.array([[start.x_px, start.y_px], [end.x_px, end.y_px]])
        if self._weight == 0.0 and self._see_each_other(ends_px[:1], ends_px[1:])[0]:
            return ends_px
        cost_px, towards_end = self._search(end)
        nodes, join_px = self._attach(start)
        total_px = cost_px[nodes] + join_px
        if not np.isfinite(total_px.min()):
            raise RefusedError("no_path", "no path leads there: choose a place in the same connected vessel")
        chain = [int(nodes[np.argmin(total_px)])]
        while (onward := int(towards_end[chain[-1]])) != len(self.nodes_px):
            chain.append(onward)
        return np.concatenate([ends_px[:1], self.nodes_px[chain], ends_px[1:]])

    def _search(self, target: VesselPoint) -> tuple[FloatArray, IntArray]:
        """Return cost and onward node towards the target; the target itself is number n."""
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import dijkstra

        nodes, join_px = self._attach(target)
        n, edges = len(self.nodes_px), self.matrix
        with_target = csr_array(
            (
                np.concatenate([edges.data, join_px]),
                np.concatenate([edges.indices, nodes]),
                np.append(edges.indptr, edges.nnz + len(nodes)),
            ),
            shape=(n + 1, n + 1),
        )
        cost_px, onward = dijkstra(with_target, directed=True, indices=[n], return_predecessors=True)
        return cost_px[0, :n], onward[0].astype(np.int64)

    def _attach(self, point: VesselPoint) -> tuple[IntArray, FloatArray]:
        """Return the nodes through which a point joins the graph, and what each join costs."""
        here_px = np.array([point.x_px, point.y_px])
        away_px = np.hypot(*(self.nodes_px - here_px).T)
        near = np.flatnonzero(away_px <= ATTACH_CELLS * self._cell_px)
        near = near[self._see_each_other(np.broadcast_to(here_px, (len(near), 2)), self.nodes_px[near])]
        if near.size == 0:
            near = np.array([np.argmin(away_px)])
        # csgraph reads a zero as "no edge".
        return near, np.maximum(away_px[near] * self._cost[near], 1e-9)

    def _see_each_other(self, start_px: FloatArray | IntArray, end_px: FloatArray | IntArray) -> BoolArray:
        """Tell per pair whether the straight line between them stays in the free space; shape (m,)."""
        if len(start_px) == 0:
            return np.zeros(0, dtype=bool)
        steps = int(np.ceil(np.abs(end_px - start_px).max())) + 1
        seen = np.ones(len(start_px), dtype=bool)
        top = self._free.shape[0] - 1
        for share in np.linspace(0.0, 1.0, steps + 1):
            at = np.rint(start_px + share * (end_px - start_px)).astype(np.int64)
            np.clip(at, 0, top, out=at)
            seen &= self._free[at[:, 1], at[:, 0]]
        return seen


def _half_directions(reach: int) -> list[tuple[int, int]]:
    """Return each direction once (not its opposite): coprime cell offsets within reach."""
    span = range(-reach, reach + 1)
    return [(dx, dy) for dy in span for dx in span if gcd(dx, dy) == 1 and (dy > 0 or (dy == 0 and dx > 0))]
