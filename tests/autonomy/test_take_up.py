"""How the robot is set in motion, and what that tells."""

import itertools
import math

import pytest

from mrnav_server.autonomy.follower import Follower
from mrnav_server.autonomy.following import FollowerConfig, FollowerStatus
from mrnav_server.autonomy.observer import Coupling, ObserverConfig
from mrnav_server.autonomy.plane import Plane
from mrnav_server.autonomy.watch import RobotWatch
from mrnav_server.core.vessel import VesselMap
from tests.autonomy.test_follower_decisions import LEAD_UM, PARALLEL, Stage, upward

MUCH = 100


def learnt(stage: Stage, vessel: VesselMap, looks: int) -> Stage:
    coupling = Coupling(lead_um=LEAD_UM, looks=looks)
    stage.follower = Follower(FollowerConfig(), vessel, PARALLEL, coupling)
    return stage


@pytest.fixture
def stage(bifurcation: VesselMap) -> Stage:
    return Stage(bifurcation)


@pytest.mark.parametrize(("looks", "fast", "slow"), [(0, 1200.0, 1200.0), (MUCH, 2500.0, 600.0)])
def test_nobody_is_pulled_fast_before_much_was_learnt(
    stage: Stage, bifurcation: VesselMap, looks: int, fast: float, slow: float
) -> None:
    learnt(stage, bifurcation, looks).leash_um = 700.0
    stage.begin(upward())
    stage.run(3.0, until=FollowerStatus.FOLLOWING)
    speeds = [math.hypot(*w.velocity_um_per_s) for w in stage.wishes if w.status is FollowerStatus.TAKE_UP]
    assert max(speeds) == pytest.approx(fast)
    assert speeds[-1] == pytest.approx(slow)


def test_a_break_away_tells_the_offset_error_across_it(bifurcation: VesselMap) -> None:
    watch = RobotWatch(bifurcation, Plane(PARALLEL), ObserverConfig(), Coupling((30.0, 0.0), 400.0, 5))
    watch.learn_breakaway((300.0, -200.0), (40.0, 0.0))
    assert watch.coupling == Coupling((30.0, -200.0), 400.0, 5)
    watch.learn_breakaway((300.0, -200.0), (0.0, 40.0))
    assert watch.coupling.offset_um == pytest.approx((300.0, -200.0))
    watch.learn_breakaway((5000.0, -200.0), (0.0, 40.0))
    assert math.hypot(*watch.coupling.offset_um) == pytest.approx(ObserverConfig().offset_limit_um)


def test_one_who_knows_the_offset_keeps_it_at_break_away(stage: Stage, bifurcation: VesselMap) -> None:
    learnt(stage, bifurcation, MUCH)
    stage.hold_um = (stage.hold_um[0] + 150.0, stage.hold_um[1])
    stage.begin(upward())
    stage.run(3.0, until=FollowerStatus.FOLLOWING)
    assert stage.follower.coupling.offset_um == (0.0, 0.0)


def test_the_magnet_does_not_leap_after_a_robot_that_slips(stage: Stage, bifurcation: VesselMap) -> None:
    learnt(stage, bifurcation, MUCH)
    stage.begin(upward())
    began_um = stage.robot_um
    while stage.robot_um == began_um:
        stage.run(0.01)
    stage.leash_um -= 160.0
    before = len(stage.wishes)
    stage.run(0.3)
    tips = [w.tip_um for w in stage.wishes[before - 1 :]]
    steps_um = [math.dist(a, b) for a, b in itertools.pairwise(tips)]
    assert max(steps_um) < 45.0, "faster than the limit of autonomy"


def test_the_estimate_of_the_hand_over_counts_the_take_up(stage: Stage) -> None:
    stage.begin(upward())
    wish = stage.run(0.01)
    first_s, began_s = wish.handover_s, stage.now_s
    stage.run(6.0, until=FollowerStatus.SETTLING)
    assert stage.now_s - began_s == pytest.approx(first_s, abs=0.25)


def test_in_a_small_area_the_robot_must_rest_nearer() -> None:
    config = FollowerConfig()
    assert config.arrival_within_um(500.0) == 100.0
    assert config.arrival_within_um(50.0) == pytest.approx(47.5)


@pytest.mark.parametrize("epsilon_um", [500.0, 60.0])
def test_a_robot_that_rests_outside_a_small_area_has_not_arrived(stage: Stage, epsilon_um: float) -> None:
    stage.glued = True
    stage.robot_um = stage.hold_um = (8930.0, 9000.0 + 70.0)
    stage.follower.start(upward(), stage.seen(), stage.tip(), stage.now_s, 0.0, epsilon_um)
    assert (stage.run(0.5).status is FollowerStatus.ARRIVED) == (epsilon_um == 500.0)
