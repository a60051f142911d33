import math
from collections.abc import Callable

import numpy as np
import pytest

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.motion_metrics import (
    average_speed_um_per_s,
    first_motion_s,
    jerk_cost,
    path_length_um,
    peak_speed_um_per_s,
    smoothness,
    straightness,
)
from tests.core.trajectories import (
    archimedean_spiral,
    circle,
    figure_of_eight,
    line,
    logarithmic_spiral,
    minimum_jerk,
    motions,
    repeated_minimum_jerk,
    times,
)


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
    ("duration_s", "s", "within"), [(2.0, 0.97400, 0.001), (4.0, -0.28720, 0.001), (10.0, -1.86517, 0.001)]
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


def test_a_straight_line_at_constant_speed_lies_on_the_floors() -> None:
    moved = motions(times(10), line(1000.0))
    g, s = straightness(moved), smoothness(moved)
    assert (g.value, g.floored_share, g.moving_share) == (-6.0, 1.0, 1.0)
    assert (s.value, s.floored_share) == (-6.0, 1.0)


def test_logarithmic_spiral() -> None:
    start_um, growth, rate = 2000.0, 0.05, 1.0
    moved = motions(times(20), logarithmic_spiral(start_um, growth, rate))
    first_s, last_s = moved[0].t_s[[0, -1]]
    radius_um = start_um * np.exp(growth * rate * np.array([first_s, (first_s + last_s) / 2, last_s]))
    slant = math.sqrt(1 + growth**2)
    # κ = 1 / (r·√(1 + b²)) falls steadily, so its median is the value in the middle.
    assert straightness(moved).value == pytest.approx(-math.log10(radius_um[1] * slant), abs=0.004)
    length_um = (radius_um[2] - radius_um[0]) * slant / growth
    assert path_length_um(moved) == pytest.approx(length_um, rel=0.004)
    # |jerk| = (√(1 + b²)·ω)³·r, so the logarithm of φ rises steadily too.
    jerk_s = moved[0].jerk_t_s
    window_ends_s = (jerk_s[0] + 1.0 + jerk_s[-1]) / 2
    r_end_um, r_begin_um = start_um * np.exp(growth * rate * np.array([window_ends_s, window_ends_s - 1.0]))
    integral = (slant * rate) ** 6 * (r_end_um**2 - r_begin_um**2) / (2 * growth * rate)
    closed_form = math.log10(integral / (slant * rate * radius_um[2]) ** 2)
    assert smoothness(moved).value == pytest.approx(closed_form, abs=0.004)


def test_archimedean_spiral() -> None:
    start_um, pitch_um, rate = 1000.0, 200.0, 1.0
    moved = motions(times(20), archimedean_spiral(start_um, pitch_um, rate))
    radius_um = start_um + pitch_um * rate * (moved[0].t_s[0] + moved[0].t_s[-1]) / 2
    curvature = (radius_um**2 + 2 * pitch_um**2) / (radius_um**2 + pitch_um**2) ** 1.5
    assert straightness(moved).value == pytest.approx(math.log10(curvature), abs=0.004)


def test_figure_of_eight_over_whole_periods() -> None:
    size_um, rate, sigma_s = 3000.0, math.pi / 2, 2.0
    # ∫|jerk|² over half a period is 8.5·σ·(size·ω³)², and the crossing's speed v_p is √2·size·ω.
    closed_form = math.log10(sigma_s**6 * 4.25 * rate**4)
    moved = motions(times(24 + 20 / 30), figure_of_eight(size_um, rate))
    assert peak_speed_um_per_s(moved) == pytest.approx(math.sqrt(2) * size_um * rate, rel=0.002)
    assert smoothness(moved, sigma_s).value == pytest.approx(closed_form, abs=0.005)
    phase = np.linspace(0.0, 2 * math.pi, 100_001)
    bend = np.abs(2 * np.sin(phase) * np.sin(2 * phase) + np.cos(phase) * np.cos(2 * phase))
    curvature = bend / size_um / (np.sin(phase) ** 2 + np.cos(2 * phase) ** 2) ** 1.5
    assert straightness(moved).value == pytest.approx(np.log10(np.median(curvature)), abs=0.015)


def test_minimum_jerk_motions_in_a_row() -> None:
    duration_s, distance_um = 10.0, 10_000.0
    moved = motions(times(4 * duration_s), repeated_minimum_jerk(duration_s, distance_um))
    assert peak_speed_um_per_s(moved) == pytest.approx(1.875 * distance_um / duration_s, rel=0.003)
    # Each window of a whole motion holds the same jerk, wherever it begins.
    closed_form = math.log10(204.8) + 2 * math.log10(duration_s)
    assert smoothness(moved, duration_s).value == pytest.approx(closed_form, abs=0.001)
    assert straightness(moved).value == -6.0


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


def test_only_samples_that_move_count_for_straightness() -> None:
    def path(t_s: FloatArray) -> FloatArray:
        return circle(1000.0, 1000.0)(np.clip(t_s, 0.0, 10.0))

    g = straightness(motions(times(20), path))
    assert g.value == pytest.approx(-3.0037, abs=1e-3)
    assert g.moving_share == pytest.approx(0.5, abs=0.05)


def test_another_camera_rate_gives_the_same_metrics() -> None:
    t_s = np.arange(0, 20, 1 / 24.0)
    moved = motions(t_s, circle(1000.0, 1000.0))
    assert straightness(moved).value == pytest.approx(-3.0037, abs=1e-4)
    assert smoothness(moved).value == pytest.approx(0.0, abs=1e-3)
