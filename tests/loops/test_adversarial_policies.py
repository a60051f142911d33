"""Policies that mean harm, through the whole control loop: no limit breaks, and AUTO ends in HOLD soon."""

import math
from dataclasses import replace
from typing import Protocol

import numpy as np
import pytest

from mrnav_server.autonomy.direct import ActionConfig, DirectLaw
from mrnav_server.autonomy.following import FollowerConfig
from mrnav_server.autonomy.grid_graph import DistanceField, GridGraph
from mrnav_server.autonomy.path import PathPlanner
from mrnav_server.core.arrays import Float32Array, FloatArray
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.modes import Ask, Mode
from mrnav_server.core.navigation import DIRECTIONS
from mrnav_server.core.vessel import VesselMap
from tests.loops.watched import WatchedRig

PATIENCE_S = 2.0
NEARER_UM = 120.0
"""The follower of progress looks at the camera's robot in cells of 40 µm; this is surely progress."""


class Adversary(Protocol):
    """Where it wants to go next."""

    def towards(self, at_px: FloatArray, target_px: FloatArray) -> tuple[float, float]:
        """Return a direction, which may be no number."""


class Scores:
    """The policy that an adversary makes."""

    name, kind = "adversary", "torchscript"

    def __init__(self, adversary: Adversary) -> None:
        self.adversary = adversary
        self.asked = 0

    def logits(self, observations: Float32Array) -> Float32Array:
        self.asked += 1
        at_px, target_px = observations[0, 0:2].astype(float), observations[0, 4:6].astype(float)
        toward = np.array(self.adversary.towards(at_px, target_px))
        return np.asarray((50.0 * DIRECTIONS @ toward)[None], dtype=np.float32)


class IntoTheWall:
    def __init__(self, vessel: VesselMap) -> None:
        self._vessel = vessel

    def towards(self, at_px: FloatArray, _: FloatArray) -> tuple[float, float]:
        gx, gy = self._vessel.wall_gradient(float(at_px[0]), float(at_px[1]))
        return -gx, -gy


class Turning:
    """Turns by the same angle at every action: back and forth, in squares, or in wide circles."""

    def __init__(self, turn_rad: float) -> None:
        self._turn_rad, self._angle_rad = turn_rad, 0.3

    def towards(self, _: FloatArray, __: FloatArray) -> tuple[float, float]:
        self._angle_rad += self._turn_rad
        return math.cos(self._angle_rad), math.sin(self._angle_rad)


class Away:
    def towards(self, at_px: FloatArray, target_px: FloatArray) -> tuple[float, float]:
        dx, dy = at_px - target_px
        return dx / math.hypot(dx, dy), dy / math.hypot(dx, dy)


class AtRandom:
    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)

    def towards(self, _: FloatArray, __: FloatArray) -> tuple[float, float]:
        x, y = self._random.normal(size=2)
        return float(x), float(y)


class NoNumber:
    def __init__(self, after: int) -> None:
        self._left = after

    def towards(self, at_px: FloatArray, target_px: FloatArray) -> tuple[float, float]:
        self._left -= 1
        dx, dy = target_px - at_px
        return (dx / math.hypot(dx, dy), dy / math.hypot(dx, dy)) if self._left > 0 else (math.nan, math.nan)


def adversary(name: str, vessel: VesselMap) -> Adversary:
    kind, _, value = name.partition(" ")
    match kind:
        case "wall":
            return IntoTheWall(vessel)
        case "turning":
            return Turning(math.radians(float(value)))
        case "random":
            return AtRandom(int(value))
        case "nan":
            return NoNumber(int(value))
        case _:
            return Away()


NAMES = ["wall", "turning 180", "turning 90", "turning 20", "turning 4", "away", "random 1", "random 2"]


@pytest.fixture(scope="module")
def lengths(bifurcation: VesselMap) -> GridGraph:
    return GridGraph(bifurcation)


def begun(
    bifurcation: VesselMap, planner: PathPlanner, field: DistanceField, target: VesselPoint, scores: Scores
) -> WatchedRig:
    """Return a watched rig in AUTO under the direct law; its invariants are checked at every step."""
    rig = WatchedRig(bifurcation, planner)
    actions = ActionConfig(greedy=False)
    rig.autopilot.use(DirectLaw(FollowerConfig(), actions, scores, bifurcation, rig.calibration))
    rig.advance(0.5)
    rig.control.choose_area(rig.areas.add(target, 300.0, ""))
    rig.ask(Ask.ARM)
    robot, area = rig.control.scene.robot, rig.control.scene.area
    assert robot is not None
    assert area is not None
    path = replace(planner.plan(robot, area.center), to_go=field)
    rig.autopilot.prepare(path, area.center, area.epsilon_um)
    rig.ask(Ask.AUTO)
    return rig


@pytest.mark.parametrize("name", NAMES)
def test_no_policy_breaks_a_limit_or_goes_on_without_progress(
    bifurcation: VesselMap, planner: PathPlanner, lengths: GridGraph, name: str
) -> None:
    target = bifurcation.suggested_areas[0]
    field = lengths.field(target)
    scores = Scores(adversary(name, bifurcation))
    rig = begun(bifurcation, planner, field, target, scores)
    best_px, nearer_s = math.inf, rig.now_s
    while rig.is_in(Mode.AUTO):
        rig.tick()
        robot = rig.world.robot
        left_px = field.at_px(robot.x_px, robot.y_px)
        if left_px * bifurcation.um_per_px < best_px * bifurcation.um_per_px - NEARER_UM:
            best_px, nearer_s = left_px, rig.now_s
        assert rig.now_s - nearer_s < PATIENCE_S + 0.2, "AUTO went on without progress"
    assert rig.is_in(Mode.HOLD)
    assert scores.asked > 2
    rig.advance(1.0)
    assert rig.control.drive.at_rest(rig.control.scene.tip, rig.now_s)


@pytest.mark.parametrize("after", [0, 1, 40])
def test_a_policy_that_answers_with_no_number_holds_at_once(
    bifurcation: VesselMap, planner: PathPlanner, lengths: GridGraph, after: int
) -> None:
    target = bifurcation.suggested_areas[0]
    scores = Scores(NoNumber(after))
    rig = begun(bifurcation, planner, lengths.field(target), target, scores)
    while scores.asked < max(after, 1):
        rig.tick()
    rig.advance(0.02)
    assert rig.is_in(Mode.HOLD)
    assert "not a number" in rig.control.machine.reason
    asked = scores.asked
    rig.advance(1.0)
    assert scores.asked == asked, "nobody asks a policy that was sent away"


@pytest.mark.parametrize("name", ["wall", "turning 180", "turning 20", "nan 0", "nan 30"])
def test_a_bad_roll_out_is_replaced_by_the_geodesic_which_is_said(
    bifurcation: VesselMap, planner: PathPlanner, name: str
) -> None:
    rig = WatchedRig(bifurcation, planner)
    rig.advance(0.5)
    robot = rig.control.scene.robot
    assert robot is not None
    path = planner.plan(
        robot, bifurcation.suggested_areas[0], Scores(adversary(name, bifurcation)), greedy=False
    )
    assert path.source == "geodesic"
    assert "policy adversary" in path.fallback
    assert ("not a number" in path.fallback) == name.startswith("nan")
    clearance_um = [bifurcation.clearance_um(VesselPoint(*map(float, point))) for point in path.points_px]
    assert min(clearance_um) > 0.0
