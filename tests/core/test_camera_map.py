"""The camera's maps: closed forms, round trips, and the pinhole camera that they claim to describe."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.camera_map import FloorMap, TipMap

CENTER = (799.5, 599.5)
points = st.tuples(st.floats(-9000, 9000), st.floats(-9000, 9000))
tilts = st.floats(-5e-6, 5e-6)
radials = st.floats(-0.1, 0.1)


def floor_map(radial: float = -0.01, px: float = 4e-7, py: float = -3e-7, turn: float = 0.1) -> FloorMap:
    cos, sin = np.cos(turn) / 15.0, np.sin(turn) / 15.0
    return FloorMap((cos, -sin, 800.0, sin, cos, 600.0, px, py, 1.0), CENTER, radial, 1000.0)


def test_an_affine_map_is_the_special_case() -> None:
    rows = np.array([[0.5, 0.1, 7.0], [-0.2, 0.6, 3.0]])
    affine = FloorMap.affine(rows)
    at = np.array([[0.0, 0.0], [10.0, 20.0]])
    assert affine.image(at) == pytest.approx(at @ rows[:, :2].T + rows[:, 2])
    assert affine.scale(at) == pytest.approx(np.sqrt(0.32))
    assert affine.best_affine(100.0) == pytest.approx(rows)


def test_distortion_moves_a_point_at_the_radius_by_its_share() -> None:
    lens = FloorMap((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), (0.0, 0.0), -0.05, 500.0)
    assert lens.image(np.array([300.0, 400.0])) == pytest.approx(np.array([285.0, 380.0]))
    assert lens.image(np.array([150.0, 200.0])) == pytest.approx(np.array([150.0, 200.0]) * (1 - 0.05 / 4))
    assert lens.image(np.array([0.0, 0.0])) == pytest.approx(np.zeros(2))


@given(point=points, radial=radials, px=tilts, py=tilts)
def test_the_inverse_undoes_the_map(point: tuple[float, float], radial: float, px: float, py: float) -> None:
    seen = floor_map(radial, px, py)
    assert seen.floor(seen.image(np.array(point))) == pytest.approx(np.array(point), abs=1e-6)


@given(point=points, radial=radials, px=tilts, py=tilts)
def test_the_jacobian_is_the_derivative(
    point: tuple[float, float], radial: float, px: float, py: float
) -> None:
    seen, at, step = floor_map(radial, px, py), np.array(point), 0.01
    columns = [
        (seen.image(at + step * unit) - seen.image(at - step * unit)) / (2 * step) for unit in np.eye(2)
    ]
    assert seen.jacobian(at) == pytest.approx(np.column_stack(columns), abs=1e-8)
    assert seen.scale(at) == pytest.approx(np.sqrt(abs(np.linalg.det(np.column_stack(columns)))), rel=1e-6)


def test_many_points_are_mapped_at_once() -> None:
    seen = floor_map()
    grid = np.random.default_rng(1).uniform(-9000, 9000, (5, 7, 2))
    whole = seen.image(grid)
    assert whole.shape == (5, 7, 2)
    assert whole[3, 2] == pytest.approx(seen.image(grid[3, 2]))
    assert seen.floor(whole) == pytest.approx(grid, abs=1e-6)
    assert seen.jacobian(grid).shape == (5, 7, 2, 2)


def test_beyond_the_fold_the_map_stays_at_its_edge() -> None:
    lens = FloorMap((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), (0.0, 0.0), -0.1, 100.0)
    far = lens.image(np.array([[400.0, 0.0], [4000.0, 0.0]]))
    assert far[0] == pytest.approx(far[1])
    assert np.all(np.isfinite(lens.floor(np.array([4000.0, 0.0]))))


@given(point=points, angle=st.floats(-3.0, 3.0))
def test_another_frame_of_the_floor_is_composed(point: tuple[float, float], angle: float) -> None:
    turn = np.array([[np.cos(angle), -np.sin(angle), 30.0], [np.sin(angle), np.cos(angle), -20.0]])
    moved = np.array(point) @ turn[:, :2].T + turn[:, 2]
    assert floor_map().after(turn).image(np.array(point)) == pytest.approx(floor_map().image(moved))


@pytest.mark.parametrize(
    "bad",
    [
        {"homography": (1.0,) * 8},
        {"homography": (1.0, 0.0, 0.0, 0.0, float("nan"), 0.0, 0.0, 0.0, 1.0)},
        {"homography": (0.0,) * 9},
        {"radial": 0.5},
        {"radius_px": 0.0},
    ],
)
def test_a_map_without_an_inverse_is_refused(bad: dict[str, object]) -> None:
    good: dict[str, object] = {"homography": (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)}
    with pytest.raises(ValueError, match=r"floor map|radial share|singular"):
        FloorMap(**(good | bad))  # type: ignore[arg-type]


CAMERA = np.array([2000.0, -1500.0, 68_000.0])


def tip_map(camera: FloatArray = CAMERA) -> TipMap:
    """The map of a camera over a stage that is the floor's frame, floor at z = 0."""
    x, y, z = camera
    # q = (p - c·h/H)/(1 - h/H)
    return TipMap((1.0, 0.0, -x / z, 0.0, 1.0, -y / z), (0.0, 0.0), float(z))


@given(point=points, z_um=st.floats(0.0, 20_000.0))
def test_the_tip_hides_where_its_ray_meets_the_floor(point: tuple[float, float], z_um: float) -> None:
    tip = np.array([*point, z_um])
    ray = tip - CAMERA
    met = CAMERA + ray * (CAMERA[2] / -ray[2])
    assert tip_map().floor(tip) == pytest.approx(met[:2], abs=1e-6)


@given(point=points, z_um=st.floats(0.0, 20_000.0))
def test_the_stage_is_found_again_from_what_is_hidden(point: tuple[float, float], z_um: float) -> None:
    hidden = tip_map().floor(np.array([*point, z_um]))
    assert tip_map().stage_xy_um(hidden, z_um) == pytest.approx(np.array(point), abs=1e-6)
    rows = tip_map().at_height(z_um)
    assert rows[:, :2] @ np.array(point) + rows[:, 2] == pytest.approx(hidden, abs=1e-6)


def test_on_the_floor_the_tip_appears_in_true_size() -> None:
    assert tip_map().true_size_z_um() == pytest.approx(0.0, abs=1e-6)


@settings(max_examples=30)
@given(point=points, angle=st.floats(-3.0, 3.0), scale=st.floats(0.05, 2.0))
def test_the_tip_goes_into_another_frame(point: tuple[float, float], angle: float, scale: float) -> None:
    cos, sin = scale * np.cos(angle), scale * np.sin(angle)
    rows = np.array([[cos, -sin, 5.0], [sin, cos, -8.0]])
    tip = np.array([*point, 12_000.0])
    expected = tip_map().floor(tip) @ rows[:, :2].T + rows[:, 2]
    assert tip_map().then(rows).floor(tip) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("matrix", [(1.0,) * 5, (0.0,) * 6, (1.0, 0.0, float("inf"), 0.0, 1.0, 0.0)])
def test_a_tip_map_without_an_inverse_is_refused(matrix: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="tip map"):
        TipMap(matrix, (0.0, 0.0), 70_000.0)
