import math

import numpy as np
import pytest

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.metric_flags import FLAGS
from mrnav_server.core.metrics import Trial, path_length_share, trial_metrics
from tests.core.trajectories import circle, line, times


def test_path_length_share() -> None:
    assert path_length_share(2000.0, 1000.0, reached=True) == 0.5
    assert path_length_share(900.0, 1000.0, reached=True) == 1.0
    assert path_length_share(2000.0, 1000.0, reached=False) == 0.0
    assert math.isnan(path_length_share(2000.0, math.nan, reached=True))


def trial(t_s: FloatArray, xy_um: FloatArray, **changes: object) -> Trial:
    values: dict[str, object] = {
        "t_s": t_s,
        "xy_um": xy_um,
        "clearance_um": np.full(t_s.size, 300.0),
        "go_s": 5.0,
        "end_s": 15.0,
        "reached": True,
        "sigma_um": 5.0,
        "geodesic_um": 4500.0,
    }
    return Trial(**{**values, **changes})  # type: ignore[arg-type]


def test_a_trial_counts_between_its_marks_alone() -> None:
    t_s = times(20)
    # Rests until 6 s, then a straight line at 500 µm/s; after the end it leaps about.
    xy_um = line(500.0)(np.clip(t_s - 6.0, 0.0, None))
    xy_um[t_s > 16.0] *= 3.0
    clearance_um = np.where((t_s > 8.0) & (t_s < 9.0), -2.0, 300.0)
    clearance_um[t_s < 4.0] = -500.0
    metrics = trial_metrics(trial(t_s, xy_um, clearance_um=clearance_um))
    assert metrics.completion_s == 10.0
    assert metrics.first_motion_s == pytest.approx(1.0, abs=0.25)
    assert metrics.path_um == pytest.approx(4500.0, rel=3e-3)
    assert metrics.average_speed_um_per_s == pytest.approx(450.0, rel=3e-3)
    assert metrics.contacts == 1
    assert metrics.min_clearance_um == -2.0
    assert metrics.path_length_share == pytest.approx(1.0, abs=3e-3)
    assert metrics.peak_speed_um_per_s == pytest.approx(500.0, rel=0.15)
    assert metrics.seen_share == 1.0


def test_a_target_that_was_not_reached_has_no_completion_time() -> None:
    t_s = times(20)
    metrics = trial_metrics(trial(t_s, line(500.0)(t_s), reached=False))
    assert math.isnan(metrics.completion_s)
    assert metrics.path_length_share == 0.0


def test_a_metric_near_its_noise_floor_is_flagged() -> None:
    t_s = times(20)
    noise_um = np.random.default_rng(5).normal(0.0, 5.0, (t_s.size, 2))
    straight = trial_metrics(trial(t_s, line(2400.0)(t_s) + noise_um))
    assert straight.flags == ("g_near_noise_floor", "s_near_noise_floor")
    curved = trial_metrics(trial(t_s, circle(1000.0, 2400.0)(t_s) + noise_um))
    assert curved.flags == ()


def test_a_robot_that_was_never_seen_gives_no_motion() -> None:
    t_s = times(20)
    metrics = trial_metrics(
        trial(t_s, np.full((t_s.size, 2), np.nan), clearance_um=np.full(t_s.size, np.nan))
    )
    assert math.isnan(metrics.average_speed_um_per_s)
    assert math.isnan(metrics.straightness.value)
    assert metrics.flags == ("nothing_moves", "gaps")
    assert metrics.contacts == 0
    assert metrics.seen_share == 0.0


def test_every_flag_can_be_raised_and_means_something() -> None:
    t_s = times(20)
    still_um, line_um = np.zeros((t_s.size, 2)), line(1000.0)(t_s)
    holed_um = circle(1000.0, 1000.0)(t_s)
    holed_um[(t_s > 9.0) & (t_s < 9.3)] = np.nan
    noise_um = np.random.default_rng(5).normal(0.0, 5.0, (t_s.size, 2))
    short_s = times(1.2)
    raised = {
        flag
        for metrics in (
            trial_metrics(trial(t_s, still_um, reached=False)),
            trial_metrics(trial(t_s, line_um)),
            trial_metrics(trial(t_s, holed_um)),
            trial_metrics(trial(t_s, line_um + noise_um)),
            trial_metrics(trial(short_s, circle(1000.0, 1000.0)(short_s), go_s=0.0, end_s=1.2)),
        )
        for flag in metrics.flags
    }
    assert raised == set(FLAGS)
    assert all(FLAGS.values())
