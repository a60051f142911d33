"""The hand-over's window against closed forms."""

import math

import numpy as np
import pytest

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.handover_metrics import (
    WINDOW_S,
    HandoverMetrics,
    handover_metrics,
    largest_jump_um,
    standstill_s,
)
from mrnav_server.core.metrics import trial_motions
from mrnav_server.core.motion import Motion
from mrnav_server.core.motion_metrics import smoothness

NOTHING = (np.zeros(0), np.zeros((0, 3)))


def motions(xy_um: FloatArray, begin_s: float = 0.0) -> list[Motion]:
    t_s = begin_s + np.arange(len(xy_um)) / 30.0
    return trial_motions(t_s, xy_um, -math.inf, math.inf)


def times(count: int) -> FloatArray:
    return np.arange(count, dtype=np.float64) * 0.01


def swing(duration_s: float, size_um: float, hz: float) -> FloatArray:
    t_s = np.arange(round(duration_s * 30)) / 30.0
    return np.column_stack([size_um * np.sin(2 * math.pi * hz * t_s), np.zeros_like(t_s)])


def measured(parts: list[Motion], switch_s: float, grip_s: float = math.nan) -> HandoverMetrics:
    return handover_metrics(parts, switch_s, *NOTHING, grip_s=grip_s)


def test_the_jerk_of_a_swing_is_its_size_times_frequency_cubed() -> None:
    found = measured(motions(swing(8.0, 1000.0, 0.5)), 2.0)
    assert found.peak_jerk_um_per_s3 == pytest.approx(1000.0 * math.pi**3, rel=0.01)


def test_jerk_outside_of_the_window_counts_for_nothing() -> None:
    quiet, loud = swing(6.0, 1000.0, 0.25), swing(6.0, 1000.0, 1.0)
    parts = motions(np.concatenate([quiet, quiet, loud]))
    assert measured(parts, 3.0).peak_jerk_um_per_s3 == pytest.approx(1000.0 * (0.5 * math.pi) ** 3, rel=0.02)
    assert measured(parts, 13.0).peak_jerk_um_per_s3 > 10 * measured(parts, 3.0).peak_jerk_um_per_s3


def test_s_of_the_window_goes_by_the_peak_speed_of_the_trial() -> None:
    slow, fast = swing(8.0, 100.0, 0.5), swing(8.0, 1000.0, 0.5)
    parts = motions(np.concatenate([slow, fast]))
    alone = smoothness(motions(slow))
    found = measured(parts, 2.0).smoothness
    # Ten times the peak speed is a hundredth of the cost.
    assert found.value == pytest.approx(alone.value - 2.0, abs=0.01)
    # σ = 1 s slides through 2.5 s of 30 Hz.
    assert found.samples == pytest.approx((WINDOW_S - 1.0) * 30, abs=1)


def test_a_window_of_a_uniform_circle_has_the_s_of_the_circle() -> None:
    t_s = np.arange(240) / 30.0
    parts = motions(1000.0 * np.column_stack([np.cos(t_s), np.sin(t_s)]))
    assert measured(parts, 2.0).smoothness.value == pytest.approx(0.0, abs=1e-3)


def test_standstill_is_how_long_the_robot_stood() -> None:
    t_s = np.arange(300) / 30.0
    x_um = 1000.0 * np.maximum(t_s - 4.0, 0.0)
    parts = motions(np.column_stack([x_um, np.zeros_like(x_um)]))
    assert measured(parts, 2.5).standstill_s == pytest.approx(1.5, abs=0.25)
    assert measured(parts, 5.0).standstill_s == 0.0
    assert math.isnan(standstill_s([]))


def test_a_setpoint_that_jumps_shows_the_length_of_the_jump() -> None:
    t_s = times(100)
    line = t_s[:, None] * np.array([2000.0, 0.0, 0.0])
    assert largest_jump_um(t_s, line) == pytest.approx(0.0, abs=1e-9)
    line[50:] += [300.0, 400.0, 0.0]
    assert largest_jump_um(t_s, line) == pytest.approx(500.0)


def test_a_setpoint_that_accelerates_shows_a_dt_squared() -> None:
    t_s = times(50)
    bent = (0.5 * 30_000.0 * t_s**2)[:, None] * np.array([1.0, 0.0])
    assert largest_jump_um(t_s, bent) == pytest.approx(3.0)


def test_uneven_commands_of_a_steady_setpoint_are_no_jump() -> None:
    t_s = np.cumsum(np.random.default_rng(1).uniform(0.003, 0.02, 200))
    assert largest_jump_um(t_s, np.outer(t_s, [2400.0, 100.0])) == pytest.approx(0.0, abs=1e-6)


def test_after_a_pause_the_setpoint_set_out_from_rest() -> None:
    t_s = np.array([0.0, 0.01, 0.02, 1.0, 1.01])
    x_um = np.array([0.0, 20.0, 40.0, 41.0, 42.0])
    assert largest_jump_um(t_s, x_um[:, None]) == pytest.approx(1.0)
    assert math.isnan(largest_jump_um(t_s[:2], x_um[:2, None]))


def test_a_jump_at_the_switch_counts_and_one_before_does_not() -> None:
    parts = motions(swing(8.0, 1000.0, 0.5))
    t_s = times(800)
    at_switch, before = np.zeros((800, 2)), np.zeros((800, 2))
    at_switch[300:] += 80.0
    before[200:] += 80.0
    assert handover_metrics(parts, 3.0, t_s, at_switch).jump_um == pytest.approx(math.hypot(80.0, 80.0))
    assert handover_metrics(parts, 3.0, t_s, before).jump_um == 0.0


def test_take_over_counts_from_the_switch() -> None:
    parts = motions(swing(8.0, 1000.0, 0.5))
    assert measured(parts, 3.0, 3.75).take_over_s == pytest.approx(0.75)
    assert measured(parts, 3.0, 2.5).take_over_s == 0.0
    assert math.isnan(measured(parts, 3.0).take_over_s)
