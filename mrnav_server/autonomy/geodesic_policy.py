"""The planner behind the policy's interface: head for the farthest visible point of the shortest path."""

import numpy as np

from mrnav_server.autonomy.grid_graph import GridGraph
from mrnav_server.autonomy.policy import FORBIDDEN_LOGIT
from mrnav_server.core.arrays import BoolArray, Float32Array, FloatArray, IntArray
from mrnav_server.core.navigation import DIRECTIONS, free_actions
from mrnav_server.core.vessel import VesselMap

LOOK_AHEAD_HOPS = 64
"""Nodes of the shortest path among which the farthest visible one is sought."""
SHARPNESS = 100.0
"""Logit per unit of cosine between an action and the way to go."""


class GeodesicPolicy:
    """Scores actions by how well they point along the string-pulled shortest path.

    It needs no training, and it is the teacher of the learned policies. Shortest-path rows are computed when
    a target first needs them and are kept: quick for one target on the rig, and for all in training.

    Args:
        vessel: The vessel model.
        cell_px: Grid spacing of the path graph in vessel pixels.
        reach: Edges of the path graph span at most this many cells.
    """

    name = "geodesic"
    kind = "geodesic"

    def __init__(self, vessel: VesselMap, cell_px: int = 8, reach: int = 3) -> None:
        from scipy.spatial import cKDTree

        graph = GridGraph(vessel, cell_px=cell_px, reach=reach)
        self._vessel = vessel
        self._edges = graph.matrix
        self._nodes_px: FloatArray = graph.nodes_px.astype(np.float64)
        self._nearest = cKDTree(self._nodes_px)
        count = len(self._nodes_px)
        self._known: BoolArray = np.zeros(count, dtype=bool)
        # Zeros, not full: the system hands out memory only for the rows that are used.
        self._length_px: Float32Array = np.zeros((count, count), dtype=np.float32)
        self._onward = np.zeros((count, count), dtype=np.int32)

    def logits(self, observations: Float32Array) -> Float32Array:
        """Score the actions; see `Policy.logits`."""
        position_px = observations[:, 0:2].astype(np.float64)
        toward = self.waypoints(position_px, observations[:, 4:6].astype(np.float64)) - position_px
        toward /= np.maximum(np.hypot(toward[:, 0], toward[:, 1])[:, None], 1e-6)
        score = SHARPNESS * toward @ DIRECTIONS.T
        free = free_actions(self._vessel.free, position_px)
        return np.where(free, score, FORBIDDEN_LOGIT).astype(np.float32)

    def waypoints(self, position_px: FloatArray, target_px: FloatArray) -> FloatArray:
        """Return where to head for: the target if it is in sight, else the farthest visible path node.

        Args:
            position_px: Shape (n, 2), in the free space.
            target_px: Shape (n, 2).

        Returns:
            Shape (n, 2), in grid pixels.
        """
        waypoint = target_px.copy()
        hidden = np.flatnonzero(~sees(self._vessel, position_px, target_px))
        if hidden.size:
            here, there = position_px[hidden], target_px[hidden]
            goal = np.asarray(self._nearest.query(there)[1], dtype=np.int64)
            self._plan(goal)
            chain = self._chain(self._entry(here, goal), goal)
            best = self._farthest_visible(here, chain)
            # On a node, the next one is the way even where rounding hides it.
            best += (best == 0) & (np.hypot(*(self._nodes_px[chain[:, 0]] - here).T) < 1.0)
            found = self._nodes_px[chain[np.arange(len(chain)), best]]
            at_last_node = (found == here).all(axis=1, keepdims=True)
            waypoint[hidden] = np.where(at_last_node, there, found)
        return waypoint

    def path_length_px(self, start_px: FloatArray, target_px: FloatArray, corners: int = 200) -> FloatArray:
        """Return the length of the string-pulled shortest path, shape (n, 2) each to shape (n,)."""
        at, length_px = start_px.astype(np.float64), np.zeros(len(start_px))
        for _ in range(corners):
            towards = self.waypoints(at, target_px)
            hop_px = np.hypot(*(towards - at).T)
            length_px += hop_px
            at = towards
            if not hop_px.any():
                break
        return length_px

    def _plan(self, goals: IntArray) -> None:
        """Compute the shortest-path rows of those goal nodes that have none yet."""
        from scipy.sparse.csgraph import dijkstra

        for new in np.array_split(missing := np.unique(goals[~self._known[goals]]), len(missing) // 256 + 1):
            if new.size:
                length_px, onward = dijkstra(self._edges, indices=new, return_predecessors=True)
                self._length_px[new], self._onward[new] = length_px, onward
                self._known[new] = True

    def _entry(self, here: FloatArray, goal: IntArray, candidates: int = 8) -> IntArray:
        """Return the visible near node from which the goal is nearest; the nearest node if none is seen."""
        away_px, near = (
            np.asarray(found).reshape(len(here), -1)
            for found in self._nearest.query(here, k=min(candidates, len(self._nodes_px)))
        )
        starts = np.repeat(here, near.shape[1], axis=0)
        seen = sees(self._vessel, starts, self._nodes_px[near.ravel()]).reshape(near.shape)
        total_px = np.where(seen, away_px + self._length_px[goal[:, None], near], np.inf)
        best = np.where(seen.any(axis=1), total_px.argmin(axis=1), 0)
        return np.asarray(near[np.arange(len(here)), best], dtype=np.int64)

    def _chain(self, node: IntArray, goal: IntArray) -> IntArray:
        """Return the next nodes on the way to the goal, shape (n, hops); the goal repeats at the end."""
        chain = [node]
        for _ in range(LOOK_AHEAD_HOPS - 1):
            onward = self._onward[goal, chain[-1]]
            chain.append(np.where(onward < 0, chain[-1], onward))
        return np.stack(chain, axis=1)

    def _farthest_visible(self, here: FloatArray, chain: IntArray) -> IntArray:
        """Return the index along each chain up to which it is seen, by bisection."""
        low, high = np.zeros(len(here), dtype=np.int64), np.full(len(here), chain.shape[1])
        while (high - low > 1).any():
            middle = (low + high) // 2
            seen = sees(self._vessel, here, self._nodes_px[chain[np.arange(len(here)), middle]])
            low, high = np.where(seen, middle, low), np.where(seen, high, np.maximum(middle, low + 1))
        return low


def sees(vessel: VesselMap, start_px: FloatArray, end_px: FloatArray) -> BoolArray:
    """Tell per pair whether the straight line between two points stays in the free space.

    Marches along the line by as much as the clearance allows at once.

    Args:
        vessel: The vessel model.
        start_px: Shape (n, 2); outside the grid, the nearest pixel counts.
        end_px: Shape (n, 2), likewise.

    Returns:
        Shape (n,).
    """
    top = vessel.size_px - 1
    origin, end_px = start_px.clip(0, top), end_px.clip(0, top)
    left_px = np.hypot(*(end_px - origin).T)
    along = (end_px - origin) / np.maximum(left_px, 1e-9)[:, None]
    seen = np.zeros(len(origin), dtype=bool)
    alive, done_px = np.arange(len(origin)), np.zeros(len(origin))
    while alive.size:
        at = np.rint(origin + done_px[:, None] * along).astype(np.int64)
        free = vessel.free[at[:, 1], at[:, 0]]
        arrived = free & (done_px >= left_px)
        seen[alive[arrived]] = True
        gap_px = vessel.distance_px[at[:, 1], at[:, 0]] - vessel.robot_radius_px
        go = free & ~arrived
        alive, origin, along, left_px = alive[go], origin[go], along[go], left_px[go]
        # The clearance at the rounded pixel may be short by the rounding.
        done_px = np.minimum(done_px[go] + np.maximum(gap_px[go] - 1.5, 1.0), left_px)
    return seen
