"""The control loop under a guided random adversary: no sequence of events breaks an invariant."""

import contextlib
from collections.abc import Callable

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    precondition,
    rule,
    run_state_machine_as_test,
)

from mrnav_server.autonomy.path import PathPlanner
from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.modes import ARMED, LATCHED, Ask, Mode
from mrnav_server.core.vessel import VesselMap
from tests.loops.watched import WatchedRig, granted

TRANSITIONS = {
    (Mode.DISARMED, Mode.MANUAL),
    (Mode.DISARMED, Mode.HOLD),
    (Mode.DISARMED, Mode.FAULT),
    (Mode.DISARMED, Mode.STOP),
    (Mode.MANUAL, Mode.DISARMED),
    (Mode.MANUAL, Mode.AUTO),
    (Mode.MANUAL, Mode.HOLD),
    (Mode.MANUAL, Mode.FAULT),
    (Mode.MANUAL, Mode.STOP),
    (Mode.AUTO, Mode.DISARMED),
    (Mode.AUTO, Mode.MANUAL),
    (Mode.AUTO, Mode.HOLD),
    (Mode.AUTO, Mode.FAULT),
    (Mode.AUTO, Mode.STOP),
    (Mode.HOLD, Mode.DISARMED),
    (Mode.HOLD, Mode.MANUAL),
    (Mode.HOLD, Mode.AUTO),
    (Mode.HOLD, Mode.FAULT),
    (Mode.HOLD, Mode.STOP),
    (Mode.FAULT, Mode.DISARMED),
    (Mode.FAULT, Mode.STOP),
    (Mode.STOP, Mode.DISARMED),
}
"""Every change of mode that there is."""
HAND_M = [-0.01, -0.001, 0.0, 0.001, 0.01]
"""Hand motion in a tick; the largest asks for more than the fastest speed."""


def repair(rig: WatchedRig) -> None:
    """End every fault and let a fresh open hand sit; the mode stays unless something is wrong with it."""
    rig.manipulator.recover()
    rig.refuses_moves = False
    rig.stalled, rig.beside_um = set(), (0.0, 0.0, 0.0)
    rig.camera_alive = rig.hand_alive = rig.hand_valid = True
    rig.clutch = False
    rig.advance(0.1)
    if not rig.lease.is_hand(rig.hand_session):
        rig.sits("hand")
    if not rig.areas.list():
        rig.areas.add(rig.vessel.suggested_areas[0], 500.0, "")
    if not rig.is_in(Mode.AUTO):
        rig.control.choose_area(rig.areas.list()[-1])
    rig.advance(0.5)


def bring_to(rig: WatchedRig, mode: Mode) -> None:
    """Bring the rig from anywhere into a mode."""
    if mode in LATCHED:
        if mode is Mode.STOP:
            rig.ask(Ask.STOP)
        elif not rig.is_in(Mode.FAULT):
            bring_to(rig, Mode.DISARMED)
            rig.manipulator.fail()
            rig.advance(0.01)
            rig.manipulator.recover()
        return
    repair(rig)
    if rig.control.machine.mode in LATCHED:
        assert granted(rig, Ask.RESET)
    elif mode is Mode.DISARMED:
        assert granted(rig, Ask.DISARM)
        rig.advance(0.5)
    if mode is Mode.DISARMED:
        return
    if rig.is_in(Mode.DISARMED) and not granted(rig, Ask.ARM):
        # The tip was driven to where nothing may be armed.
        rig.push_tip(StagePoint(9120.0, 8950.0, 13_125.0))
        assert granted(rig, Ask.ARM)
    if mode is Mode.AUTO:
        with contextlib.suppress(ConfigError):
            rig.world.place_robot(rig.calibration.held_point(rig.world.tip))
        rig.advance(0.1)
        if granted(rig, Ask.AUTO):
            rig.advance(0.3)
    else:
        assert granted(rig, Ask.MANUAL if mode is Mode.MANUAL else Ask.HOLD)
        if mode is Mode.MANUAL:
            rig.clutch = True
            rig.advance(0.1)


def close_clutch(rig: WatchedRig) -> None:
    rig.clutch = False
    rig.send_hand()
    rig.clutch = True
    rig.send_hand()


def silence_hand(rig: WatchedRig) -> None:
    rig.hand_alive = False
    rig.advance(0.12)


def open_and_begin(rig: WatchedRig) -> None:
    rig.clutch = False
    rig.send_hand()
    granted(rig, Ask.AUTO)


def break_manipulator(rig: WatchedRig) -> None:
    rig.manipulator.fail()
    rig.advance(0.01)


def stop_camera(rig: WatchedRig) -> None:
    rig.camera_alive = False
    rig.advance(0.15)


def arm_without_hand(rig: WatchedRig) -> None:
    silence_hand(rig)
    granted(rig, Ask.ARM)


def begin_and_disarm(rig: WatchedRig) -> None:
    bring_to(rig, Mode.HOLD)
    rig.advance(0.5)
    granted(rig, Ask.AUTO)
    granted(rig, Ask.DISARM)


def come_to_rest_and_disarm(rig: WatchedRig) -> None:
    rig.advance(0.5)
    granted(rig, Ask.DISARM)


def asks(ask: Ask) -> Callable[[WatchedRig], None]:
    def act(rig: WatchedRig) -> None:
        granted(rig, ask)

    return act


CAUSES: dict[tuple[Mode, Mode], Callable[[WatchedRig], None]] = {
    (Mode.DISARMED, Mode.MANUAL): asks(Ask.ARM),
    (Mode.DISARMED, Mode.HOLD): arm_without_hand,
    (Mode.MANUAL, Mode.DISARMED): come_to_rest_and_disarm,
    (Mode.MANUAL, Mode.AUTO): open_and_begin,
    (Mode.MANUAL, Mode.HOLD): silence_hand,
    (Mode.AUTO, Mode.DISARMED): begin_and_disarm,
    (Mode.AUTO, Mode.MANUAL): close_clutch,
    (Mode.AUTO, Mode.HOLD): stop_camera,
    (Mode.HOLD, Mode.DISARMED): come_to_rest_and_disarm,
    (Mode.HOLD, Mode.MANUAL): close_clutch,
    (Mode.HOLD, Mode.AUTO): asks(Ask.AUTO),
    (Mode.FAULT, Mode.DISARMED): asks(Ask.RESET),
    (Mode.STOP, Mode.DISARMED): asks(Ask.RESET),
    **{(mode, Mode.STOP): asks(Ask.STOP) for mode in Mode if mode is not Mode.STOP},
    **{(mode, Mode.FAULT): break_manipulator for mode in ARMED | {Mode.DISARMED}},
}
"""What leads from one mode to another; the adversary uses it as a guide, in whatever state the rig is."""


class ManyHands(RuleBasedStateMachine):
    """Operators, consoles, devices and the needle do what they like."""

    vessel: VesselMap
    planner: PathPlanner
    seen: set[tuple[Mode, Mode]]
    disobedient: int

    def __init__(self) -> None:
        super().__init__()
        self.rig = WatchedRig(self.vessel, self.planner)
        self.rig.advance(0.4)

    @initialize(mode=st.sampled_from([*Mode, Mode.AUTO, Mode.AUTO, Mode.MANUAL]))
    def begin(self, mode: Mode) -> None:
        bring_to(self.rig, mode)

    @rule(mode=st.sampled_from([Mode.MANUAL, Mode.AUTO, Mode.AUTO, Mode.HOLD]))
    @precondition(lambda self: self.rig.control.machine.mode in LATCHED | {Mode.DISARMED, Mode.HOLD})
    def put_to_work(self, mode: Mode) -> None:
        bring_to(self.rig, mode)

    @rule(after=st.sampled_from(Mode))
    def a_cause_of_another_mode(self, after: Mode) -> None:
        cause = CAUSES.get((self.rig.control.machine.mode, after))
        if cause is not None:
            cause(self.rig)

    @rule(ask=st.sampled_from([*Ask, Ask.AUTO, Ask.AUTO]))
    def someone_asks(self, ask: Ask) -> None:
        granted(self.rig, ask)

    @rule(span_s=st.sampled_from([0.01, 0.03, 0.1, 0.3, 1.0]))
    def time_passes(self, span_s: float) -> None:
        self.rig.advance(span_s)

    @rule(span_s=st.sampled_from([0.03, 0.15, 0.6]))
    def the_loop_stalls(self, span_s: float) -> None:
        self.rig.stall(span_s)

    # -- hand

    @rule(closed=st.booleans())
    def the_clutch(self, closed: bool) -> None:
        self.rig.clutch = closed
        if self.rig.hand_alive:
            self.rig.send_hand()

    @rule(
        x_m=st.sampled_from(HAND_M),
        y_m=st.sampled_from(HAND_M),
        z_m=st.sampled_from(HAND_M),
        ticks=st.integers(1, 60),
    )
    @precondition(lambda self: self.rig.hand_alive and self.rig.hand_valid)
    def the_hand_moves(self, x_m: float, y_m: float, z_m: float, ticks: int) -> None:
        rig = self.rig
        for _ in range(ticks):
            rig.hand_x_m += x_m
            rig.hand_y_m += y_m
            rig.hand_z_m += z_m
            rig.tick()

    @rule(x_m=st.sampled_from([-1.0, 1.0]), z_m=st.sampled_from([-1.0, 0.0, 1.0]))
    def the_hand_jumps(self, x_m: float, z_m: float) -> None:
        self.rig.hand_x_m += x_m
        self.rig.hand_z_m += z_m
        self.rig.advance(0.05)

    @rule(valid=st.booleans(), span_s=st.sampled_from([0.02, 0.15]))
    def the_hand_is_seen(self, valid: bool, span_s: float) -> None:
        self.rig.hand_valid = valid
        self.rig.advance(span_s)

    @rule(span_s=st.sampled_from([0.03, 0.06, 0.15, 2.2]))
    def the_hand_is_silent(self, span_s: float) -> None:
        self.rig.hand_alive = False
        self.rig.advance(span_s)
        self.rig._next_hand_s = self.rig.now_s
        self.rig.hand_alive = True

    @rule()
    def a_stranger_sends(self) -> None:
        self.rig.send_as("stranger", clutch=False)
        self.rig.send_as("stranger", clutch=True)

    # -- lease

    @rule(back=st.booleans())
    def the_hand_leaves(self, back: bool) -> None:
        self.rig.leaves()
        if back:
            self.rig.sits("hand")

    @rule(name=st.sampled_from(["hand", "second"]))
    def a_hand_says_hello(self, name: str) -> None:
        with contextlib.suppress(RefusedError):
            self.rig.sits(name)

    @rule()
    def the_console_sits(self) -> None:
        self.rig.lease.take_console("page", "page", self.rig.now_s)

    @rule()
    def the_console_leaves(self) -> None:
        self.rig.lease.give_back("page")
        self.rig.control.step(self.rig.now_s)

    @rule(ticks=st.integers(1, 60))
    def the_console_watches(self, ticks: int) -> None:
        for _ in range(ticks):
            self.rig.lease.hear("page", self.rig.now_s)
            self.rig.tick()

    # -- devices

    @rule(alive=st.booleans())
    def the_camera(self, alive: bool) -> None:
        self.rig.camera_alive = alive
        self.rig._next_frame_s = self.rig.now_s

    @rule(
        fault=st.sampled_from(["fail", "mute", "refuse moves", "recover"]),
        span_s=st.sampled_from([0.01, 0.05, 0.3]),
    )
    def the_manipulator(self, fault: str, span_s: float) -> None:
        self.rig.manipulator.recover()
        self.rig.refuses_moves = fault == "refuse moves"
        if fault in ("fail", "mute"):
            getattr(self.rig.manipulator, fault)()
        self.rig.advance(span_s)

    @rule(
        stalled=st.sampled_from([{0}, {1}, {0, 1, 2}, set()]),
        beside_um=st.sampled_from([(-60.0, 0.0, 0.0), (0.0, 30.0, 0.0), (0.0, 0.0, 0.0)]),
        step_m=st.sampled_from(HAND_M),
        ticks=st.integers(5, 60),
    )
    @precondition(lambda self: self.rig.control.machine.mode in ARMED)
    def the_manipulator_disobeys(
        self, stalled: set[int], beside_um: tuple[float, float, float], step_m: float, ticks: int
    ) -> None:
        rig = self.rig
        if rig.is_in(Mode.MANUAL) and rig.hand_alive and not self.rig.hand.engaged:
            close_clutch(rig)
        rig.stalled, rig.beside_um = stalled, beside_um
        for _ in range(ticks):
            rig.hand_x_m += step_m
            rig.hand_z_m += step_m
            rig.tick()

    @rule(ticks=st.integers(10, 100))
    @precondition(lambda self: self.rig.is_in(Mode.AUTO))
    def the_operator_takes_over_and_drives(self, ticks: int) -> None:
        self.rig.clutch = False
        self.rig.send_hand()
        self.rig.clutch = True
        self.rig.send_hand()
        self.rig.hand_x_m += 0.02
        self.rig.advance(0.01 * ticks)

    @rule()
    def the_robot_is_dropped(self) -> None:
        self.rig.world.drop_robot()

    @rule(place=st.integers(0, 3))
    def the_robot_is_placed(self, place: int) -> None:
        areas = self.rig.vessel.suggested_areas
        self.rig.world.place_robot(areas[place % len(areas)])

    @rule(dx_um=st.sampled_from([-800.0, 0.0, 300.0]), dy_um=st.sampled_from([-300.0, 0.0, 800.0]))
    def the_needle_is_bumped(self, dx_um: float, dy_um: float) -> None:
        self.rig.world.bump_needle(dx_um, dy_um)

    @rule(
        x_um=st.integers(0, 20).map(lambda k: 1000.0 * k),
        y_um=st.integers(0, 20).map(lambda k: 1000.0 * k),
        z_um=st.sampled_from([11_000.0, 12_750.0, 13_100.0, 15_000.0]),
    )
    @precondition(lambda self: self.rig.control.machine.mode not in ARMED)
    def the_tip_is_driven_by_its_wheel(self, x_um: float, y_um: float, z_um: float) -> None:
        self.rig.push_tip(StagePoint(x_um, y_um, z_um))

    # -- areas

    @rule(index=st.integers(0, 3), epsilon_um=st.sampled_from([50.0, 500.0, 3000.0]))
    def an_area_is_marked(self, index: int, epsilon_um: float) -> None:
        areas = self.rig.vessel.suggested_areas
        area = self.rig.areas.add(areas[index % len(areas)], epsilon_um, "")
        with contextlib.suppress(RefusedError):
            self.rig.control.choose_area(area)

    @rule()
    def the_areas_are_removed(self) -> None:
        for area in self.rig.areas.list():
            self.rig.areas.remove(area.id)
        with contextlib.suppress(RefusedError):
            self.rig.control.choose_area(None)

    def teardown(self) -> None:
        """DISARMED can be reached from wherever this ended (I9)."""
        self.seen |= self.rig.transitions
        type(self).disobedient += self.rig.disobedient
        bring_to(self.rig, Mode.DISARMED)
        assert self.rig.is_in(Mode.DISARMED), "I9"


def walk(vessel: VesselMap, planner: PathPlanner, examples: int, steps: int) -> None:
    """Let the adversary loose, the same way every time.

    A failing walk prints its steps as they were; add ``Phase.shrink`` to have them made fewer (minutes).
    """
    ManyHands.vessel, ManyHands.planner, ManyHands.seen = vessel, planner, set()
    ManyHands.disobedient = 0
    run_state_machine_as_test(
        ManyHands,
        settings=settings(
            max_examples=examples,
            stateful_step_count=steps,
            deadline=None,
            derandomize=True,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        ),
    )
    assert {mode for pair in ManyHands.seen for mode in pair} == set(Mode)
    assert ManyHands.seen <= TRANSITIONS
    assert ManyHands.disobedient > 0


def test_no_sequence_of_events_breaks_an_invariant(bifurcation: VesselMap, planner: PathPlanner) -> None:
    walk(bifurcation, planner, examples=50, steps=30)


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_no_long_sequence_of_events_breaks_an_invariant(bifurcation: VesselMap, planner: PathPlanner) -> None:
    walk(bifurcation, planner, examples=400, steps=50)
    assert ManyHands.seen == TRANSITIONS


def test_the_causes_are_those_of_the_table() -> None:
    assert set(CAUSES) == TRANSITIONS


@pytest.mark.parametrize("pair", sorted(CAUSES, key=str), ids=lambda pair: f"{pair[0].value}-{pair[1].value}")
def test_every_transition_happens_and_is_watched(
    pair: tuple[Mode, Mode], bifurcation: VesselMap, planner: PathPlanner
) -> None:
    rig = WatchedRig(bifurcation, planner)
    rig.advance(0.4)
    bring_to(rig, pair[0])
    assert rig.is_in(pair[0])
    rig.transitions.clear()
    CAUSES[pair](rig)
    assert pair in rig.transitions
    rig.advance(0.5)
