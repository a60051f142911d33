import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import savgol_coeffs

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.metrics import (
    Trial,
    average_speed_um_per_s,
    contact_starts,
    first_motion_s,
    jerk_cost,
    log_dimensionless_jerk,
    path_length_share,
    peak_speed_um_per_s,
    smoothness,
    smoothness_floor,
    spectral_arc_length,
    straightness,
    straightness_floor,
    trial_metrics,
)
from mrnav_server.core.motion import Motion, filtered, segments

Path = Callable[[FloatArray], FloatArray]


def times(end_s: float, begin_s: float = 0.0) -> FloatArray:
    """Return the frames of a 30 fps camera, both ends included."""
    return np.arange(round(begin_s * 30), round(end_s * 30) + 1) / 30.0


def motions(t_s: FloatArray, path: Path) -> list[Motion]:
    return [motion for each in segments(t_s, path(t_s)) if (motion := filtered(each)).t_s.size > 1]


def circle(radius_um: float, speed_um_per_s: float) -> Path:
    rate = speed_um_per_s / radius_um
    return lambda t: radius_um * np.column_stack([np.cos(rate * t), np.sin(rate * t)])


def line(speed_um_per_s: float) -> Path:
    return lambda t: speed_um_per_s * np.outer(t, [0.6, 0.8])


def minimum_jerk(duration_s: float, distance_um: float = 10_000.0) -> Path:
    """Return the minimum-jerk motion, its polynomial continued outside."""

    def path(t_s: FloatArray) -> FloatArray:
        u = t_s / duration_s
        return np.column_stack([distance_um * (10 * u**3 - 15 * u**4 + 6 * u**5), np.zeros_like(u)])

    return path


def minimum_jerk_jerk(duration_s: float, rate_hz: float, distance_um: float = 10_000.0) -> FloatArray:
    u = np.arange(round(duration_s * rate_hz) + 1) / (duration_s * rate_hz)
    return np.column_stack([distance_um / duration_s**3 * (60 - 360 * u + 360 * u**2), np.zeros_like(u)])


@pytest.mark.parametrize(
    ("radius_um", "speed_um_per_s", "g", "g_within", "s", "s_within"),
    [
        (1000.0, 1000.0, -3.0, 0.004, 0.0, 3e-5),
        (1000.0, 2000.0, -3.0, 0.015, 1.20412, 4.5e-4),
        (28_184.0, 2400.0, -4.450, 1e-3, -4.27917, 1e-4),
    ],
)
def test_circle(
    radius_um: float, speed_um_per_s: float, g: float, g_within: float, s: float, s_within: float
) -> None:
    moved = motions(times(20), circle(radius_um, speed_um_per_s))
    assert straightness(moved).value == pytest.approx(g, abs=g_within)
    assert smoothness(moved).value == pytest.approx(s, abs=s_within)
    assert average_speed_um_per_s(moved) == pytest.approx(speed_um_per_s, rel=2e-3)


@pytest.mark.parametrize(("sigma_s", "s"), [(0.5, -1.80618), (1.0, 0.0), (2.0, 1.80618)])
def test_smoothness_of_a_circle_grows_with_the_sixth_power_of_sigma(sigma_s: float, s: float) -> None:
    moved = motions(times(20), circle(1000.0, 1000.0))
    assert smoothness(moved, sigma_s).value == pytest.approx(s, abs=3e-5)


def test_ellipse_over_whole_periods() -> None:
    a_um, b_um, period_s = 4000.0, 2000.0, 20.0
    closed_form = math.log10(a_um * b_um / ((a_um**2 + b_um**2) / 2) ** 1.5)
    assert closed_form == pytest.approx(-3.59691, abs=1e-5)

    def path(t_s: FloatArray) -> FloatArray:
        angle = 2 * math.pi * t_s / period_s
        return np.column_stack([a_um * np.cos(angle), b_um * np.sin(angle)])

    # The filter takes ten samples at each end.
    moved = motions(times(period_s + 20 / 30), path)
    assert straightness(moved).value == pytest.approx(closed_form, abs=1e-3)


@pytest.mark.parametrize(("sigma_s", "s"), [(1.0, 1.68757), (2.0, 3.49375)])
def test_sinusoidal_speed_on_a_straight_line(sigma_s: float, s: float) -> None:
    omega = math.pi  # 0.5 Hz: σ is a whole number of half-periods
    assert math.log10(sigma_s**6 * omega**4 / 2) == pytest.approx(s, abs=1e-5)
    moved = motions(times(30), lambda t: np.outer(-1000.0 / omega * np.cos(omega * t), [0.6, 0.8]))
    assert smoothness(moved, sigma_s).value == pytest.approx(s, abs=0.0025)


@pytest.mark.parametrize(("duration_s", "s"), [(1.0, 2.31133), (2.0, 2.91339), (10.0, 4.31133)])
def test_minimum_jerk_with_sigma_of_its_duration(duration_s: float, s: float) -> None:
    peak = 1.875 * 10_000.0 / duration_s
    costs = jerk_cost(minimum_jerk_jerk(duration_s, 3000.0), 3000.0, duration_s, peak)
    assert np.log10(costs) == pytest.approx([s], abs=1e-5)


@pytest.mark.parametrize(
    ("duration_s", "s", "within"), [(2.0, 0.97400, 0.005), (4.0, -0.28720, 0.017), (10.0, -1.86517, 0.017)]
)
def test_minimum_jerk_with_windows_inside_the_motion(duration_s: float, s: float, within: float) -> None:
    peak = 1.875 * 10_000.0 / duration_s

    def total(tau: FloatArray) -> FloatArray:
        return 3600 * tau - 21600 * tau**2 + 57600 * tau**3 - 64800 * tau**4 + 25920 * tau**5

    tau = times(duration_s, begin_s=1.0) / duration_s
    exact = (total(tau) - total(tau - 1 / duration_s)) / duration_s**5 / (1.875 / duration_s) ** 2
    assert np.median(np.log10(exact)) == pytest.approx(s, abs=1e-5)
    fine = jerk_cost(minimum_jerk_jerk(duration_s, 3000.0), 3000.0, 1.0, peak)[::100]
    assert np.log10(fine) == pytest.approx(np.log10(exact), abs=1e-4)
    # With the filter: the polynomial goes on for half a window, so the jerk covers the motion alone.
    moved = motions(times(duration_s + 0.5, begin_s=-0.5), minimum_jerk(duration_s))
    assert smoothness(moved).value == pytest.approx(s, abs=within)


def test_log_dimensionless_jerk_of_minimum_jerk() -> None:
    u = np.linspace(0.0, 1.0, 20_001)
    speed = 30 * u**2 * (1 - u) ** 2
    assert log_dimensionless_jerk(speed, 20_000.0) == pytest.approx(-5.32203, abs=2e-4)
    assert math.log(204.8) == pytest.approx(5.32203, abs=1e-5)


def test_the_published_examples_of_sparc_and_ldlj() -> None:
    # The example of the authors' own script: a Gaussian speed profile at 100 Hz.
    speed = np.exp(-5 * np.arange(-1, 1, 0.01) ** 2)
    assert spectral_arc_length(speed, 100.0) == pytest.approx(-1.41403, abs=5e-6)
    assert log_dimensionless_jerk(speed, 100.0) == pytest.approx(-5.81636, abs=5e-6)
    assert -math.exp(-log_dimensionless_jerk(speed, 100.0)) == pytest.approx(-335.74684, abs=5e-6)


def test_a_straight_line_at_constant_speed_lies_on_the_floors() -> None:
    moved = motions(times(10), line(1000.0))
    g, s = straightness(moved), smoothness(moved)
    assert (g.value, g.floored_share, g.moving_share) == (-6.0, 1.0, 1.0)
    assert (s.value, s.floored_share) == (-6.0, 1.0)


def drop_every_seventh(t_s: FloatArray) -> FloatArray:
    kept: FloatArray = t_s[np.arange(t_s.size) % 7 != 0]
    return kept


def drop_one_second(t_s: FloatArray) -> FloatArray:
    kept: FloatArray = t_s[(t_s < 9.0) | (t_s > 10.0)]
    return kept


@pytest.mark.parametrize("drop", [drop_every_seventh, drop_one_second])
def test_lost_frames_change_nothing(drop: Callable[[FloatArray], FloatArray]) -> None:
    moved = motions(drop(times(20)), circle(1000.0, 1000.0))
    assert straightness(moved).value == pytest.approx(-3.0037, abs=1e-4)
    assert smoothness(moved).value == pytest.approx(0.0, abs=3e-4)


def test_uneven_frames_are_taken_at_their_own_times() -> None:
    jitter_s = np.random.default_rng(1).uniform(-0.01, 0.01, 601)
    moved = motions(times(20) + jitter_s, circle(1000.0, 1000.0))
    assert straightness(moved).value == pytest.approx(-3.0037, abs=1e-4)
    assert smoothness(moved).value == pytest.approx(0.0, abs=3e-3)


def test_tremor_raises_s() -> None:
    def trembling(amplitude_um: float) -> float:
        def path(t_s: FloatArray) -> FloatArray:
            return circle(1500.0, 1000.0)(t_s) + amplitude_um * np.outer(
                np.sin(2 * math.pi * 1.5 * t_s), [1, 0]
            )

        return smoothness(motions(times(20), path)).value

    values = [trembling(amplitude_um) for amplitude_um in (0.0, 10.0, 30.0, 100.0)]
    assert values[0] == pytest.approx(4 * math.log10(1000 / 1500), abs=1e-3)
    assert values == sorted(values)
    assert values[-1] - values[0] > 2.0


def test_filter_gains_behind_the_floors() -> None:
    acceleration = savgol_coeffs(21, 3, deriv=2, delta=1 / 30)
    jerk = savgol_coeffs(31, 5, deriv=3, delta=1 / 30)
    assert math.sqrt((acceleration**2).sum()) == pytest.approx(12.0, rel=0.005)
    assert math.sqrt((jerk**2).sum()) == pytest.approx(237.0, rel=0.005)


def test_noise_on_a_straight_line_gives_the_floors() -> None:
    sigma_um, speed = 5.0, 2400.0
    t_s = times(300)
    noise_um = np.random.default_rng(7).normal(0.0, sigma_um, (t_s.size, 2))
    moved = motions(t_s, lambda t: line(speed)(t) + noise_um)
    assert straightness(moved).value == pytest.approx(straightness_floor(sigma_um, speed), abs=0.05)
    assert smoothness(moved).value == pytest.approx(
        smoothness_floor(sigma_um, peak_speed_um_per_s(moved)), abs=0.1
    )


def test_noise_hardly_moves_the_straightness_of_a_curve() -> None:
    t_s = times(120)
    noise_um = np.random.default_rng(3).normal(0.0, 5.0, (t_s.size, 2))
    path = circle(10_471.0, 2400.0)
    clean, noisy = (straightness(motions(t_s, each)).value for each in (path, lambda t: path(t) + noise_um))
    assert clean == pytest.approx(-4.02, abs=0.005)
    assert noisy == pytest.approx(-4.03, abs=0.03)


def test_nothing_that_moves_gives_nothing() -> None:
    still = motions(times(10), lambda t: np.zeros((t.size, 2)))
    assert math.isnan(straightness(still).value)
    assert straightness(still).moving_share == 0.0
    assert math.isnan(smoothness(still).value)
    assert math.isnan(first_motion_s(still))
    for empty in (straightness([]), smoothness([])):
        assert math.isnan(empty.value)
    assert math.isnan(average_speed_um_per_s([]))
    assert math.isnan(log_dimensionless_jerk(np.zeros(100), 30.0))
    assert math.isnan(spectral_arc_length(np.zeros(100), 30.0))


def test_only_samples_that_move_count_for_straightness() -> None:
    def path(t_s: FloatArray) -> FloatArray:
        return circle(1000.0, 1000.0)(np.clip(t_s, 0.0, 10.0))

    g = straightness(motions(times(20), path))
    assert g.value == pytest.approx(-3.0037, abs=1e-3)
    assert g.moving_share == pytest.approx(0.5, abs=0.05)


def test_stamps_that_repeat_or_fall_and_unseen_robots_are_dropped() -> None:
    t_s = times(20)
    xy_um = circle(1000.0, 1000.0)(t_s)
    messy_s = np.concatenate([t_s, t_s[100:110]])
    messy_um = np.concatenate([xy_um, np.full((10, 2), 1e6)])
    order = np.argsort(messy_s, kind="stable")
    messy_s, messy_um = messy_s[order], messy_um[order]
    messy_um[50] = np.nan
    messy_s = np.append(messy_s, 3.0)
    messy_um = np.append(messy_um, [[-1e6, 0.0]], axis=0)
    (segment,) = segments(messy_s, messy_um)
    assert np.hypot(*segment.xy_um.T) == pytest.approx(1000.0, abs=0.1)


def test_a_gap_of_more_than_a_fifth_of_a_second_splits() -> None:
    t_s = times(10)
    xy_um = line(1000.0)(t_s)
    assert len(segments(t_s, xy_um)) == 1
    for lost, pieces in ((5, 1), (6, 2)):
        kept = (t_s < 4.99) | (t_s > 4.99 + lost / 30)
        assert len(segments(t_s[kept], xy_um[kept])) == pieces
    assert segments(np.array([np.nan]), np.array([[0.0, 0.0]])) == []


def test_another_camera_rate_gives_the_same_metrics() -> None:
    t_s = np.arange(0, 20, 1 / 24.0)
    moved = motions(t_s, circle(1000.0, 1000.0))
    assert straightness(moved).value == pytest.approx(-3.0037, abs=1e-4)
    assert smoothness(moved).value == pytest.approx(0.0, abs=1e-3)


def test_contact_starts_are_where_a_contact_begins() -> None:
    t_s = 0.11 * np.arange(7, dtype=np.float64)
    clearance_um = np.array([50.0, -1.0, np.nan, 30.0, 30.0, 30.0, -1.0])
    assert contact_starts(t_s, clearance_um) == [1, 6]


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
    assert straight.straightness_near_floor
    assert straight.smoothness_near_floor
    curved = trial_metrics(trial(t_s, circle(1000.0, 2400.0)(t_s) + noise_um))
    assert not curved.straightness_near_floor
    assert not curved.smoothness_near_floor


def test_a_robot_that_was_never_seen_gives_no_motion() -> None:
    t_s = times(20)
    metrics = trial_metrics(
        trial(t_s, np.full((t_s.size, 2), np.nan), clearance_um=np.full(t_s.size, np.nan))
    )
    assert math.isnan(metrics.average_speed_um_per_s)
    assert math.isnan(metrics.straightness.value)
    assert not metrics.straightness_near_floor
    assert metrics.contacts == 0
    assert metrics.seen_share == 0.0
