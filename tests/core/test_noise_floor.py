import math

import numpy as np
import pytest
from scipy.signal import savgol_coeffs

from mrnav_server.core.motion_metrics import peak_speed_um_per_s, smoothness, straightness
from mrnav_server.core.noise_floor import noise_um, smoothness_floor, straightness_floor
from tests.core.trajectories import circle, line, motions, times


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


@pytest.mark.parametrize("uneven_s", [0.0, 0.01])
def test_a_tracks_noise_is_judged_by_the_track(uneven_s: float) -> None:
    rng = np.random.default_rng(11)
    t_s = times(60) + rng.uniform(-uneven_s, uneven_s, 1801)
    for sigma_um in (0.5, 5.0):
        noisy_um = circle(1000.0, 2000.0)(t_s) + rng.normal(0.0, sigma_um, (t_s.size, 2))
        noisy_um[700] += 800.0
        assert noise_um(t_s, noisy_um) == pytest.approx(sigma_um, rel=0.1)


def test_motion_alone_is_no_noise() -> None:
    t_s = times(20)
    assert noise_um(t_s, circle(1000.0, 2000.0)(t_s)) < 0.01
    assert math.isnan(noise_um(t_s[:4], np.zeros((4, 2))))
