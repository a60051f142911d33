"""The point filter against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.vision.kalman import PointFilter

steps_s = st.floats(min_value=1e-3, max_value=0.5)


@given(first_s=steps_s, second_s=steps_s, density=st.floats(min_value=0.0, max_value=1e6))
def test_two_predictions_are_one_over_their_sum(first_s: float, second_s: float, density: float) -> None:
    split, whole = (PointFilter((3.0, 4.0), 2.0, 50.0, density) for _ in range(2))
    for point in (split, whole):
        point.predict(0.1)
        point.correct((5.0, 1.0), 0.5)
    split.predict(first_s)
    split.predict(second_s)
    whole.predict(first_s + second_s)
    assert split.position_px == pytest.approx(whole.position_px)
    assert split.sigma_px == pytest.approx(whole.sigma_px)


@given(prior=st.floats(0.1, 10.0), measured=st.floats(0.1, 10.0))
def test_a_correction_is_the_mean_weighted_by_inverse_variance(prior: float, measured: float) -> None:
    point = PointFilter((0.0, 10.0), prior, 1.0, 0.0)
    point.correct((1.0, 20.0), measured)
    share = prior**2 / (prior**2 + measured**2)
    assert point.position_px == pytest.approx((share, 10.0 + 10.0 * share))
    assert point.sigma_px == pytest.approx(prior * measured / np.hypot(prior, measured))


def test_without_process_noise_it_is_the_least_squares_line() -> None:
    rng = np.random.default_rng(3)
    count, dt_s, sigma_px = 20, 1.0 / 30.0, 0.4
    times_s = dt_s * np.arange(count)
    measured = np.column_stack([5.0 + 40.0 * times_s, 9.0 - 7.0 * times_s]) + rng.normal(
        0, sigma_px, (count, 2)
    )
    point = PointFilter((0.0, 0.0), 1e4, 1e6, 0.0)
    for k in range(count):
        point.predict(dt_s if k else 0.0)
        point.correct((measured[k, 0], measured[k, 1]), sigma_px)
    slope, intercept = np.polyfit(times_s, measured, 1)
    assert point.velocity_px_per_s == pytest.approx(tuple(slope), rel=1e-4)
    assert point.position_px == pytest.approx(tuple(intercept + slope * times_s[-1]), rel=1e-6)
    # Variance of a fitted line at its last of n points: 2(2n - 1) / (n(n + 1)) of one measurement's.
    closed = sigma_px * np.sqrt(2.0 * (2 * count - 1) / (count * (count + 1)))
    assert point.sigma_px == pytest.approx(closed, rel=1e-5)


def test_unsteadiness_grows_as_the_cube_of_time() -> None:
    point = PointFilter((0.0, 0.0), 0.0, 0.0, 12.0)
    point.predict(2.0)
    assert point.sigma_px == pytest.approx(np.sqrt(12.0 * 2.0**3 / 3.0))
