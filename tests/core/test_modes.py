"""The mode table, exhaustively: every mode, every set of facts, every ask."""

import itertools

import pytest

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.modes import ARMED, LATCHED, Ask, Facts, Mode, ModeMachine, Severity

FLAGS = list(itertools.product([False, True], repeat=9))
GOOD = Facts(leased=True, hand_fresh=True, clutch_closing=False, at_rest=True, arrived=False)


def facts_of(flags: tuple[bool, ...]) -> Facts:
    leased, fresh, closing, rest, arrived, fault, arm, auto, warning = flags
    return Facts(
        leased=leased,
        hand_fresh=fresh,
        clutch_closing=closing,
        at_rest=rest,
        arrived=arrived,
        fault="broken" if fault else "",
        arm_refusal="not ready" if arm else "",
        auto_refusal="guard" if auto else "",
        warning="look" if warning else "",
    )


def machine_in(mode: Mode) -> ModeMachine:
    machine = ModeMachine()
    steps = {
        Mode.DISARMED: [],
        Mode.MANUAL: [Ask.ARM],
        Mode.AUTO: [Ask.ARM, Ask.AUTO],
        Mode.HOLD: [Ask.ARM, Ask.HOLD],
        Mode.STOP: [Ask.STOP],
        Mode.FAULT: [],
    }[mode]
    for ask in steps:
        machine.settle([ask], GOOD)
    if mode is Mode.FAULT:
        machine.settle([], Facts(True, True, False, True, False, fault="broken"))
    assert machine.mode is mode
    return machine


CASES = [(mode, ask, flags) for mode in Mode for ask in [None, *Ask] for flags in FLAGS]


def test_every_cell_keeps_the_invariants() -> None:
    seen: set[tuple[Mode, Mode]] = set()
    for mode, ask, flags in CASES:
        machine, facts = machine_in(mode), facts_of(flags)
        refused = False
        if ask is not None:
            try:
                machine.check(ask, facts)
            except RefusedError:
                refused = True
        changes = machine.settle([] if ask is None else [ask], facts)
        after = machine.mode
        seen.add((mode, after))
        where = (mode, ask, facts, after)
        if ask is Ask.STOP:
            assert after is Mode.STOP, where
            assert not refused, where
            assert len(changes) <= 1, where
        elif mode in LATCHED:
            assert after in (mode, Mode.DISARMED), where
            assert after is mode or (ask is Ask.RESET and facts.leased and not facts.fault), where
        elif facts.fault:
            assert after is Mode.FAULT, where
        if after is Mode.AUTO:
            assert not facts.auto_refusal, where
            assert not facts.fault, where
            assert mode is Mode.AUTO or (ask is Ask.AUTO and facts.leased), where
        if after is Mode.MANUAL:
            assert facts.leased, where
            assert facts.hand_fresh, where
        if mode is Mode.AUTO and ask in (None, Ask.AUTO) and facts.clutch_closing and not facts.fault:
            wanted = Mode.MANUAL if facts.hand_fresh and facts.leased else Mode.HOLD
            assert after is wanted, where
        if mode is Mode.HOLD and ask is None and after in (Mode.MANUAL, Mode.AUTO):
            assert facts.clutch_closing, where
        if mode is Mode.DISARMED and after in ARMED:
            assert ask is Ask.ARM, where
            assert facts.leased, where
            assert not facts.arm_refusal, where
        if refused:
            others = ModeMachine.settle(twin := machine_in(mode), [], facts)
            assert twin.mode is after, where
            assert [c.after for c in others] == [c.after for c in changes], where
    assert {before for before, _ in seen} == set(Mode)
    assert {after for _, after in seen} == set(Mode)


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
