import math

import numpy as np
import pytest

from mrnav_server.core.speed_profile import log_dimensionless_jerk, spectral_arc_length


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


def test_log_dimensionless_jerk_of_motions_in_a_row() -> None:
    u = np.linspace(0.0, 1.0, 20_001)
    speed = np.tile((30 * u**2 * (1 - u) ** 2)[:-1], 3)
    assert log_dimensionless_jerk(speed, 20_000.0) == pytest.approx(-math.log(204.8 * 3**4), abs=1e-3)


def test_a_profile_keeps_its_smoothness_at_another_speed_and_duration() -> None:
    speed = np.exp(-5 * np.arange(-1, 1, 0.01) ** 2)
    assert log_dimensionless_jerk(1700.0 * speed, 25.0) == pytest.approx(-5.81636, abs=5e-6)
    assert spectral_arc_length(1700.0 * speed, 100.0) == pytest.approx(-1.41403, abs=5e-6)


def test_more_stops_are_less_smooth() -> None:
    t_s = np.arange(0.0, 8.0, 1 / 30)
    once, often = np.sin(np.pi * t_s / 8) ** 2, np.sin(np.pi * t_s) ** 2
    assert spectral_arc_length(often, 30.0) < spectral_arc_length(once, 30.0) - 1.0
    assert log_dimensionless_jerk(often, 30.0) < log_dimensionless_jerk(once, 30.0) - 1.0


def test_a_robot_that_stands_has_no_smoothness() -> None:
    assert math.isnan(log_dimensionless_jerk(np.zeros(100), 30.0))
    assert math.isnan(spectral_arc_length(np.zeros(100), 30.0))
