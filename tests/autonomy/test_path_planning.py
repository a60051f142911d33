"""Paths for the robot's centre."""

import math

import numpy as np
import pytest

from mrnav_server.autonomy.band import clearance_field_px, resampled, smooth_path, smoothed, tangents
from mrnav_server.autonomy.path import PathConfig, PathPlanner, PlannedPath
from mrnav_server.core.arrays import Float32Array, FloatArray
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.navigation import DIRECTIONS
from mrnav_server.core.vessel import VesselMap
from mrnav_server.vision.vessel_model import vessel_map

TRUNK, BRANCH = VesselPoint(893.0, 1560.0), VesselPoint(436.0, 501.0)


class StraightPolicy:
    """Heads for the target as the crow flies."""

    name = "crow"
    kind = "test"

    def logits(self, observations: Float32Array) -> Float32Array:
        toward = observations[:, 4:6] - observations[:, 0:2]
        return np.asarray(toward @ DIRECTIONS.T, dtype=np.float32)


class EastwardPolicy(StraightPolicy):
    """Heads east, wherever the target is."""

    name = "eastward"

    def logits(self, observations: Float32Array) -> Float32Array:
        return np.tile(DIRECTIONS[:, 0].astype(np.float32), (len(observations), 1))


@pytest.fixture(scope="module")
def corridor() -> VesselMap:
    """A straight corridor along x, 200 px wide, its middle at y = 349.5; the robot has 50 px to spare."""
    mask = np.zeros((700, 700), np.uint8)
    mask[250:450, :] = 255
    return vessel_map("corridor", mask)


def gap_um(vessel: VesselMap, points_px: FloatArray) -> FloatArray:
    return np.array([vessel.clearance_um(VesselPoint(float(x), float(y))) for x, y in points_px])


def check_shape(path: PlannedPath, start: VesselPoint, target: VesselPoint) -> None:
    first, last = path.points_px[0], path.points_px[-1]
    assert math.dist(first, (start.x_px, start.y_px)) < 1e-6
    assert 2.0 <= math.dist(last, (target.x_px, target.y_px)) <= 13.0
    steps = np.hypot(*np.diff(path.points_px, axis=0).T)
    assert steps.min() > 0.8
    assert steps.max() < 1.05
    assert np.hypot(*path.tangents.T) == pytest.approx(1.0)
    assert ((path.points_px[1:] - path.points_px[:-1]) * path.tangents[:-1]).sum(axis=1).min() > 0.8


def test_the_geodesic_leads_through_the_bifurcation_clear_of_walls(
    planner: PathPlanner, bifurcation: VesselMap
) -> None:
    path = planner.plan(TRUNK, BRANCH)
    assert path.source == "geodesic"
    check_shape(path, TRUNK, BRANCH)
    assert gap_um(bifurcation, path.points_px).min() > 150.0


def test_a_policy_that_arrives_proposes_the_route(planner: PathPlanner, bifurcation: VesselMap) -> None:
    start, target = VesselPoint(893.4, 1560.2), VesselPoint(880.0, 1200.0)
    path = planner.plan(start, target, StraightPolicy())
    assert (path.source, path.fallback) == ("policy", "")
    check_shape(path, start, target)


def test_a_policy_that_does_not_arrive_is_replaced_and_named(planner: PathPlanner) -> None:
    path = planner.plan(TRUNK, BRANCH, EastwardPolicy())
    assert path.source == "geodesic"
    assert "eastward does not arrive in 2000 actions" in path.fallback
    check_shape(path, TRUNK, BRANCH)


def test_a_robot_that_leans_on_the_wall_gets_a_path(planner: PathPlanner, bifurcation: VesselMap) -> None:
    y = np.nonzero(bifurcation.free[:, 893])[0].max() + 1.4
    path = planner.plan(VesselPoint(893.0, float(y)), VesselPoint(880.0, 1200.0), StraightPolicy())
    assert path.source == "policy"


def test_the_end_is_nudged_off_the_wall_by_less_than_the_arrival_radius(
    planner: PathPlanner, bifurcation: VesselMap
) -> None:
    x = int(np.nonzero(bifurcation.free[1300])[0].min())
    target = VesselPoint(float(x), 1300.0)
    path = planner.plan(TRUNK, target)
    end = path.points_px[-1]
    assert gap_um(bifurcation, path.points_px[-1:])[0] > 30.0
    assert math.dist(end, (target.x_px, target.y_px)) * 10.0 < 150.0
    assert path.target == target


def test_a_way_off_the_target_has_room_and_comes_in_sight(
    planner: PathPlanner, bifurcation: VesselMap
) -> None:
    near = VesselPoint(BRANCH.x_px + 12.0, BRANCH.y_px + 4.0)
    path = planner.plan_back_off(near, BRANCH)
    assert path is not None
    assert path.back_off
    assert path.target.distance_px(BRANCH) * 10.0 == pytest.approx(1500.0, abs=401.0)
    assert gap_um(bifurcation, path.points_px[10:]).min() > 30.0


def test_there_may_be_no_way_off(corridor: VesselMap) -> None:
    mask = np.zeros((400, 400), np.uint8)
    mask[100:220, 100:220] = 255
    cell = PathPlanner(vessel_map("cell", mask))
    assert cell.plan_back_off(VesselPoint(160.0, 160.0), VesselPoint(155.0, 160.0)) is None


def test_the_wall_pushes_the_path_to_the_wanted_clearance(corridor: VesselMap) -> None:
    raw = np.array([[100.0, 349.5], [200.0, 308.0], [500.0, 308.0], [600.0, 349.5]])
    field = clearance_field_px(corridor)
    pushed = smooth_path(raw, field, 25.0, 30.0)
    free = smooth_path(raw, field, 0.0, 30.0)
    gap_px = gap_um(corridor, pushed).min() / 10.0
    assert gap_um(corridor, free).min() / 10.0 < 13.0
    assert gap_px == pytest.approx(25.0, abs=3.0)


def test_a_straight_line_in_the_open_stays_straight(corridor: VesselMap) -> None:
    line = np.array([[110.0, 340.0], [590.0, 360.0]])
    path = smooth_path(line, clearance_field_px(corridor), 25.0, 30.0)
    assert path[:, 1] == pytest.approx(340.0 + 20.0 * (path[:, 0] - 110.0) / 480.0)
    assert np.diff(path[:, 0]).min() > 0.9
    assert np.allclose(tangents(path), (line[1] - line[0]) / math.dist(*line))


def test_smoothing_pins_the_ends_and_cuts_ripple() -> None:
    x = np.arange(200.0)
    points = np.stack([x, np.sin(x)], axis=1)
    smooth = smoothed(points, 5.0)
    assert smooth[0] == pytest.approx(points[0])
    assert smooth[-1] == pytest.approx(points[-1])
    # A Gaussian passes exp(-(ωσ)²/2) of a sine.
    assert np.abs(smooth[40:-40, 1]).max() == pytest.approx(math.exp(-0.5 * 5.0**2), abs=1e-4)


def test_resampling_keeps_ends_and_spacing() -> None:
    path = resampled(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]]), 0.5)
    assert path.shape == (15, 2)
    assert path[-1].tolist() == [3.0, 4.0]
    assert np.hypot(*np.diff(path, axis=0).T) == pytest.approx(0.5)


def test_a_target_underfoot_still_gives_a_path(planner: PathPlanner) -> None:
    path = planner.plan(TRUNK, TRUNK)
    assert len(path.points_px) >= 2
    assert np.isfinite(path.tangents).all()
    assert path.length_px < 1.0


def test_the_roll_out_is_capped(bifurcation: VesselMap) -> None:
    short = PathPlanner(bifurcation, PathConfig(roll_out_steps=3))
    assert "3 actions" in short.plan(TRUNK, VesselPoint(880.0, 1200.0), StraightPolicy()).fallback


def test_the_end_is_nudged_from_a_wall_by_no_more_than_the_area_allows(bifurcation: VesselMap) -> None:
    planner = PathPlanner(bifurcation, PathConfig(coast_um=0.0))
    rows, columns = np.nonzero(bifurcation.free)
    gap_px = bifurcation.distance_px[rows, columns] - bifurcation.robot_radius_px
    at = int(np.argmin(np.abs(gap_px - 5.0)))
    target = VesselPoint(float(columns[at]), float(rows[at]))
    start = bifurcation.suggested_areas[0]

    def nudged_um(epsilon_um: float) -> float:
        x_px, y_px = planner.plan(start, target, epsilon_um=epsilon_um).points_px[-1]
        return target.distance_px(VesselPoint(float(x_px), float(y_px))) * bifurcation.um_per_px

    assert nudged_um(500.0) == pytest.approx(65.0, abs=6.0)
    assert nudged_um(50.0) == pytest.approx(25.0, abs=6.0)
