"""Random vessel networks, one per seed: connected, and everywhere wide enough for the robot."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial import Delaunay

from mrnav_server.core.arrays import ByteArray, FloatArray
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.suggested_areas import suggest_areas
from mrnav_server.training.vessels import SIZE_PX, Branch, paint
from mrnav_server.vision.vessel_model import save_vessel_model, vessel_map

_EDGE_PX = 170.0
"""Nodes and middles keep so far from the grid's edge: the widest vessel fits between."""
_APART_PX = 400.0
"""Nodes keep so far from each other that there is tissue between their vessels."""
_NODES = (6, 10)
_LEAST_ANGLE_DEG = 50.0
"""Vessels that leave a node at a smaller angle would merge for a long way."""
_NODE_WIDTH_PX = (165.0, 250.0)
_VESSEL_WIDTH_PX = (145.0, 220.0)
"""Halfway between nodes; the spline through them stays within 130 to 260 px (1.3 to 2.6 mm)."""
_BEND = 0.12
"""Largest sideways shift of a vessel's middle, over its length."""
_LEAST_TISSUE_PX = 10_000
"""1 mm²."""
_LOOP_SHARE = 0.5
"""Chance of every vessel that is possible beyond those that connect all nodes."""


def generate_random(seed: int, folder: Path) -> VesselMap:
    """Draw the network of a seed and write its folder (``mask.png`` and ``model.json``)."""
    name = f"random-{seed}"
    nodes_px, branches = _network(np.random.default_rng(seed))
    bare = vessel_map(name, _without_slits(paint(branches)))
    model = replace(bare, suggested_areas=suggest_areas(bare, nodes_px))
    title = f"Random network {seed}, {SIZE_PX * model.um_per_px / 1000:.0f} mm"
    save_vessel_model(folder, model, title, f"drawn by `mrnav map generate random --seed {seed}`")
    return model


def _without_slits(mask: ByteArray) -> ByteArray:
    """Fill the slivers of tissue that remain where vessels merge."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(255 - mask, connectivity=4)
    return np.where(stats[labels, cv2.CC_STAT_AREA] < _LEAST_TISSUE_PX, 255, mask).astype(np.uint8)


def _network(random: np.random.Generator) -> tuple[FloatArray, list[Branch]]:
    nodes_px = _nodes(random)
    width_px = random.uniform(*_NODE_WIDTH_PX, len(nodes_px))
    branches: list[Branch] = []
    for a, b in _vessels(nodes_px, random):
        way = nodes_px[b] - nodes_px[a]
        aside = np.array([-way[1], way[0]]) * random.uniform(-_BEND, _BEND)
        middle_px = (nodes_px[a] + nodes_px[b]) / 2 + aside
        x, y = np.clip(middle_px, _EDGE_PX, SIZE_PX - _EDGE_PX)
        middle = (float(x), float(y), float(random.uniform(*_VESSEL_WIDTH_PX)))
        branches.append((_point(nodes_px[a], width_px[a]), middle, _point(nodes_px[b], width_px[b])))
    return nodes_px, branches


def _point(node_px: FloatArray, width_px: float) -> tuple[float, float, float]:
    return float(node_px[0]), float(node_px[1]), float(width_px)


def _nodes(random: np.random.Generator) -> FloatArray:
    """Throw nodes until enough lie apart, shape (n, 2)."""
    wanted = int(random.integers(*_NODES, endpoint=True))
    nodes: list[FloatArray] = []
    for _ in range(5000):
        node = random.uniform(_EDGE_PX, SIZE_PX - _EDGE_PX, 2)
        if all(np.hypot(*(node - other)) >= _APART_PX for other in nodes):
            nodes.append(node)
        if len(nodes) == wanted:
            break
    return np.array(nodes)


def _vessels(nodes_px: FloatArray, random: np.random.Generator) -> list[tuple[int, int]]:
    """Choose among neighbours those that connect all nodes, the shortest first, and some that close loops."""
    corners = [tuple(sorted(map(int, triangle))) for triangle in Delaunay(nodes_px).simplices]
    pairs = {pair for a, b, c in corners for pair in ((a, b), (b, c), (a, c))}
    by_length = sorted(pairs, key=lambda pair: float(np.hypot(*(nodes_px[pair[0]] - nodes_px[pair[1]]))))
    group = list(range(len(nodes_px)))
    chosen: list[tuple[int, int]] = []
    for wide in (True, False):
        # Angles that are too small count only where nothing else connects.
        for a, b in by_length:
            if group[a] != group[b] and (_leaves_at_wide_angle(a, b, chosen, nodes_px) or not wide):
                chosen.append((a, b))
                joined, kept = group[b], group[a]
                group = [kept if each == joined else each for each in group]
    for a, b in by_length:
        fits = (a, b) not in chosen and _leaves_at_wide_angle(a, b, chosen, nodes_px)
        if fits and random.random() < _LOOP_SHARE:
            chosen.append((a, b))
    return chosen


def _leaves_at_wide_angle(a: int, b: int, chosen: list[tuple[int, int]], nodes_px: FloatArray) -> bool:
    for here, there in ((a, b), (b, a)):
        for c, d in chosen:
            if here in (c, d):
                other = d if here == c else c
                way, beside = nodes_px[there] - nodes_px[here], nodes_px[other] - nodes_px[here]
                cosine = way @ beside / (np.hypot(*way) * np.hypot(*beside))
                if cosine > np.cos(np.radians(_LEAST_ANGLE_DEG)):
                    return False
    return True
