"""The mode table explored exhaustively: every reachable mode, every set of facts, every ask."""

import copy
import itertools
from collections.abc import Callable, Iterator

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.modes import ARMED, LATCHED, Ask, Facts, Mode, ModeMachine, Transition

Make = Callable[[], ModeMachine]
GOOD = Facts(leased=True, hand_fresh=True, clutch_closing=False, at_rest=True, arrived=False)
MOVING = Facts(leased=True, hand_fresh=True, clutch_closing=False, at_rest=False, arrived=False)
WAYS: dict[str, list[tuple[list[Ask], Facts]]] = {
    "DISARMED": [],
    "MANUAL": [([Ask.ARM], GOOD)],
    "AUTO": [([Ask.ARM], GOOD), ([Ask.AUTO], GOOD)],
    "HOLD": [([Ask.ARM], GOOD), ([Ask.HOLD], GOOD)],
    "HOLD, to be disarmed": [([Ask.ARM], GOOD), ([Ask.DISARM], MOVING)],
    "STOP": [([Ask.STOP], GOOD)],
    "FAULT": [([], Facts(True, True, False, True, False, fault="broken"))],
}
"""How to bring a new machine into each state; the state's first word is its mode."""
REMEDIES = ("reset", "close the clutch", "ask for AUTO", "take the lease", "start the hand link", "wait")
"""What an operator can do; one of them ends every reason."""


def facts_of(flags: tuple[bool, ...]) -> Facts:
    leased, fresh, closing, rest, arrived, fault, arm, auto, warning, drives = flags
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
        hand_drives=drives,
    )


ALL_FACTS = [facts_of(flags) for flags in itertools.product([False, True], repeat=10)]


def machine_in(state: str, make: Make = ModeMachine) -> ModeMachine:
    """Bring a new machine into a state."""
    machine = make()
    for asks, facts in WAYS[state]:
        machine.settle(asks, facts)
    return machine


def violations(make: Make = ModeMachine) -> Iterator[str]:
    """Explore a mode machine; yield what breaks an invariant, its name first ("I3: …")."""
    seen: set[Mode] = set()
    for state in WAYS:
        start = machine_in(state, make)
        if start.mode.value != state.split(",")[0]:
            yield f"reach: {state} ended in {start.mode.value}"
            continue
        yield from _disarms(state, start)
        for ask, facts in itertools.product([None, *Ask], ALL_FACTS):
            machine = copy.copy(start)
            refusal = _refusal(machine, ask, facts)
            changes = machine.settle([] if ask is None else [ask], facts)
            seen.add(machine.mode)
            where = f"{state} on {ask} with {facts} → {machine.mode}"
            for broken in _broken(start.mode, ask, facts, machine, changes, refused=refusal is not None):
                yield f"{broken}: {where}"
            if refusal is not None:
                if not refusal.strip():
                    yield f"reason: a refusal without words: {where}"
                other = copy.copy(start)
                if other.settle([], facts) != changes:
                    yield f"refused: what was refused acts all the same: {where}"
    if seen != set(Mode):
        yield f"reach: {set(Mode) - seen} is never reached"


def _refusal(machine: ModeMachine, ask: Ask | None, facts: Facts) -> str | None:
    if ask is None:
        return None
    try:
        machine.check(ask, facts)
    except RefusedError as refused:
        return str(refused)
    return None


def _broken(
    before: Mode,
    ask: Ask | None,
    facts: Facts,
    machine: ModeMachine,
    changes: list[Transition],
    *,
    refused: bool,
) -> Iterator[str]:
    after = machine.mode
    if ask is Ask.STOP:
        if refused or after is not Mode.STOP or len(changes) > 1:
            yield "I3"
    elif before in LATCHED:
        reset = ask is Ask.RESET and facts.leased and not facts.fault
        if after is not before and not (reset and after is Mode.DISARMED):
            yield "I5"
    elif facts.fault and after is not Mode.FAULT:
        yield "I8"
    if after is Mode.AUTO:
        entered = ask is Ask.AUTO and facts.leased and not (before is Mode.MANUAL and facts.hand_drives)
        if facts.auto_refusal or facts.fault or not (before is Mode.AUTO or entered):
            yield "I2"
    takeover = before is Mode.AUTO and facts.clutch_closing and ask in (None, Ask.AUTO) and not facts.fault
    if takeover and after is not (Mode.MANUAL if facts.hand_fresh and facts.leased else Mode.HOLD):
        yield "I4"
    moves = {Mode.MANUAL, Mode.AUTO}
    resumed = before not in moves and after in moves
    acted = ask in (Ask.ARM, Ask.MANUAL, Ask.AUTO) or (before is Mode.HOLD and facts.clutch_closing)
    if resumed and not acted:
        yield "I6"
    if before is Mode.DISARMED and after in ARMED and (ask is not Ask.ARM or facts.arm_refusal):
        yield "I1"
    if after is Mode.MANUAL and not (facts.leased and facts.hand_fresh):
        yield "I7"
    if before not in ARMED and after in ARMED and not facts.leased:
        yield "I7"
    for change in changes:
        told = change.after in LATCHED | {Mode.HOLD}
        if told and not any(remedy in change.reason for remedy in REMEDIES):
            yield "reason"
    if changes and machine.reason != changes[-1].reason:
        yield "reason"


def _disarms(state: str, start: ModeMachine) -> Iterator[str]:
    """Whoever holds the lease comes to DISARMED, at the latest when the tip rests (I9)."""
    for facts in (GOOD, MOVING, Facts(True, False, False, True, False, auto_refusal="guard")):
        machine = copy.copy(start)
        machine.settle([Ask.RESET if machine.mode in LATCHED else Ask.DISARM], facts)
        machine.settle([], GOOD)
        if machine.mode is not Mode.DISARMED:
            yield f"I9: {state} with {facts} ends in {machine.mode}"
