"""The mode table, exhaustively, and case by case."""

import pytest

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.modes import LATCHED, Ask, Facts, Mode, ModeMachine, Severity
from tests.core.mode_table import GOOD, violations
from tests.core.mode_table import machine_in as reached


def machine_in(mode: Mode) -> ModeMachine:
    return reached(mode.value)


def test_every_cell_keeps_the_invariants() -> None:
    assert list(violations()) == []


def test_the_policy_does_not_start_against_a_hand_that_drives() -> None:
    drives = Facts(True, True, False, True, False, hand_drives=True)
    with pytest.raises(RefusedError, match="open the clutch first"):
        machine_in(Mode.MANUAL).check(Ask.AUTO, drives)
    # After a hand-over the clutch is open: the next task begins from MANUAL.
    machine = machine_in(Mode.AUTO)
    machine.settle([], Facts(True, True, False, False, arrived=True))
    machine.settle([Ask.AUTO], GOOD)
    assert machine.mode is Mode.AUTO


@pytest.mark.parametrize("mode", Mode)
def test_disarmed_is_reachable_from_everywhere(mode: Mode) -> None:
    machine = machine_in(mode)
    machine.settle([Ask.RESET if mode in LATCHED else Ask.DISARM], GOOD)
    assert machine.mode is Mode.DISARMED


def test_disarming_while_moving_comes_to_rest_first() -> None:
    machine = machine_in(Mode.AUTO)
    moving = Facts(True, True, False, at_rest=False, arrived=False)
    modes = []
    for asks, facts in (([Ask.DISARM], moving), ([], moving), ([], GOOD)):
        machine.settle(asks, facts)
        modes.append(machine.mode)
    assert modes == [Mode.HOLD, Mode.HOLD, Mode.DISARMED]


def test_hold_neither_takes_back_a_disarm_nor_hides_why_the_rig_holds() -> None:
    machine = machine_in(Mode.AUTO)
    moving = Facts(True, True, False, at_rest=False, arrived=False)
    machine.settle([Ask.DISARM], moving)
    reason = machine.reason
    machine.settle([Ask.HOLD], moving)
    assert (machine.mode, machine.reason) == (Mode.HOLD, reason)
    machine.settle([], GOOD)
    assert machine.mode is Mode.DISARMED


def test_the_policy_is_not_asked_to_drive_twice() -> None:
    with pytest.raises(RefusedError, match="hold first"):
        machine_in(Mode.AUTO).check(Ask.AUTO, GOOD)


def test_arrival_hands_over_and_without_a_hand_holds() -> None:
    machine = machine_in(Mode.AUTO)
    changes = machine.settle(
        [], Facts(True, hand_fresh=True, clutch_closing=False, at_rest=False, arrived=True)
    )
    assert [c.after for c in changes] == [Mode.MANUAL]
    machine = machine_in(Mode.AUTO)
    changes = machine.settle(
        [], Facts(True, hand_fresh=False, clutch_closing=False, at_rest=False, arrived=True)
    )
    assert [c.after for c in changes] == [Mode.MANUAL, Mode.HOLD]


def test_refusals_say_why() -> None:
    with pytest.raises(RefusedError, match="take the lease"):
        ModeMachine().check(Ask.ARM, Facts(False, True, False, True, False))
    with pytest.raises(RefusedError, match="arm first"):
        ModeMachine().check(Ask.AUTO, GOOD)
    with pytest.raises(RefusedError, match="the robot is not seen"):
        machine_in(Mode.MANUAL).check(
            Ask.AUTO, Facts(True, True, False, True, False, auto_refusal="the robot is not seen")
        )


def test_the_worst_severity_wins() -> None:
    warned = Facts(True, True, False, True, False, warning="look")
    assert machine_in(Mode.MANUAL).severity(warned) is Severity.WARN
    assert machine_in(Mode.HOLD).severity(warned) is Severity.HOLD
    assert machine_in(Mode.FAULT).severity(warned) is Severity.FAULT
    assert machine_in(Mode.STOP).severity(warned) is Severity.STOP
