"""The rig's modes as one table, and the one function that settles which is in force (docs/safety.md).

Nothing else in the package assigns a mode. Reasons are sentences for the operator; "" means no objection.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum

from mrnav_server.core.errors import RefusedError


class Mode(Enum):
    """Who may move the magnet, and how."""

    DISARMED = "DISARMED"
    """Nobody; no motion command is sent."""
    MANUAL = "MANUAL"
    """The operator's hand while the clutch is closed; nothing while it is open."""
    AUTO = "AUTO"
    """The policy."""
    HOLD = "HOLD"
    """Nobody: jerk-limited stop, then rest, until the operator acts."""
    FAULT = "FAULT"
    """Nobody; latched until reset."""
    STOP = "STOP"
    """Nobody; the device was stopped; latched until reset."""


class Severity(IntEnum):
    """How bad the present state is; a larger one wins."""

    NONE = 0
    WARN = 1
    HOLD = 2
    FAULT = 3
    STOP = 4


class Ask(Enum):
    """What a client may ask for."""

    ARM = "arm"
    DISARM = "disarm"
    MANUAL = "manual"
    AUTO = "auto"
    HOLD = "hold"
    STOP = "stop"
    RESET = "reset"


ARMED = frozenset({Mode.MANUAL, Mode.AUTO, Mode.HOLD})
LATCHED = frozenset({Mode.FAULT, Mode.STOP})

_MAY_ASK: dict[Ask, frozenset[Mode]] = {
    Ask.ARM: frozenset({Mode.DISARMED}),
    Ask.DISARM: ARMED | {Mode.DISARMED},
    Ask.MANUAL: ARMED,
    Ask.AUTO: ARMED - {Mode.AUTO},
    Ask.HOLD: ARMED,
    Ask.STOP: frozenset(Mode),
    Ask.RESET: LATCHED,
}


_GO_ON = "close the clutch anew or ask for AUTO to go on"


@dataclass(frozen=True, slots=True)
class Facts:
    """What is true at one control step.

    Attributes:
        leased: Somebody controls the rig.
        hand_fresh: The holder's hand was heard within its deadline.
        clutch_closing: The holder closed the clutch since the last step.
        at_rest: The setpoint stands still.
        arrived: The task's critical area is reached.
        fault: Why the rig must not move at all, else "".
        arm_refusal: Why the rig must not be armed, else "".
        auto_refusal: Which guard of AUTO is not satisfied, else "".
        warning: What the operator should know, else "".
        hand_drives: The holder's clutch is closed and the hand moves the magnet.
    """

    leased: bool
    hand_fresh: bool
    clutch_closing: bool
    at_rest: bool
    arrived: bool
    fault: str = ""
    arm_refusal: str = ""
    auto_refusal: str = ""
    warning: str = ""
    hand_drives: bool = False


@dataclass(frozen=True, slots=True)
class Transition:
    """One change of mode and why."""

    before: Mode
    after: Mode
    reason: str


class ModeMachine:
    """The mode in force, why, and the rules that change it."""

    def __init__(self) -> None:
        self._mode = Mode.DISARMED
        self._reason = ""
        self._disarming = False

    @property
    def mode(self) -> Mode:
        """The mode in force."""
        return self._mode

    @property
    def reason(self) -> str:
        """Why the rig is held, or "" when nothing is wrong."""
        return self._reason

    def severity(self, facts: Facts) -> Severity:
        """Return the worst severity in force."""
        by_mode = {Mode.STOP: Severity.STOP, Mode.FAULT: Severity.FAULT, Mode.HOLD: Severity.HOLD}
        return by_mode.get(self._mode, Severity.WARN if facts.warning else Severity.NONE)

    def check(self, ask: Ask, facts: Facts) -> None:
        """Check whether an ask would be granted now.

        Raises:
            RefusedError: If not, with the reason. STOP is never refused.
        """
        if ask is Ask.STOP:
            return
        if self._mode not in _MAY_ASK[ask]:
            raise RefusedError(
                "wrong_mode", f"{ask.value} is not possible in {self._mode.value}: {_remedy(self._mode)}"
            )
        if ask in (Ask.ARM, Ask.MANUAL, Ask.AUTO, Ask.RESET) and not facts.leased:
            raise RefusedError("no_lease", "nobody controls the rig: take the lease first")
        driving = self._mode is Mode.MANUAL and facts.hand_drives
        refusals = {
            Ask.ARM: facts.fault or facts.arm_refusal,
            Ask.AUTO: facts.fault
            or ("your hand drives: open the clutch first" if driving else "")
            or facts.auto_refusal,
            Ask.RESET: facts.fault,
            Ask.MANUAL: "" if facts.hand_fresh else "no hand is heard: start the hand link",
        }
        if refusals.get(ask):
            raise RefusedError("guard", refusals[ask])

    def settle(self, asks: Sequence[Ask], facts: Facts) -> list[Transition]:
        """Settle the mode from what was asked and what is true.

        Asks that :meth:`check` would refuse are ignored here: facts may have changed since it was called.

        Args:
            asks: In the order in which they came.
            facts: What is true now.

        Returns:
            The changes, in order; empty when the mode stays.
        """
        changes: list[Transition] = []
        if Ask.STOP in asks:
            self._enter(Mode.STOP, "STOP was pressed: reset when it is safe to go on", changes)
            return changes
        if facts.fault and self._mode not in LATCHED:
            self._enter(Mode.FAULT, f"{facts.fault}; reset once the cause is gone", changes)
            return changes
        for ask in asks:
            try:
                self.check(ask, facts)
            except RefusedError:
                continue
            self._grant(ask, facts, changes)
        self._follow_facts(facts, changes)
        return changes

    def _grant(self, ask: Ask, facts: Facts, changes: list[Transition]) -> None:
        if ask is Ask.ARM:
            if facts.hand_fresh:
                self._enter(Mode.MANUAL, "", changes)
            else:
                self._enter(
                    Mode.HOLD, "armed, but no hand is heard yet: start the hand link or ask for AUTO", changes
                )
        elif ask is Ask.DISARM:
            self._disarm(facts, changes)
        elif ask is Ask.MANUAL:
            self._enter(Mode.MANUAL, "", changes)
        elif ask is Ask.AUTO:
            self._enter(Mode.AUTO, "", changes)
        elif ask is Ask.HOLD and self._mode is not Mode.HOLD:
            # A rig that holds already keeps its reason, and goes on to disarm if that was asked.
            self._enter(Mode.HOLD, f"hold was asked: {_GO_ON}", changes)
        elif ask is Ask.RESET:
            self._enter(Mode.DISARMED, "", changes)

    def _follow_facts(self, facts: Facts, changes: list[Transition]) -> None:
        if self._mode is Mode.AUTO and facts.clutch_closing:
            if facts.hand_fresh:
                self._enter(Mode.MANUAL, "", changes)
            else:
                self._enter(
                    Mode.HOLD, "takeover by a hand that is no longer heard: close the clutch again", changes
                )
        elif self._mode is Mode.AUTO and facts.auto_refusal:
            self._enter(Mode.HOLD, f"{facts.auto_refusal}; {_GO_ON}", changes)
        elif self._mode is Mode.AUTO and facts.arrived:
            self._enter(Mode.MANUAL, "", changes)
        elif self._mode is Mode.HOLD and self._disarming:
            self._disarm(facts, changes)
        elif self._mode is Mode.HOLD and facts.clutch_closing and facts.hand_fresh and facts.leased:
            self._enter(Mode.MANUAL, "", changes)
        if self._mode is Mode.MANUAL and not facts.leased:
            self._enter(Mode.HOLD, "nobody controls the rig any more: take the lease to go on", changes)
        elif self._mode is Mode.MANUAL and not facts.hand_fresh:
            self._enter(Mode.HOLD, "the hand is silent: close the clutch again to go on", changes)

    def _disarm(self, facts: Facts, changes: list[Transition]) -> None:
        if self._mode in ARMED and not facts.at_rest:
            self._enter(Mode.HOLD, "coming to rest, then disarmed: wait", changes)
            self._disarming = True
        else:
            self._enter(Mode.DISARMED, "", changes)

    def _enter(self, mode: Mode, reason: str, changes: list[Transition]) -> None:
        self._disarming = False
        if mode is not self._mode:
            changes.append(Transition(self._mode, mode, reason))
        self._mode, self._reason = mode, reason


def _remedy(mode: Mode) -> str:
    return {
        Mode.DISARMED: "arm first",
        Mode.AUTO: "hold first",
        Mode.FAULT: "reset first, once the cause is gone",
        Mode.STOP: "reset first",
    }.get(mode, "disarm first")
