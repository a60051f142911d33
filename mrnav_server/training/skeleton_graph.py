"""The centre line of a lumen as a graph: branches between junctions and ends."""

from dataclasses import dataclass

import cv2
import numpy as np

from mrnav_server.core.arrays import BoolArray, Float32Array, FloatArray, IntArray

SPUR_RADII = 2.0
"""A side branch that reaches no farther from a junction's middle than so many radii is no branch: it is
shorter than it is wide, or a bump in the wall."""


@dataclass(slots=True)
class Edge:
    """A branch: its pixels (x, y) in order, shape (n, 2), and the nodes at its two ends."""

    path_px: FloatArray
    tail: int
    head: int

    @property
    def length_px(self) -> float:
        """Length along the pixels."""
        return float(np.hypot(*np.diff(self.path_px, axis=0).T).sum())

    def reversed(self) -> "Edge":
        """Return the branch from its other end."""
        return Edge(self.path_px[::-1], self.head, self.tail)


class SkeletonGraph:
    """A skeleton's branches and nodes, without spurs.

    Args:
        skeleton: Shape (h, w), one pixel thin.
        distance_px: Distance to the wall, shape (h, w).

    Attributes:
        edges: The branches.
        nodes_px: Where each node lies (x, y).
    """

    def __init__(self, skeleton: BoolArray, distance_px: Float32Array) -> None:
        self._distance_px = distance_px
        self.nodes_px: dict[int, FloatArray] = {}
        self.edges: list[Edge] = []
        self._trace(skeleton)
        self._join()
        while self._prune():
            self._join()
        self._contract()

    def degrees(self) -> dict[int, int]:
        """Return how many branches end at each node; a loop ends twice."""
        count = dict.fromkeys(self.nodes_px, 0)
        for edge in self.edges:
            count[edge.tail] += 1
            count[edge.head] += 1
        return count

    def radius_px(self, node: int) -> float:
        """Return the radius of the largest disc around a node that is in the lumen."""
        x, y = np.rint(self.nodes_px[node]).astype(int)
        return max(float(self._distance_px[y, x]), 1.0)

    def _trace(self, skeleton: BoolArray) -> None:
        """Cut the skeleton at its crossings; what remains are chains of pixels."""
        thin = np.pad(skeleton, 1).astype(np.uint8)
        around = cv2.boxFilter(thin, cv2.CV_16S, (3, 3), normalize=False) - thin
        crossing = ((thin > 0) & (around >= 3)).astype(np.uint8)
        count, labels, _, centres = cv2.connectedComponentsWithStats(crossing, connectivity=8)
        crossings = labels.astype(np.int64)
        self.nodes_px = {node: centres[node].astype(np.float64) - 1.0 for node in range(1, count)}
        _, chains = cv2.connectedComponents(thin - crossing, connectivity=8)
        rows, columns = np.nonzero(chains)
        order = np.argsort(chains[rows, columns], kind="stable")
        pixels = np.stack([columns, rows], axis=1)[order].astype(np.int64)
        starts = np.flatnonzero(np.diff(chains[rows, columns][order])) + 1
        for chain in np.split(pixels, starts) if len(pixels) else []:
            path = _walk(chain)
            tail = self._end(path[0], crossings, taken=0)
            head = self._end(path[-1], crossings, taken=tail if len(path) == 1 else 0)
            if tail == 0 and head == 0 and _touch(path[0], path[-1]) and len(path) > 2:
                tail = head = self._new_node(path[0])
            tail = tail or self._new_node(path[0])
            head = head or self._new_node(path[-1])
            points = [self.nodes_px[tail], *(path - 1.0), self.nodes_px[head]]
            self.edges.append(Edge(np.array(points, dtype=np.float64), tail, head))

    def _end(self, pixel: IntArray, crossings: IntArray, taken: int) -> int:
        """Return the crossing that a chain's last pixel touches, 0 if none but the one taken."""
        x, y = pixel
        near = np.unique(crossings[y - 1 : y + 2, x - 1 : x + 2])
        near = near[(near != 0) & (near != taken)]
        return int(near[0]) if near.size else 0

    def _new_node(self, pixel: IntArray) -> int:
        node = 1 + max(self.nodes_px, default=0)
        self.nodes_px[node] = pixel.astype(np.float64) - 1.0
        return node

    def _join(self) -> None:
        """Make one branch of every two that meet alone, and forget nodes without branches."""
        at: dict[int, list[Edge]] = {node: [] for node in self.nodes_px}
        for edge in self.edges:
            at[edge.tail].append(edge)
            at[edge.head].append(edge)
        for node, edges in at.items():
            if len(edges) != 2 or edges[0] is edges[1]:
                continue
            first, second = edges
            before = first if first.head == node else first.reversed()
            after = second if second.tail == node else second.reversed()
            first.path_px = np.vstack([before.path_px, after.path_px[1:]])
            first.tail, first.head = before.tail, after.head
            other_end = at[after.head]
            other_end[next(i for i, edge in enumerate(other_end) if edge is second)] = first
            self.edges = [edge for edge in self.edges if edge is not second]
            at[node] = []
        used = {node for edge in self.edges for node in (edge.tail, edge.head)}
        self.nodes_px = {node: point for node, point in self.nodes_px.items() if node in used}

    def _prune(self) -> bool:
        """Remove the spurs at every junction; tell whether there were any."""
        degree = self.degrees()
        spurs: dict[int, list[Edge]] = {}
        for edge in self.edges:
            inner, tip = (edge.tail, edge.head) if degree[edge.head] == 1 else (edge.head, edge.tail)
            at_junction = degree[tip] == 1 and degree[inner] >= 3
            if at_junction and edge.length_px < SPUR_RADII * self.radius_px(inner):
                spurs.setdefault(inner, []).append(edge)
        dropped: list[Edge] = []
        for node, found in spurs.items():
            found.sort(key=lambda edge: edge.length_px)
            # Where there is nothing else, the two longest are the vessel.
            dropped += found if len(found) < degree[node] else found[:-2]
        self.edges = [edge for edge in self.edges if not any(edge is other for other in dropped)]
        return bool(dropped)

    def _contract(self) -> None:
        """Make one junction of two whose discs hold each other's middle, such as those of a crossing."""
        while True:
            degree = self.degrees()
            short = [
                edge
                for edge in self.edges
                if edge.tail != edge.head
                and min(degree[edge.tail], degree[edge.head]) >= 3
                and edge.length_px < max(self.radius_px(edge.tail), self.radius_px(edge.head))
            ]
            if not short:
                return
            gone = min(short, key=lambda edge: edge.length_px)
            self.edges = [edge for edge in self.edges if edge is not gone]
            kept, lost = gone.tail, gone.head
            for edge in self.edges:
                if edge.tail == lost:
                    edge.tail, edge.path_px = kept, np.vstack([self.nodes_px[kept], edge.path_px])
                if edge.head == lost:
                    edge.head, edge.path_px = kept, np.vstack([edge.path_px, self.nodes_px[kept]])
            del self.nodes_px[lost]


def _touch(a: IntArray, b: IntArray) -> bool:
    return bool(np.abs(a - b).max() <= 1)


def _walk(chain: IntArray) -> IntArray:
    """Put a chain's pixels, shape (n, 2), in order from one end to the other; a ring may start anywhere."""
    left = {(int(x), int(y)) for x, y in chain}
    ends = [pixel for pixel in left if len(_beside(pixel, left)) <= 1]
    at = min(ends) if ends else min(left)
    path = [at]
    left.discard(at)
    while near := _beside(at, left):
        # Straight before diagonal, or a corner would be cut off.
        at = min(near, key=lambda pixel: abs(pixel[0] - at[0]) + abs(pixel[1] - at[1]))
        path.append(at)
        left.discard(at)
    return np.array(path, dtype=np.int64)


def _beside(pixel: tuple[int, int], among: set[tuple[int, int]]) -> list[tuple[int, int]]:
    x, y = pixel
    around = [(x + i, y + j) for j in (-1, 0, 1) for i in (-1, 0, 1) if (i, j) != (0, 0)]
    return [other for other in around if other in among]
