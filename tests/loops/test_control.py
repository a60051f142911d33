"""The control loop as a whole, in simulated time: hand-over, take-over, faults, and what never moves."""

import math

import pytest

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.modes import Ask, Mode
from mrnav_server.core.shaping import Reference
from tests.loops.conftest import LockStep

TICK_S = 0.01


def test_autonomy_arrives_and_hands_over_without_touching(rig: LockStep) -> None:
    rig.mark()
    rig.ask(Ask.ARM)
    assert rig.is_in(Mode.MANUAL)
    rig.start_auto()
    rig.advance_until(Mode.MANUAL, 10.0)
    assert rig.changes == ["MANUAL", "AUTO", "MANUAL"]
    rig.advance(1.0)
    assert rig.control.scene.distance_um is not None
    assert rig.control.scene.distance_um < 600.0
    assert rig.world.collisions == 0
    assert rig.control.drive.shaper.at_rest


def test_every_setpoint_keeps_the_bounds_through_a_whole_task(rig: LockStep) -> None:
    rig.mark()
    rig.ask(Ask.ARM)
    rig.start_auto()
    before = (0.0, 0.0, 0.0)
    while rig.is_in(Mode.AUTO):
        rig.tick()
        after = rig.control.drive.shaper.acceleration_um_per_s2
        # Each tick holds up to two steps: the beat and a hand sample.
        assert math.dist(after, before) <= rig.limits.jerk_um_per_s3 * TICK_S * 1.001
        assert math.hypot(*after) <= rig.limits.acceleration_um_per_s2 * 1.001
        assert rig.control.drive.shaper.speed_um_per_s <= rig.limits.autonomy_speed_um_per_s * 1.001
        before = after
    assert rig.commands()
    for command in rig.commands():
        assert command["ahead_ms"] <= 100.0
        assert all(0.0 <= value <= 20_000.0 for value in command["target_um"])


def test_closing_the_clutch_takes_over_in_the_same_step(driving: LockStep) -> None:
    before, velocity = driving.control.drive.shaper.position, driving.control.drive.shaper.velocity_um_per_s
    driving.clutch = True
    driving.send_hand()
    assert driving.is_in(Mode.MANUAL)
    # The setpoint on entering MANUAL is the setpoint before: position and velocity are continuous.
    assert driving.control.drive.shaper.position == before
    assert driving.control.drive.shaper.velocity_um_per_s == velocity
    mark = len(driving.lines)
    driving.advance(0.2)
    modes = {data["mode"] for _, topic, data in driving.lines[mark:] if topic == "command"}
    assert modes == {"MANUAL"}


def test_the_hand_moves_the_tip_only_while_the_clutch_is_closed(rig: LockStep) -> None:
    rig.ask(Ask.ARM)
    rig.hand_x_m = 0.05
    rig.advance(0.5)
    assert rig.commands() == []
    rig.clutch = True
    rig.advance(0.1)
    start_um = rig.world.tip.x_um
    for _ in range(50):
        rig.hand_x_m += 0.0004
        rig.tick()
    rig.advance(0.3)
    assert rig.world.tip.x_um - start_um == pytest.approx(0.04 * 20_000, abs=40.0)
    rig.clutch = False
    rig.advance(0.3)
    rested = rig.world.tip
    rig.hand_x_m += 0.05
    rig.advance(0.5)
    assert math.dist(rig.world.tip.array(), rested.array()) < 0.01


@pytest.mark.parametrize("autonomous", [False, True])
def test_a_silent_hand_holds_within_its_deadline(rig: LockStep, autonomous: bool) -> None:
    rig.mark()
    rig.ask(Ask.ARM)
    if autonomous:
        rig.start_auto()
        rig.advance(0.8)
    else:
        rig.clutch = True
        rig.advance(0.1)
    rig.hand_alive = False
    assert rig.advance_until(Mode.HOLD, 1.0) <= 0.1 + 2 * TICK_S
    reason = rig.control.machine.reason
    assert ("nobody supervises" if autonomous else "silent") in reason
    rig.advance(0.3)
    rested, commands = rig.control.drive.shaper.position, len(rig.commands())
    rig.hand_alive = True
    rig.advance(0.5)
    # The hand is back with its clutch still closed: nothing resumes by itself.
    assert rig.is_in(Mode.HOLD)
    assert rig.control.drive.shaper.position == rested
    assert len(rig.commands()) == commands


def test_a_console_supervises_alone_but_does_not_stand_in_for_a_lost_hand(rig: LockStep) -> None:
    rig.lease.take_console("page", "page", rig.now_s)
    rig.mark()
    rig.ask(Ask.ARM)
    rig.start_auto()
    rig.lease.give_back("hand")
    rig.hand_alive = False
    rig.tick()
    assert rig.is_in(Mode.HOLD)
    rig.start_auto()
    for _ in range(30):
        rig.lease.hear("page", rig.now_s)
        rig.tick()
    assert rig.is_in(Mode.AUTO)
    assert rig.advance_until(Mode.HOLD, 2.0) <= 0.5 + 2 * TICK_S


def test_after_a_hold_the_clutch_must_be_closed_anew(rig: LockStep) -> None:
    rig.ask(Ask.ARM)
    rig.clutch = True
    rig.advance(0.1)
    rig.ask(Ask.HOLD)
    rig.advance(0.3)
    assert rig.is_in(Mode.HOLD)
    rig.clutch = False
    rig.advance(0.1)
    rig.clutch = True
    rig.advance(0.1)
    assert rig.is_in(Mode.MANUAL)


def test_a_camera_that_stops_holds_autonomy(driving: LockStep) -> None:
    driving.camera_alive = False
    assert driving.advance_until(Mode.HOLD, 1.0) <= 0.1 + 2 * TICK_S
    assert "last seen" in driving.control.machine.reason


def test_a_dropped_robot_holds_autonomy(driving: LockStep) -> None:
    driving.world.drop_robot()
    driving.advance_until(Mode.HOLD, 3.0)
    assert driving.control.machine.reason


def test_stop_is_one_step_and_latches(driving: LockStep) -> None:
    driving.ask(Ask.STOP)
    assert driving.is_in(Mode.STOP)
    commands = len(driving.commands())
    tip = driving.world.tip
    driving.clutch = True
    driving.advance(1.0)
    assert driving.is_in(Mode.STOP)
    assert len(driving.commands()) == commands
    assert math.dist(tip.array(), driving.world.tip.array()) < 1.0
    driving.ask(Ask.RESET)
    assert driving.is_in(Mode.DISARMED)


def test_a_failed_manipulator_is_a_fault_until_it_works_again(driving: LockStep) -> None:
    driving.manipulator.fail()
    driving.tick()
    assert driving.is_in(Mode.FAULT)
    with pytest.raises(RefusedError, match="manipulator"):
        driving.ask(Ask.RESET)
    driving.manipulator.recover()
    driving.ask(Ask.RESET)
    assert driving.is_in(Mode.DISARMED)


def test_a_mute_manipulator_is_a_fault_within_200_ms(driving: LockStep) -> None:
    driving.manipulator.mute()
    assert driving.advance_until(Mode.FAULT, 1.0) <= 0.2 + TICK_S


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_moves_nothing_and_is_counted(
    driving: LockStep, bad: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = Reference(StagePoint(bad, 0.0, 0.0), (0.0, 0.0, 0.0), 4500.0)
    monkeypatch.setattr(driving.autopilot, "reference", lambda *_: broken)
    driving.advance(0.4)
    assert driving.control.drive.counters["non_finite"] >= 30
    assert driving.control.drive.shaper.at_rest
    for command in driving.commands():
        assert all(map(math.isfinite, command["target_um"]))


def test_without_a_lease_nothing_starts(rig: LockStep) -> None:
    rig.lease.give_back("hand")
    with pytest.raises(RefusedError, match="lease"):
        rig.ask(Ask.ARM)


def test_a_lease_that_ends_holds(rig: LockStep) -> None:
    rig.ask(Ask.ARM)
    rig.lease.give_back("hand")
    rig.tick()
    assert rig.is_in(Mode.HOLD)
    assert "lease" in rig.control.machine.reason


def test_a_policy_that_was_not_verified_leaves_manual_working(rig: LockStep) -> None:
    rig.autopilot.refusal = "the policy cannot be used: its sha256 is wrong"
    rig.mark()
    rig.ask(Ask.ARM)
    with pytest.raises(RefusedError, match="sha256"):
        rig.ask(Ask.AUTO)
    rig.clutch = True
    rig.advance(0.1)
    rig.hand_x_m += 0.005
    rig.advance(0.3)
    assert rig.is_in(Mode.MANUAL)
    assert rig.commands()


def test_a_recorder_that_fails_holds_autonomy(driving: LockStep) -> None:
    driving.control.surroundings.recorder_fault = lambda: "the trial's log cannot be written: disk full"
    driving.tick()
    assert driving.is_in(Mode.HOLD)
    assert "disk full" in driving.control.machine.reason
