"""Shortest paths on the free space."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrnav_server.autonomy.grid_graph import GridGraph
from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.vessel import VesselMap
from mrnav_server.vision.vessel_model import vessel_map


def room(*, wall_to_px: int) -> VesselMap:
    """Two halves of a room; a wall at x 100..104 leaves a way through only above ``wall_to_px``."""
    mask = np.full((200, 200), 255, np.uint8)
    mask[:wall_to_px, 100:105] = 0
    return vessel_map("room", mask, robot_radius_um=20.0)


@pytest.fixture(scope="module")
def open_room() -> GridGraph:
    return GridGraph(room(wall_to_px=0))


@pytest.fixture(scope="module")
def half_room() -> VesselMap:
    return room(wall_to_px=120)


def length_px(points_px: np.ndarray) -> float:
    return float(np.hypot(*np.diff(points_px, axis=0).T).sum())


def test_in_plain_sight_the_path_is_the_line(open_room: GridGraph) -> None:
    path = open_room.path(VesselPoint(20.3, 30.7), VesselPoint(170.0, 160.0))
    assert path.tolist() == [[20.3, 30.7], [170.0, 160.0]]


@pytest.mark.parametrize(("reach", "excess"), [(1, 1.083), (2, 1.028), (4, 1.012)])
def test_round_a_corner_the_path_is_nearly_the_taut_string(
    half_room: VesselMap, reach: int, excess: float
) -> None:
    start, end = VesselPoint(40.0, 30.0), VesselPoint(165.0, 20.0)
    # The robot's centre keeps 2 px from the wall's end: two corners at (98, 121.5) and (106, 121.5).
    taut_px = math.dist((40, 30), (98.5, 121)) + 7 + math.dist((105.5, 121), (165, 20))
    path = GridGraph(half_room, reach=reach).path(start, end)
    assert taut_px - 1.0 <= length_px(path) <= excess * taut_px + 4.0
    assert path[0].tolist() == [40.0, 30.0]
    assert path[-1].tolist() == [165.0, 20.0]


def test_no_step_of_a_path_crosses_the_wall(half_room: VesselMap) -> None:
    path = GridGraph(half_room, reach=3).path(VesselPoint(90.0, 10.0), VesselPoint(110.0, 10.0))
    share = np.linspace(0.0, 1.0, 50)[:, None]
    for here, there in pairwise(path):
        x, y = np.rint(here + share * (there - here)).astype(int).T
        assert half_room.free[y, x].all()


def test_distances_agree_with_paths(half_room: VesselMap) -> None:
    graph = GridGraph(half_room)
    target = VesselPoint(165.0, 20.0)
    distances_px = graph.distances_px(target)
    for node in (0, len(graph.nodes_px) // 3, len(graph.nodes_px) - 1):
        x_px, y_px = graph.nodes_px[node].tolist()
        path = graph.path(VesselPoint(x_px, y_px), target)
        assert length_px(path) == pytest.approx(distances_px[node], rel=0.03)
    assert graph.nearest(*graph.nodes_px[17].tolist()) == 17


HALF = GridGraph(room(wall_to_px=120))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1560), st.integers(0, 1560))
def test_the_way_there_is_as_long_as_the_way_back(one: int, other: int) -> None:
    forth_px = HALF.distances_px(VesselPoint(*HALF.nodes_px[one].tolist()))[other]
    back_px = HALF.distances_px(VesselPoint(*HALF.nodes_px[other].tolist()))[one]
    # Joining the graph through any node in sight may straighten the first few cells of either way.
    assert forth_px == pytest.approx(back_px, abs=1.0)


def test_edges_are_symmetric_and_of_length(half_room: VesselMap) -> None:
    graph = GridGraph(half_room)
    edges = graph.matrix
    assert abs(edges - edges.T).max() == 0.0
    tails, heads = edges.nonzero()
    spans_px = np.hypot(*(graph.nodes_px[heads] - graph.nodes_px[tails]).T)
    assert np.allclose(edges.data, np.hypot(*(graph.nodes_px[edges.indices] - graph.nodes_px[tails]).T))
    assert set(np.round(np.unique(spans_px), 3)) <= {4.0, 5.657, 8.944}


def test_clearance_draws_the_path_off_the_corner(half_room: VesselMap) -> None:
    start, end = VesselPoint(40.0, 30.0), VesselPoint(165.0, 20.0)
    tight = GridGraph(half_room).path(start, end)
    wide = GridGraph(half_room, clearance_weight=6.0, clearance_px=30.0).path(start, end)
    assert wide[:, 1].max() > tight[:, 1].max() + 8.0
    assert length_px(wide) > length_px(tight)


def test_a_start_inside_the_wall_joins_at_its_nearest_node(half_room: VesselMap) -> None:
    path = GridGraph(half_room).path(VesselPoint(102.0, 30.0), VesselPoint(165.0, 20.0))
    assert path[0].tolist() == [102.0, 30.0]
    assert path[1][0] > 104 or path[1][0] < 100


def test_what_is_cut_off_is_refused() -> None:
    free = np.ones((80, 80), bool)
    free[:, 40:44] = False
    whole = room(wall_to_px=0)
    halves = VesselMap("halves", free, whole.distance_px[:80, :80], 10.0, 2.0, "", free)
    graph = GridGraph(halves)
    assert np.isinf(graph.distances_px(VesselPoint(10.0, 10.0))).any()
    with pytest.raises(RefusedError, match="no path") as refused:
        graph.path(VesselPoint(10.0, 10.0), VesselPoint(70.0, 10.0))
    assert refused.value.code == "no_path"


def test_nonsense_is_refused() -> None:
    with pytest.raises(ConfigError, match="cell_px"):
        GridGraph(room(wall_to_px=0), cell_px=0)
    with pytest.raises(ConfigError, match="node fits"):
        GridGraph(room(wall_to_px=0), cell_px=1000)
