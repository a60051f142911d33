"""A tip that disobeys is found in time, and one that obeys through a slow line never looks like it."""

import math
import re
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mrnav_server.autonomy.path import PathPlanner
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.hand import HandConfig
from mrnav_server.core.limits import Limits
from mrnav_server.core.modes import Ask, Mode
from mrnav_server.core.records import MotionCommand, TipReading
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.guards import GuardConfig
from mrnav_server.loops.tip_watch import TipWatch
from tests.loops.conftest import TICK_S
from tests.loops.disobedient import DeviceRig, Lag, Motion, Trapezoid

HAND_M_PER_S = 1 / 40_000
"""Hand speed that asks for 1 µm/s at the default gain of 0.04."""
Build = Callable[[Sequence[float]], Motion]


def armed(rig: DeviceRig) -> DeviceRig:
    rig.ask(Ask.ARM)
    rig.grasp()
    assert rig.is_in(Mode.MANUAL)
    return rig


def moving(rig: DeviceRig, speed_um_per_s: float) -> DeviceRig:
    """Let the hand lead the tip diagonally upwards."""
    armed(rig)
    part = speed_um_per_s / math.sqrt(3.0) * HAND_M_PER_S
    rig.sweep((part, part, part), 0.3)
    return rig


# -- no false alarm


@settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(
    build=st.sampled_from([Lag, Trapezoid]),
    reading_s=st.floats(0.01, 0.033),
    up_s=st.floats(0.0, 0.04),
    down_s=st.floats(0.0, 0.01),
    top_um_per_s=st.sampled_from([3000.0, 4500.0]),
    moves=st.lists(
        st.tuples(
            st.floats(0.0, 1.5),
            st.floats(-1.0, 1.0),
            st.floats(-0.2, 1.0),
            st.floats(-1.0, 1.0),
            st.sampled_from([0.03, 0.1, 0.3, 0.6]),
            st.sampled_from(["", "", "", "hold", "open"]),
        ),
        min_size=2,
        max_size=8,
    ),
)
def test_no_obedient_device_on_a_slow_line_faults(
    bifurcation: VesselMap,
    planner: PathPlanner,
    build: Build,
    reading_s: float,
    up_s: float,
    down_s: float,
    top_um_per_s: float,
    moves: list[tuple[float, float, float, float, float, str]],
) -> None:
    limits = Limits(speed_um_per_s=top_um_per_s)
    rig = armed(DeviceRig(bifurcation, planner, build, reading_s, up_s, down_s, limits))
    for share, x, y, z, span_s, then in moves:
        speed = share * top_um_per_s * HAND_M_PER_S / (math.hypot(x, y, z) or 1.0)
        rig.sweep((speed * x, speed * y, speed * z), span_s)
        if then == "hold":
            rig.ask(Ask.HOLD)
            rig.advance(0.3)
        if then:
            rig.grasp()
        assert rig.control.machine.mode is not Mode.FAULT, rig.control.machine.reason
    rig.advance(0.6)
    assert rig.control.machine.mode is not Mode.FAULT, rig.control.machine.reason


# -- what is found


@pytest.mark.parametrize("build", [Lag, Trapezoid])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("speed_um_per_s", [3000.0, 300.0])
def test_one_stalled_axis_is_a_fault_although_the_others_move(
    bifurcation: VesselMap, planner: PathPlanner, build: Build, axis: int, speed_um_per_s: float
) -> None:
    rig = moving(DeviceRig(bifurcation, planner, build, 0.033, 0.01, 0.01), speed_um_per_s)
    rig.device.stall({axis})
    stuck_um = rig.device.true_um()[axis]
    away_s = math.nan
    part = speed_um_per_s / math.sqrt(3.0) * HAND_M_PER_S
    while not rig.is_in(Mode.FAULT):
        rig.sweep((part, part, part), TICK_S)
        if math.isnan(away_s) and abs(rig.control.drive.shaper.position.array()[axis] - stuck_um) > 25.0:
            away_s = rig.now_s
        assert not rig.now_s > away_s + 0.3
    assert f"does not move although it was told to: its {'XYZ'[axis]} axis" in rig.control.machine.reason
    assert rig.device.stops_s


def test_a_slow_motion_that_stalls_is_found_once_it_is_away(
    bifurcation: VesselMap, planner: PathPlanner
) -> None:
    rig = armed(DeviceRig(bifurcation, planner, Trapezoid))
    rig.hand._config = HandConfig(gain=0.01)
    slowly = (4 * 40.0 * HAND_M_PER_S, 0.0, 0.0)
    rig.sweep(slowly, 0.5)
    stuck_um = rig.device.true_um()[0]
    rig.device.stall({0})
    for _ in range(100):
        rig.sweep(slowly, TICK_S)
        if rig.control.drive.shaper.position.x_um - stuck_um > 25.0:
            break
        assert rig.is_in(Mode.MANUAL)
    rig.sweep(slowly, 0.3)
    assert rig.is_in(Mode.FAULT)


def test_a_device_that_rests_beside_its_target_is_a_fault(
    bifurcation: VesselMap, planner: PathPlanner
) -> None:
    rig = armed(DeviceRig(bifurcation, planner, Trapezoid))
    rig.device.beside_um = (0.0, -50.0, 0.0)
    rig.sweep((0.0, 0.0, 200.0 * HAND_M_PER_S), 0.1)
    rig.clutch = False
    rig.advance(0.3)
    assert rig.is_in(Mode.FAULT)
    # Told while the magnet still comes to rest, or afterwards.
    assert re.search(r"Y axis is (4\d|50) µm off|50 µm from its target", rig.control.machine.reason)
    assert "Y axis" in rig.control.machine.reason


def test_a_device_that_stops_short_is_told_apart_from_one_that_stays(
    bifurcation: VesselMap, planner: PathPlanner
) -> None:
    rig = armed(DeviceRig(bifurcation, planner, Trapezoid))
    rig.sweep((300.0 * HAND_M_PER_S, 0.0, 0.0), 0.2)
    rig.clutch = False
    rig.advance(0.5)
    # It says that it has arrived, and then creeps away from there.
    rig.device.lost_um = (0.0, 0.0, 60.0)
    rig.advance(0.05)
    assert rig.is_in(Mode.FAULT)
    assert "is not where it was told to be: its Z axis" in rig.control.machine.reason


def test_a_device_that_follows_too_late_is_a_fault() -> None:
    """100 ms behind at 4500 µm/s: on its way all the time, but too far behind."""
    watch, now_s, faults = TipWatch(GuardConfig()), 100.0, []
    watch.begin(TipReading(now_s, StagePoint(0.0, 0.0, 0.0), moving=False))
    for tick in range(1, 60):
        at_s = now_s + 0.01 * tick
        watch.sent(MotionCommand(at_s, StagePoint(45.0 * tick, 0.0, 0.0), 4500.0))
        behind = StagePoint(45.0 * max(tick - 12, 0), 0.0, 0.0)
        faults.append(watch.fault(TipReading(at_s, behind, moving=True)))
    first = next(i for i, fault in enumerate(faults) if fault)
    assert 0.2 <= 0.01 * first <= 0.35
    assert "does not follow" in faults[first]


@pytest.mark.parametrize("lost_um", [(-500.0, 0.0, 0.0), (0.0, 2e4, 0.0), (0.0, 0.0, math.nan)])
def test_an_impossible_position_is_a_fault_in_every_mode(
    bifurcation: VesselMap, planner: PathPlanner, lost_um: tuple[float, float, float]
) -> None:
    rig = DeviceRig(bifurcation, planner, Trapezoid)
    if lost_um[0]:
        lost_um = (-rig.world.tip.x_um + lost_um[0], 0.0, 0.0)
    rig.device.lost_um = lost_um
    rig.advance(0.1)
    assert rig.is_in(Mode.FAULT)
    axis = "XYZ"[int(np.flatnonzero(lost_um)[0])]
    assert f"zero calibration is lost: it reads {axis} = " in rig.control.machine.reason
    with pytest.raises(RefusedError, match="calibrate"):
        rig.ask(Ask.RESET)


# -- stop, and stop again


def test_a_stop_is_repeated_until_the_tip_rests(bifurcation: VesselMap, planner: PathPlanner) -> None:
    rig = moving(DeviceRig(bifurcation, planner, Trapezoid), 3000.0)
    rig.device.lost_stops = 3
    rig.ask(Ask.STOP)
    at_um = rig.device.true_um()
    rig.advance(0.5)
    stops_s = list(rig.device.stops_s)
    assert 4 <= len(stops_s) <= 9
    assert all(0.0 < after - before < 0.025 for before, after in pairwise(stops_s))
    assert math.dist(at_um, rig.device.true_um()) < 400.0
    rig.advance(3.0)
    assert rig.device.stops_s == stops_s


def test_a_tip_that_moves_again_is_stopped_again(bifurcation: VesselMap, planner: PathPlanner) -> None:
    rig = moving(DeviceRig(bifurcation, planner, Trapezoid), 3000.0)
    rig.ask(Ask.STOP)
    rig.advance(0.5)
    stops = len(rig.device.stops_s)
    rig.device._motion.go([0.0, 0.0, 0.0], [500.0] * 3, rig.now_s)
    rig.advance(0.1)
    assert len(rig.device.stops_s) > stops
    rig.advance(0.5)
    assert rig.device.true_um()[0] > 5000.0


def test_after_a_reset_the_tip_may_be_driven_by_its_wheel(
    bifurcation: VesselMap, planner: PathPlanner
) -> None:
    rig = moving(DeviceRig(bifurcation, planner, Trapezoid), 3000.0)
    rig.ask(Ask.STOP)
    rig.ask(Ask.RESET)
    with pytest.raises(RefusedError, match="being stopped"):
        rig.ask(Ask.ARM)
    rig.advance(0.3)
    stops = len(rig.device.stops_s)
    rig.device._motion.go([at + 100.0 for at in rig.device.true_um()], [500.0] * 3, rig.now_s)
    rig.advance(0.5)
    assert len(rig.device.stops_s) == stops
    rig.ask(Ask.ARM)


def test_a_silent_device_is_told_to_stop_for_ever(bifurcation: VesselMap, planner: PathPlanner) -> None:
    rig = moving(DeviceRig(bifurcation, planner, Trapezoid), 3000.0)
    rig.device.silent = True
    rig.advance(5.0)
    assert rig.is_in(Mode.FAULT)
    assert len(rig.device.stops_s) > 200


def test_a_rig_is_disarmed_once_its_tip_rests_and_may_be_armed_at_once(
    bifurcation: VesselMap, planner: PathPlanner
) -> None:
    rig = moving(DeviceRig(bifurcation, planner, Trapezoid, up_s=0.04), 3000.0)
    rig.ask(Ask.DISARM)
    rig.advance_until(Mode.DISARMED, 0.5)
    at_um = rig.device.true_um()
    rig.ask(Ask.ARM)
    rig.advance(0.5)
    assert not rig.is_in(Mode.FAULT)
    assert math.dist(at_um, rig.device.true_um()) < 1.0


def test_a_tip_that_moves_is_not_armed(bifurcation: VesselMap, planner: PathPlanner) -> None:
    rig = DeviceRig(bifurcation, planner, Trapezoid)
    rig.device._motion.go([at + 50.0 for at in rig.device.true_um()], [200.0] * 3, rig.now_s)
    rig.advance(0.1)
    with pytest.raises(RefusedError, match="still moves"):
        rig.ask(Ask.ARM)
    rig.advance(0.5)
    rig.ask(Ask.ARM)


# -- who watches over it


def test_a_supervisor_that_does_not_answer_refuses_and_holds(
    bifurcation: VesselMap, planner: PathPlanner
) -> None:
    rig = DeviceRig(bifurcation, planner, Trapezoid)
    rig.control.surroundings.supervisor_fault = lambda: "the supervisor does not answer"
    with pytest.raises(RefusedError, match="supervisor"):
        rig.ask(Ask.ARM)
    rig.control.surroundings.supervisor_fault = lambda: ""
    armed(rig)
    rig.control.surroundings.supervisor_fault = lambda: "the supervisor does not answer"
    rig.tick()
    assert rig.is_in(Mode.MANUAL)
    assert rig.control.facts.warning == "the supervisor does not answer"
    with pytest.raises(RefusedError):
        rig.ask(Ask.AUTO)


def test_a_manipulator_that_the_supervisor_stopped_is_a_fault_until_reset(
    bifurcation: VesselMap, planner: PathPlanner
) -> None:
    rig = moving(DeviceRig(bifurcation, planner, Trapezoid), 3000.0)
    rig.control.surroundings.beat = lambda moves: (
        rig.control.fail("the supervisor stopped it") if moves else None
    )
    commands = len(rig.commands())
    rig.control.step(rig.now_s + TICK_S)
    assert rig.is_in(Mode.FAULT)
    assert len(rig.commands()) == commands, "not even the step that came too late moves anything"
    rig.control.surroundings.beat = lambda moves: None
    rig.advance(0.3)
    assert rig.control.machine.reason.startswith("the supervisor stopped it")
    rig.ask(Ask.RESET)
    assert rig.is_in(Mode.DISARMED)


def test_the_beat_says_whether_the_tip_may_move(bifurcation: VesselMap, planner: PathPlanner) -> None:
    rig = DeviceRig(bifurcation, planner, Trapezoid)
    beats: list[bool] = []
    rig.control.surroundings.beat = beats.append
    rig.tick()
    assert set(beats) == {False}
    rig.ask(Ask.ARM)
    assert beats[-1], "from the step that arms it"
    rig.advance(0.1)
    assert beats[-1]
    moving_part = (3000.0 * HAND_M_PER_S, 0.0, 0.0)
    rig.grasp()
    rig.sweep(moving_part, 0.3)
    rig.ask(Ask.STOP)
    rig.tick()
    assert beats[-1], "until it rests"
    rig.advance(0.3)
    assert not beats[-1]


def test_what_the_driver_warns_of_is_shown(bifurcation: VesselMap, planner: PathPlanner) -> None:
    rig = DeviceRig(bifurcation, planner, Trapezoid)
    rig.control.surroundings.device_warnings = lambda: ["no status comes", "one of ten answers is lost"]
    rig.tick()
    assert rig.control.facts.warning == "no status comes; one of ten answers is lost"
