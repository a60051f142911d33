"""The control loop at its edges: hands that come and go, walls, devices that disobey, unlucky moments."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from mrnav_server.autonomy.path import PathPlanner
from mrnav_server.core.errors import DeviceError, RefusedError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.modes import Ask, Mode
from mrnav_server.core.records import MotionCommand
from mrnav_server.core.shaping import Reference
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.autopilot import PathOrder
from tests.loops.conftest import TICK_S, LockStep
from tests.loops.watched import WatchedRig


@pytest.fixture
def watched(bifurcation: VesselMap, planner: PathPlanner) -> WatchedRig:
    rig = WatchedRig(bifurcation, planner)
    rig.advance(0.5)
    return rig


def close_clutch(rig: LockStep) -> None:
    rig.clutch = False
    rig.send_hand()
    rig.clutch = True
    rig.send_hand()


# -- hands that come and go


def test_a_closed_hand_that_comes_back_into_view_wakes_nothing(watched: WatchedRig) -> None:
    watched.ask(Ask.ARM)
    close_clutch(watched)
    assert watched.hand.engaged
    watched.hand_valid = False
    watched.advance_until(Mode.HOLD, 0.2)
    watched.hand_valid = True
    watched.advance(0.5)
    assert watched.is_in(Mode.HOLD)
    close_clutch(watched)
    assert watched.is_in(Mode.MANUAL)


def test_a_closed_hand_that_comes_into_view_takes_over_from_the_policy(watched: WatchedRig) -> None:
    watched.lease.take_console("page", "page", watched.now_s)
    watched.mark()
    watched.ask(Ask.ARM)
    close_clutch(watched)
    watched.hand_valid = False
    watched.advance(0.2)
    watched.lease.hear("page", watched.now_s)
    # The console may begin while the hand is out of view.
    watched.start_auto()
    watched.advance(0.3)
    assert watched.is_in(Mode.AUTO)
    watched.hand_valid = True
    watched.send_hand()
    assert watched.is_in(Mode.MANUAL)


def test_a_hand_that_gives_way_to_another_passes_hold(watched: WatchedRig) -> None:
    watched.mark()
    watched.ask(Ask.ARM)
    watched.start_auto()
    watched.advance(0.5)
    watched.leaves()
    assert watched.sits("second")
    watched.send_as("second", clutch=True)
    assert watched.is_in(Mode.HOLD)
    assert (Mode.AUTO, Mode.HOLD) in watched.transitions


def test_a_link_that_was_silent_for_long_is_the_hand_again_but_holds(watched: WatchedRig) -> None:
    watched.ask(Ask.ARM)
    close_clutch(watched)
    watched.hand_alive = False
    watched.advance(2.5)
    assert not watched.lease.held
    watched.hand_alive = True
    watched._next_hand_s = watched.now_s
    watched.advance(0.2)
    assert watched.lease.is_hand("hand")
    assert watched.is_in(Mode.HOLD)
    close_clutch(watched)
    assert watched.is_in(Mode.MANUAL)


def test_a_link_that_was_silent_for_long_gives_way_to_who_sat_down_meanwhile(watched: WatchedRig) -> None:
    watched.hand_alive = False
    watched.advance(2.5)
    assert watched.sits("second")
    watched.send_as("hand", clutch=True)
    watched.leaves()
    watched.send_as("hand", clutch=True)
    assert not watched.lease.held


def test_a_taken_over_magnet_is_not_called_back(driving: LockStep) -> None:
    shaper = driving.control.drive.shaper
    start, velocity = shaper.position.array(), shaper.velocity_um_per_s
    forward = np.array(velocity) / math.hypot(*velocity)
    close_clutch(driving)
    reached_um = []
    for _ in range(60):
        driving.tick()
        reached_um.append(float((driving.control.drive.shaper.position.array() - start) @ forward))
    assert max(reached_um) > 150.0
    assert max(reached_um) - reached_um[-1] < 20.0


# -- where the tip may be


@pytest.mark.parametrize(
    ("tip", "words"),
    [
        (StagePoint(9120.0, 8950.0, 12_000.0), "below its critical height"),
        (StagePoint(9120.0, 8950.0, 12_750.0), "from where it may move"),
        (StagePoint(19_000.0, 1000.0, 13_100.0), "from where it may move"),
    ],
)
def test_a_tip_that_is_out_of_place_is_not_armed(watched: WatchedRig, tip: StagePoint, words: str) -> None:
    watched.push_tip(tip)
    with pytest.raises(RefusedError, match=words):
        watched.ask(Ask.ARM)


def test_a_tip_that_drifted_during_stop_is_taken_from_where_it_is(watched: WatchedRig) -> None:
    watched.ask(Ask.ARM)
    watched.ask(Ask.STOP)
    watched.push_tip(StagePoint(9120.0, 9950.0, 13_300.0))
    watched.advance(0.05)
    watched.ask(Ask.RESET)
    watched.ask(Ask.ARM)
    drifted = watched.world.tip
    close_clutch(watched)
    watched.advance(0.5)
    assert watched.is_in(Mode.MANUAL)
    assert math.dist(watched.world.tip.array(), drifted.array()) < 1.0


@pytest.mark.parametrize("seed", range(6))
def test_no_sweep_of_the_hand_leaves_the_bounds_or_faults(watched: WatchedRig, seed: int) -> None:
    """The watch checks every command; the walls of the bounds must also not look like a fault."""
    rng = np.random.default_rng(seed)
    watched.ask(Ask.ARM)
    close_clutch(watched)
    for _ in range(12):
        across_m, up_m, along_m = rng.uniform(-0.004, 0.004, 3)
        for _ in range(50):
            watched.hand_x_m += across_m
            watched.hand_y_m += up_m
            watched.hand_z_m += along_m
            watched.tick()
    assert watched.is_in(Mode.MANUAL)
    assert watched.control.drive.counters["clamped"] > 0


# -- numbers and devices


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_velocity_that_is_not_finite_moves_nothing(
    driving: LockStep, bad: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = Reference(driving.control.drive.shaper.position, (bad, 0.0, 0.0), 4500.0)
    monkeypatch.setattr(driving.autopilot, "reference", lambda *_: broken)
    driving.advance(0.4)
    assert driving.control.drive.counters["non_finite"] >= 30
    assert driving.control.drive.shaper.at_rest


def test_a_move_that_fails_is_a_fault_although_the_position_is_known(
    driving: LockStep, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> MotionCommand:
        raise DeviceError("axis 2 does not answer")

    with monkeypatch.context() as patch:
        patch.setattr(driving.manipulator, "move_to", refuse)
        assert driving.advance_until(Mode.FAULT, 1.0) < 2.5 * TICK_S
    assert "axis 2" in driving.control.machine.reason
    driving.ask(Ask.RESET)
    assert driving.is_in(Mode.DISARMED)


def test_a_stuck_manipulator_is_a_fault_and_its_setpoint_stays_near(
    driving: LockStep, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It reports fresh positions and takes every command, but does not move."""
    stuck = driving.world.tip
    sent: list[StagePoint] = []

    def swallow(target: StagePoint, speed_um_per_s: float, now_s: float) -> MotionCommand:
        sent.append(target)
        driving.world.stop()
        return MotionCommand(now_s, target, speed_um_per_s)

    monkeypatch.setattr(driving.manipulator, "move_to", swallow)
    assert driving.advance_until(Mode.FAULT, 1.0) <= 0.3
    assert "does not move although it was told to" in driving.control.machine.reason
    most_um = driving.limits.autonomy_speed_um_per_s * driving.limits.ahead_s
    assert max(math.dist(target.array(), stuck.array()) for target in sent) < 1.1 * most_um
    assert driving.control.drive.counters["held_back"] > 0


# -- moments


def test_hold_at_speed_sends_until_rest_and_nothing_after(driving: LockStep) -> None:
    driving.ask(Ask.HOLD)
    commands = len(driving.commands())
    ticks = 0
    while not driving.control.drive.shaper.at_rest:
        driving.tick()
        ticks += 1
    assert ticks > 5
    assert len(driving.commands()) - commands >= ticks
    driving.advance(0.05)
    rested = len(driving.commands())
    assert math.dist(driving.control.drive.shaper.position.array(), driving.world.tip.array()) < 60.0
    driving.advance(1.0)
    assert len(driving.commands()) == rested
    assert math.dist(driving.control.drive.shaper.position.array(), driving.world.tip.array()) < 1.0


def test_hold_does_not_take_back_a_disarm(driving: LockStep) -> None:
    driving.ask(Ask.DISARM)
    assert driving.is_in(Mode.HOLD)
    driving.ask(Ask.HOLD)
    driving.advance_until(Mode.DISARMED, 0.5)


def test_auto_is_not_asked_twice(driving: LockStep) -> None:
    with pytest.raises(RefusedError, match="hold first"):
        driving.ask(Ask.AUTO)
    assert driving.is_in(Mode.AUTO)


def test_a_task_keeps_its_goal(driving: LockStep) -> None:
    goal = driving.control.scene.area
    with pytest.raises(RefusedError, match="hold first"):
        driving.control.choose_area(None)
    assert driving.control.scene.area == goal


def test_an_area_smaller_than_the_policy_can_aim_ends_in_hold(
    rig: LockStep, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.mark(epsilon_um=50.0)
    rig.ask(Ask.ARM)
    rig.start_auto()
    rig.advance(0.2)
    monkeypatch.setattr(type(rig.autopilot), "at_target", property(lambda _: True))
    rig.tick()
    assert rig.is_in(Mode.HOLD)
    assert "outside the area" in rig.control.machine.reason


def test_a_path_that_cannot_be_planned_ends_in_hold(driving: LockStep) -> None:
    area, robot = driving.control.scene.area, driving.control.scene.robot
    assert area is not None
    assert robot is not None
    order = PathOrder(robot, area.center, back_off=False)
    driving.autopilot.decline(order, "an order of long ago")
    driving.tick()
    assert driving.is_in(Mode.AUTO)
    driving.autopilot.order = order
    driving.autopilot.decline(order, "no path leads there")
    driving.control.step(driving.now_s)
    assert driving.is_in(Mode.HOLD)
    assert driving.control.machine.reason.startswith("no path leads there")


ACTS: dict[str, Callable[[LockStep], None]] = {
    "hold": lambda rig: rig.ask(Ask.HOLD),
    "stop": lambda rig: rig.ask(Ask.STOP),
    "clutch": close_clutch,
    "goal": lambda rig: rig.control.choose_area(None),
}


@pytest.mark.parametrize("act", ACTS)
def test_whatever_somebody_does_is_a_new_generation(rig: LockStep, act: str) -> None:
    rig.mark()
    rig.ask(Ask.ARM)
    generation = rig.control.generation
    rig.advance(0.2)
    assert rig.control.generation == generation
    ACTS[act](rig)
    assert rig.control.generation > generation
