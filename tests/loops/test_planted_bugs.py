"""Bugs planted on purpose: for each invariant, a rig or a table that breaks it is caught, by name."""

import contextlib
import dataclasses
from collections.abc import Callable, Sequence

import pytest

from mrnav_server.app.hand_seat import HandSeat
from mrnav_server.autonomy.path import PathPlanner
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.hand import HandControl
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.lease import Lease
from mrnav_server.core.modes import LATCHED, Ask, Facts, Mode, ModeMachine, Transition
from mrnav_server.core.shaping import Reference, Shaper
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops import drive as drive_module
from mrnav_server.loops.control import ControlLoop
from mrnav_server.loops.drive import Drive
from tests.core.mode_table import violations
from tests.loops.test_control_stateful import CAUSES, bring_to, close_clutch
from tests.loops.watched import WatchedRig, granted

Plant = Callable[[pytest.MonkeyPatch], None]

# -- the table ---------------------------------------------------------------------------------------------


class ArmsAnyhow(ModeMachine):
    """I1: arms although the tip is not where it may move."""

    def check(self, ask: Ask, facts: Facts) -> None:
        super().check(ask, dataclasses.replace(facts, arm_refusal=""))


class IgnoresGuards(ModeMachine):
    """I2: AUTO although a guard refuses."""

    def check(self, ask: Ask, facts: Facts) -> None:
        super().check(ask, dataclasses.replace(facts, auto_refusal=""))

    def _follow_facts(self, facts: Facts, changes: list[Transition]) -> None:
        super()._follow_facts(dataclasses.replace(facts, auto_refusal=""), changes)


class StopsInTwo(ModeMachine):
    """I3: STOP comes after a HOLD."""

    def settle(self, asks: Sequence[Ask], facts: Facts) -> list[Transition]:
        if Ask.STOP in asks and self._mode is Mode.AUTO:
            return super().settle([Ask.HOLD], facts)
        return super().settle(asks, facts)


class RefusesTakeover(ModeMachine):
    """I4: the policy goes on while the operator closes the clutch."""

    def _follow_facts(self, facts: Facts, changes: list[Transition]) -> None:
        if self._mode is Mode.AUTO:
            facts = dataclasses.replace(facts, clutch_closing=False)
        super()._follow_facts(facts, changes)


class ArmsOutOfLatches(ModeMachine):
    """I5: a latch is left by arming."""

    def check(self, ask: Ask, facts: Facts) -> None:
        if ask is not Ask.ARM or self._mode not in LATCHED:
            super().check(ask, facts)


class Resumes(ModeMachine):
    """I6: a hand that is heard again goes on by itself."""

    def settle(self, asks: Sequence[Ask], facts: Facts) -> list[Transition]:
        changes = super().settle(asks, facts)
        if not asks and self._mode is Mode.HOLD and facts.hand_fresh and facts.leased:
            self._enter(Mode.MANUAL, "", changes)
        return changes


class NeedsNoLease(ModeMachine):
    """I7: whoever asks is obeyed."""

    def settle(self, asks: Sequence[Ask], facts: Facts) -> list[Transition]:
        return super().settle(asks, dataclasses.replace(facts, leased=True))


class MovesWhileBroken(ModeMachine):
    """I8: a manipulator's fault is not looked at."""

    def settle(self, asks: Sequence[Ask], facts: Facts) -> list[Transition]:
        return super().settle(asks, dataclasses.replace(facts, fault=""))


class NeverDisarms(ModeMachine):
    """I9: whoever disarms in motion is held for ever."""

    def _disarm(self, facts: Facts, changes: list[Transition]) -> None:
        super()._disarm(facts, changes)
        self._disarming = False


class SaysNothing(ModeMachine):
    """The operator is not told why the rig holds."""

    def _enter(self, mode: Mode, reason: str, changes: list[Transition]) -> None:
        super()._enter(mode, "" if mode is Mode.HOLD else reason, changes)


@pytest.mark.parametrize(
    ("bug", "name"),
    [
        (ArmsAnyhow, "I1"),
        (IgnoresGuards, "I2"),
        (StopsInTwo, "I3"),
        (RefusesTakeover, "I4"),
        (ArmsOutOfLatches, "I5"),
        (Resumes, "I6"),
        (NeedsNoLease, "I7"),
        (MovesWhileBroken, "I8"),
        (NeverDisarms, "I9"),
        (SaysNothing, "reason"),
    ],
)
def test_the_exploration_catches_a_bug_in_the_table(bug: type[ModeMachine], name: str) -> None:
    assert any(broken.startswith(f"{name}:") for broken in violations(bug))


# -- the running rig ---------------------------------------------------------------------------------------


def moves_in_hold(patch: pytest.MonkeyPatch) -> None:
    follow = Drive.follow

    def wrong(self: Drive, dt_s, reference, tip, now_s, mode):  # type: ignore[no-untyped-def]
        if mode is Mode.HOLD:
            at = self.shaper.position
            reference = Reference(StagePoint(at.x_um + 500.0, at.y_um, at.z_um), (0.0, 0.0, 0.0), 3000.0)
        return follow(self, dt_s, reference, tip, now_s, mode)

    patch.setattr(Drive, "follow", wrong)


def auto_ignores_the_tracker(patch: pytest.MonkeyPatch) -> None:
    patch.setattr("mrnav_server.loops.control.track_refusal", lambda *_: "")


def machine(bug: type[ModeMachine]) -> Plant:
    return lambda patch: patch.setattr("mrnav_server.loops.control.ModeMachine", bug)


def a_stranger_moves(patch: pytest.MonkeyPatch) -> None:
    def wrong(self: HandSeat, sample: HandSample) -> None:
        self._hand.on_sample(sample)
        self._step(sample.received_s)

    patch.setattr(HandSeat, "take", wrong)


def a_seat_is_taken_from_whoever_moves(patch: pytest.MonkeyPatch) -> None:
    def wrong(self: Lease, session: str, client: str, now_s: float) -> None:
        self._hand = None
        self._hand = self._taken(None, session, client, now_s)

    patch.setattr(Lease, "take_hand", wrong)


def the_hand_engages_itself(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(HandControl, "take_closing", lambda self, **_: self._clutch)


def disarm_only_holds(patch: pytest.MonkeyPatch) -> None:
    grant = ModeMachine._grant

    def wrong(self: ModeMachine, ask: Ask, facts: Facts, changes: list[Transition]) -> None:
        holds = ask is Ask.DISARM and self._mode is not Mode.DISARMED
        grant(self, Ask.HOLD if holds else ask, facts, changes)

    patch.setattr(ModeMachine, "_grant", wrong)


def shaper_leaps(velocity: float, acceleration: float) -> Plant:
    """Give the shaper's state a jolt at every step in which it moves."""

    def plant(patch: pytest.MonkeyPatch) -> None:
        step = Shaper.step

        def wrong(self: Shaper, dt_s: float, reference: Reference | None) -> StagePoint:
            at = step(self, dt_s, reference)
            if not self.at_rest:
                self._v[0] += velocity
                self._a[0] += acceleration
            return at

        patch.setattr(Shaper, "step", wrong)

    return plant


def nothing_is_out_of_bounds(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(drive_module, "allowed_target", lambda point, *_: point)


def manual_begins_elsewhere(patch: pytest.MonkeyPatch) -> None:
    change = ControlLoop._on_change

    def wrong(self: ControlLoop, told: Transition, now_s: float) -> None:
        change(self, told, now_s)
        if told.before is Mode.AUTO and told.after is Mode.MANUAL:
            self.drive.shaper._p[0] += 200.0

    patch.setattr(ControlLoop, "_on_change", wrong)


def drill(vessel: VesselMap, planner: PathPlanner) -> None:
    """Take watched rigs through every transition, with motion, strangers and the bounds in between."""
    for pair, cause in CAUSES.items():
        rig = WatchedRig(vessel, planner)
        rig.advance(0.4)
        bring_to(rig, pair[0])
        assert rig.is_in(pair[0]), f"I9: {pair[0]} cannot be reached"
        rig.hand_x_m += 0.02
        rig.advance(0.1)
        rig.send_as("stranger", clutch=False)
        rig.send_as("stranger", clutch=True)
        with contextlib.suppress(RefusedError):
            rig.sits("second")
        if pair[0] in LATCHED:
            granted(rig, Ask.ARM)
        cause(rig)
        rig.hand_x_m -= 0.02
        rig.advance(0.2)
        bring_to(rig, Mode.DISARMED)
        assert rig.is_in(Mode.DISARMED), "I9"
    hold_with_a_closed_clutch(WatchedRig(vessel, planner))
    sink(WatchedRig(vessel, planner))


def hold_with_a_closed_clutch(rig: WatchedRig) -> None:
    rig.advance(0.4)
    bring_to(rig, Mode.MANUAL)
    granted(rig, Ask.HOLD)
    rig.hand_x_m += 0.01
    rig.advance(0.3)


def sink(rig: WatchedRig) -> None:
    """Let the hand ask for more than it may have: down through the critical height."""
    rig.advance(0.4)
    bring_to(rig, Mode.MANUAL)
    close_clutch(rig)
    for _ in range(250):
        rig.hand_y_m -= 0.002
        rig.tick()


def test_a_rig_without_a_bug_passes_the_drill(bifurcation: VesselMap, planner: PathPlanner) -> None:
    drill(bifurcation, planner)


@pytest.mark.parametrize(
    ("plant", "name"),
    [
        (moves_in_hold, "I1"),
        (auto_ignores_the_tracker, "I2"),
        (machine(StopsInTwo), "I3"),
        (machine(RefusesTakeover), "I4"),
        (machine(ArmsOutOfLatches), "I5"),
        (the_hand_engages_itself, "I6"),
        (machine(Resumes), "I6"),
        (a_stranger_moves, "I7"),
        (a_seat_is_taken_from_whoever_moves, "I7"),
        (machine(MovesWhileBroken), "I8"),
        (disarm_only_holds, "I9"),
        (shaper_leaps(0.0, 25_000.0), "I10"),
        (shaper_leaps(5000.0, 0.0), "I10"),
        (nothing_is_out_of_bounds, "I10"),
        (manual_begins_elsewhere, "I11"),
    ],
)
def test_the_drill_catches_a_bug_in_the_rig(
    plant: Plant, name: str, bifurcation: VesselMap, planner: PathPlanner, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(monkeypatch)
    with pytest.raises(AssertionError) as caught:
        drill(bifurcation, planner)
    assert str(caught.value).startswith(name), str(caught.value).splitlines()[0]
