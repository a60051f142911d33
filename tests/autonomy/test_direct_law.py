"""The published law, on scripted sightings: the magnet moves by the policy's actions and by nothing else."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mrnav_server.autonomy.direct import ActionConfig, DirectLaw
from mrnav_server.autonomy.following import FollowerConfig, FollowerStatus, FollowerWish
from mrnav_server.autonomy.grid_graph import GridGraph
from mrnav_server.autonomy.path import PlannedPath
from mrnav_server.autonomy.plane import Plane
from mrnav_server.core.arrays import Float32Array
from mrnav_server.core.frames import Affine2, Calibration, StagePoint, VesselPoint
from mrnav_server.core.navigation import ACTIONS
from mrnav_server.core.records import TipReading, Track, TrackState
from mrnav_server.core.vessel import VesselMap

CALIBRATION = Calibration(
    image_from_vessel=Affine2.scale(1.0),
    stage_from_vessel=Affine2.scale(10.0, 500.0, 700.0),
    um_per_px=10.0,
    floor_z_um=0.0,
    magnet_offset_um=(1500.0, -400.0),
    critical_height_um=10_000.0,
)
TARGET = VesselPoint(893.0, 900.0)
ACTION = 7


class OneAction:
    """Always wants the same."""

    name, kind = "one", "torchscript"

    def __init__(self) -> None:
        self.observations: list[Float32Array] = []

    def logits(self, observations: Float32Array) -> Float32Array:
        self.observations.append(observations)
        return np.eye(40, dtype=np.float32)[[ACTION]] * 50.0


class Scene:
    """A perfect manipulator over a robot that lies where the test puts it."""

    def __init__(self, vessel: VesselMap, actions: ActionConfig | None = None) -> None:
        self.plane = Plane(CALIBRATION)
        self.policy = OneAction()
        self.law = DirectLaw(
            FollowerConfig(), actions or ActionConfig(per_s=10.0), self.policy, vessel, CALIBRATION
        )
        self.now_s = 10.0
        self.robot_px = (893.0, 1500.0)
        self.hold_um = self.began_um = (8930.0, 14_900.0)
        self.sees = True
        self.law.start(path(), self.track(), self.tip(), self.now_s)

    def track(self) -> Track:
        seen = VesselPoint(*self.robot_px)
        return Track(self.now_s, round(self.now_s * 1000), TrackState.TRACKING, None, seen, 1.0, 4.0, 10)

    def tip(self) -> TipReading:
        return TipReading(self.now_s, StagePoint(*self.plane.tip_um(self.hold_um), 12_000.0), moving=True)

    def run(self, seconds: float) -> FollowerWish:
        for _ in range(round(seconds * 100)):
            self.now_s += 0.01
            wish = self.law.step(self.now_s, self.track() if self.sees else None, self.tip())
            self.hold_um = self.plane.hold_um(StagePoint(*wish.tip_um, 0.0))
        return wish


def path() -> PlannedPath:
    points_px = np.array([[893.0, 1500.0], [893.0, 900.0]])
    return PlannedPath(points_px, np.tile([0.0, -1.0], (2, 1)), TARGET, "policy")


@pytest.fixture
def scene(bifurcation: VesselMap) -> Scene:
    return Scene(bifurcation)


def test_each_action_moves_the_magnet_by_its_step_at_the_decision_rate(scene: Scene) -> None:
    wish = scene.run(1.0)
    assert len(scene.policy.observations) == 10
    moved_um = np.array(scene.hold_um) - scene.began_um
    # The last of the ten is still under way.
    assert moved_um == pytest.approx(10.0 * ACTIONS[ACTION] * 9.9, abs=0.1 * 71.0)
    assert np.array(wish.velocity_um_per_s) == pytest.approx(100.0 * ACTIONS[ACTION])


@pytest.mark.parametrize("per_s", [7.0, 30.0, 45.0])
def test_the_rate_does_not_depend_on_the_control_loops_ticks(bifurcation: VesselMap, per_s: float) -> None:
    scene = Scene(bifurcation, ActionConfig(per_s=per_s))
    scene.run(2.0)
    assert len(scene.policy.observations) == pytest.approx(2.0 * per_s, abs=1.5)


def test_the_policy_sees_the_tracked_robot(scene: Scene) -> None:
    scene.run(0.1)
    scene.robot_px = (890.0, 1400.0)
    scene.run(0.2)
    assert scene.policy.observations[-1][0] == pytest.approx([890.0, 1400.0, 893.0, 1500.0, 893.0, 900.0])


def test_a_magnet_that_was_kept_back_is_not_called_further(scene: Scene) -> None:
    began_um = scene.hold_um
    for _ in range(300):
        scene.run(0.01)
        scene.hold_um = began_um
    wish = scene.run(0.01)
    away_um = math.dist(scene.plane.hold_um(StagePoint(*wish.tip_um, 0.0)), began_um)
    assert away_um < 300.0 + 71.0


def test_it_arrives_where_the_robot_rests_near_the_target(scene: Scene) -> None:
    scene.run(0.3)
    scene.robot_px = (893.0, 906.0)
    wish = scene.run(1.0)
    assert wish.status is FollowerStatus.ARRIVED
    assert wish.velocity_um_per_s == (0.0, 0.0)
    asked = len(scene.policy.observations)
    scene.run(1.0)
    assert len(scene.policy.observations) == asked


def test_a_robot_that_coasts_out_again_gets_further_actions(scene: Scene) -> None:
    scene.run(0.3)
    scene.robot_px = (893.0, 906.0)
    assert scene.run(0.05).status is FollowerStatus.SETTLING
    scene.robot_px = (893.0, 880.0)
    assert scene.run(1.0).status is FollowerStatus.FOLLOWING


def test_a_robot_out_of_sight_is_lost(scene: Scene) -> None:
    scene.run(0.3)
    scene.sees = False
    wish = scene.run(0.5)
    assert wish.status is FollowerStatus.LOST
    assert "not seen" in wish.reason


def test_what_is_left_is_the_way_through_the_vessel(scene: Scene, bifurcation: VesselMap) -> None:
    assert scene.run(0.05).remaining_um == pytest.approx(6000.0)
    target = bifurcation.suggested_areas[0]
    field = GridGraph(bifurcation).field(target)
    scene.law.start(replace(path(), target=target, to_go=field), scene.track(), scene.tip(), scene.now_s)
    left_um = scene.run(0.05).remaining_um
    as_the_crow_flies_um = 10.0 * target.distance_px(VesselPoint(893.0, 1500.0))
    assert as_the_crow_flies_um < left_um < 1.5 * as_the_crow_flies_um
    assert field.at_px(target.x_px, target.y_px) == pytest.approx(0.0, abs=8.0)
    assert math.isinf(field.at_px(0.0, 0.0))


def test_a_task_needs_the_robot_in_sight(scene: Scene) -> None:
    with pytest.raises(ValueError, match="in sight"):
        scene.law.start(path(), replace(scene.track(), vessel=None), scene.tip(), scene.now_s)
