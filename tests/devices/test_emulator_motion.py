"""The emulated axes: closed-form times, and what holds for every motion."""

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mrnav_server.devices.sensapex.emulated_motion import TRAVEL_UM, Axis, Goal, Stage, trapezoid

A = 50_000.0
positions = st.floats(0.0, TRAVEL_UM)
goals = st.builds(Goal, positions, st.floats(0.25, 5000.0), st.floats(500.0, A))


def duration_s(*legs: tuple[float, float]) -> float:
    return sum(leg[0] for leg in legs)


def test_a_long_way_takes_its_length_by_speed_and_the_ramps() -> None:
    legs = trapezoid(1000.0, 0.0, Goal(6000.0, 2000.0, A))
    assert duration_s(*legs) == pytest.approx(5000.0 / 2000.0 + 2000.0 / A)
    assert [a for _, a in legs] == [A, 0.0, -A]


def test_a_short_way_is_a_triangle() -> None:
    legs = trapezoid(1000.0, 0.0, Goal(920.0, 3000.0, A))
    assert duration_s(*legs) == pytest.approx(2 * math.sqrt(80.0 / A))


def test_a_lower_acceleration_takes_longer() -> None:
    legs = trapezoid(0.0, 0.0, Goal(1000.0, 1000.0, 2000.0))
    assert duration_s(*legs) == pytest.approx(1.0 + 0.5)


def test_halfway_through_a_triangle_it_is_fastest() -> None:
    axis = Axis(5000.0)
    axis.go(Goal(5080.0, 3000.0, A), 10.0)
    half_s = math.sqrt(80.0 / A)
    assert axis.state(10.0 + half_s) == pytest.approx((5040.0, A * half_s))
    assert axis.state(10.0 + 2 * half_s) == (5080.0, 0.0)


def test_a_halt_takes_the_braking_distance() -> None:
    axis = Axis(0.0)
    axis.go(Goal(10_000.0, 3000.0, A), 0.0)
    before_um, v = axis.state(1.0)
    assert v == pytest.approx(3000.0)
    axis.halt(A, 1.0)
    assert axis.ends_s == pytest.approx(1.0 + 3000.0 / A)
    assert axis.state(2.0) == pytest.approx((before_um + 3000.0**2 / (2 * A), 0.0))


def test_a_new_goal_behind_it_turns_without_a_jump() -> None:
    axis = Axis(5000.0)
    axis.go(Goal(9000.0, 2000.0, A), 0.0)
    before = axis.state(0.5)
    axis.go(Goal(5500.0, 2000.0, A), 0.5)
    assert axis.state(0.5) == before
    turned_um, v = axis.state(0.5 + 2000.0 / A)
    assert turned_um == pytest.approx(before[0] + 2000.0**2 / (2 * A))
    assert v == pytest.approx(0.0, abs=1e-6)
    assert axis.state(5.0) == (5500.0, 0.0)


# Braking must begin at this very moment: there is nothing to do but brake.
@example(1.0, Goal(0.0, 1.0, 501.0), Goal(0.0, 1.0, 500.0), 1.0, 0.0)
@given(positions, goals, goals, st.floats(0.0, 3.0), st.floats(0.0, 20.0))
def test_wherever_it_turns_it_is_steady_within_its_limits_and_arrives(
    start_um: float, first: Goal, second: Goal, turn_s: float, later_s: float
) -> None:
    axis = Axis(start_um)
    axis.go(first, 0.0)
    before_um, before_v = axis.state(turn_s)
    assert 0.0 <= before_um <= TRAVEL_UM
    axis.go(second, turn_s)
    assert axis.state(turn_s) == pytest.approx((before_um, before_v), abs=1e-6)
    at_um, v = axis.state(turn_s + later_s)
    assert 0.0 <= at_um <= TRAVEL_UM
    assert abs(v) <= max(abs(before_v), second.speed_um_per_s) + 1e-6
    next_um, next_v = axis.state(turn_s + later_s + 1e-4)
    assert abs(next_um - at_um) <= 5000.0 * 1e-4 + 1e-6
    hardest = max(first.acceleration_um_per_s2, second.acceleration_um_per_s2, A)
    assert abs(next_v - v) <= hardest * 1e-4 * (1 + 1e-6) + 1e-6
    assert axis.state(axis.ends_s) == (second.target_um, 0.0)
    nearly_um, _ = axis.state(axis.ends_s - 1e-6)
    assert nearly_um == pytest.approx(second.target_um, abs=0.01)


def test_a_goal_outside_is_clipped_to_the_travel() -> None:
    axis = Axis(19_990.0)
    axis.go(Goal(25_000.0, 1000.0, A), 0.0)
    assert axis.state(1.0) == (TRAVEL_UM, 0.0)


def test_near_its_end_it_brakes_as_hard_as_it_must() -> None:
    axis = Axis(10_000.0)
    axis.go(Goal(TRAVEL_UM, 4000.0, A), 0.0)
    late_s = axis.ends_s - 0.01
    axis.go(Goal(10_000.0, 1000.0, 500.0), late_s)
    for step in range(2000):
        at_um, v = axis.state(late_s + step * 0.0001)
        assert at_um < TRAVEL_UM or v == pytest.approx(0.0, abs=1e-3)


def test_a_stall_holds_it_and_coming_free_lets_it_go_on() -> None:
    axis = Axis(0.0)
    axis.go(Goal(2000.0, 1000.0, A), 0.0)
    stuck_um, _ = axis.state(1.0)
    axis.stall(True, 1.0)
    assert axis.state(50.0) == (stuck_um, 0.0)
    assert axis.moving(50.0)
    axis.stall(False, 50.0)
    assert axis.state(60.0) == (2000.0, 0.0)


def test_a_stalled_axis_forgets_its_goal_when_halted() -> None:
    axis = Axis(0.0)
    axis.stall(True, 0.0)
    axis.go(Goal(2000.0, 1000.0, A), 0.0)
    assert axis.moving(1.0)
    axis.halt(A, 1.0)
    axis.stall(False, 2.0)
    assert not axis.moving(2.0)
    assert axis.state(9.0) == (0.0, 0.0)


def test_what_is_stuck_while_it_brakes_stays_when_it_comes_free() -> None:
    axis = Axis(0.0)
    axis.go(Goal(2000.0, 1000.0, A), 0.0)
    axis.halt(A, 1.0)
    axis.stall(True, 1.001)
    stuck_um, _ = axis.state(1.001)
    axis.stall(False, 2.0)
    assert axis.state(9.0) == (stuck_um, 0.0)


def test_axes_move_one_after_another() -> None:
    stage = Stage((0.0, 0.0, 0.0), A)
    stage.go({0: Goal(1000.0, 1000.0, A), 2: Goal(500.0, 500.0, A)}, False, 0.0)
    first_s = 1.0 + 1000.0 / A
    assert stage.moving(first_s - 0.01) == [True, False, False]
    stage.advance(first_s + 0.5)
    assert stage.moving(first_s + 0.5) == [False, False, True]
    assert stage.positions_um(first_s + 0.5)[2] == pytest.approx(250.0 - 500.0**2 / (2 * A))
    last_s = first_s + 1.0 + 500.0 / A
    assert stage.next_change_s(first_s + 0.5) == pytest.approx(last_s)
    stage.advance(last_s)
    assert stage.at_rest(last_s + 1e-9)
    assert stage.positions_um(last_s + 1e-9) == [1000.0, 0.0, 500.0]


def test_turns_missed_between_two_looks_are_made_up_for() -> None:
    stage = Stage((0.0, 0.0, 0.0, 0.0), A)
    stage.go({axis: Goal(100.0, 1000.0, A) for axis in range(4)}, False, 0.0)
    stage.advance(100.0)
    assert stage.positions_um(100.0) == [100.0] * 4


def test_an_axis_that_waits_for_its_turn_brakes_first() -> None:
    stage = Stage((0.0, 0.0, 0.0), A)
    stage.go({1: Goal(9000.0, 1000.0, A)}, True, 0.0)
    stage.go({0: Goal(1000.0, 1000.0, A), 1: Goal(0.0, 1000.0, A)}, False, 1.0)
    assert stage.velocities_um_per_s(1.1) == [1000.0, 0.0, 0.0]
    stage.advance(9.0)
    assert stage.positions_um(9.0) == [1000.0, 0.0, 0.0]


def test_an_axis_without_a_goal_keeps_what_it_does() -> None:
    stage = Stage((0.0, 0.0, 0.0), A)
    stage.go({0: Goal(3000.0, 1000.0, A)}, True, 0.0)
    stage.go({1: Goal(100.0, 1000.0, A)}, True, 1.0)
    assert stage.positions_um(9.0) == [3000.0, 100.0, 0.0]


def test_a_cut_stands_still_at_once() -> None:
    stage = Stage((0.0, 0.0, 0.0), A)
    stage.go({0: Goal(3000.0, 1000.0, A), 1: Goal(10.0, 10.0, A)}, False, 0.0)
    at_um = stage.positions_um(1.0)
    stage.cut(1.0)
    stage.advance(50.0)
    assert stage.positions_um(50.0) == at_um
    assert stage.at_rest(1.0)
