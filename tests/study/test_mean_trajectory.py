import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrnav_server.core.arrays import FloatArray
from mrnav_server.study.mean_trajectory import by_arc_length, mean_trajectory


def line(y_um: float, points: int = 50) -> FloatArray:
    return np.stack([np.linspace(0.0, 10_000.0, points), np.full(points, y_um)], axis=1)


def half_circle(radius_um: float, points: int = 2000) -> FloatArray:
    angle = np.linspace(np.pi, 0.0, points)
    return radius_um * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def test_two_parallel_lines_at_250_um() -> None:
    mean = mean_trajectory({"P01": [line(250.0)], "P02": [line(-250.0)]})
    assert mean.sd_um == pytest.approx(353.553, abs=1e-3)
    assert mean.xy_um[:, 1] == pytest.approx(0.0, abs=1e-9)
    assert (mean.operators, mean.paths) == (2, 2)


def test_half_circles_of_4_5_and_6_mm() -> None:
    mean = mean_trajectory({f"P{r}": [half_circle(1000.0 * r)] for r in (4, 5, 6)})
    assert mean.sd_um == pytest.approx(1000.0, abs=0.5)
    assert np.hypot(*mean.xy_um.T) == pytest.approx(5000.0, abs=0.5)
    outer_um, inner_um = mean.band_um()
    assert sorted((np.hypot(*outer_um[100]), np.hypot(*inner_um[100]))) == pytest.approx([4000, 6000], abs=1)


def test_the_same_way_at_other_speeds_has_no_spread() -> None:
    time = np.linspace(0.0, 1.0, 400)
    noise = np.random.default_rng(1)
    paths = {}
    for who, power in enumerate((0.6, 1.0, 1.7)):
        angle = np.pi * (1.0 - time**power)
        circle = 5000.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        paths[f"P{who}"] = [circle + noise.normal(0.0, 1.0, circle.shape)]
    mean = mean_trajectory(paths)
    assert float(np.median(mean.sd_um)) == pytest.approx(1.0, abs=0.6)
    assert mean.sd_um.max() < 10.0
    # Over time they lie millimetres apart.
    over_time = np.array([path[0] for path in paths.values()])
    assert over_time.std(axis=0, ddof=1).max() > 500.0


def test_an_operator_counts_once_however_often_they_drove() -> None:
    often = mean_trajectory({"P01": [line(300.0)] * 9 + [line(100.0)], "P02": [line(0.0)]})
    assert often.xy_um[:, 1] == pytest.approx(140.0)
    assert often.sd_um == pytest.approx(280.0 / np.sqrt(2.0))
    assert (often.operators, often.paths) == (2, 11)


def test_one_operator_has_no_spread_between_operators() -> None:
    mean = mean_trajectory({"P01": [line(100.0), line(-100.0)], "P02": []})
    assert np.isnan(mean.sd_um).all()
    assert mean.xy_um[:, 1] == pytest.approx(0.0, abs=1e-9)


def test_no_path_is_an_error() -> None:
    with pytest.raises(ValueError, match="at least one path"):
        mean_trajectory({"P01": []})


def test_a_robot_that_stood_still_stays_where_it_was() -> None:
    assert by_arc_length(np.array([[3.0, 4.0]] * 5), 7) == pytest.approx(np.array([[3.0, 4.0]] * 7))


@settings(deadline=None)
@given(
    shares=st.lists(st.floats(0.0, 1.0), min_size=0, max_size=30).map(sorted),
    points=st.integers(2, 50),
)
def test_points_lie_evenly_whatever_the_sampling(shares: list[float], points: int) -> None:
    along_um = np.array([0.0, *shares, 1.0]) * 5000.0
    path = np.stack([0.6 * along_um, 0.8 * along_um], axis=1)
    even = by_arc_length(path, points)
    assert np.hypot(*np.diff(even, axis=0).T) == pytest.approx(5000.0 / (points - 1), rel=1e-6)
