"""The arithmetic behind the comparison with real pictures; nothing is fetched."""

import numpy as np
import pytest

from benchmarks.real_particles import against_sigma, bright_core, circle_fit, outline, pairs, summary


def test_a_circle_is_fitted_to_an_arc() -> None:
    angle = np.linspace(0.2, 2.2, 40)
    found = circle_fit(7.3 + 12.5 * np.cos(angle), -4.1 + 12.5 * np.sin(angle))
    assert found == pytest.approx((7.3, -4.1, 12.5), abs=1e-6)


def test_scatter_leaves_out_what_is_constant_for_each_thing() -> None:
    off_px = np.array([[0.3, 0.1], [0.3, -0.1], [-0.4, 0.1], [-0.4, -0.1]])
    figures = summary(off_px, [0, 0, 1, 1], 10.0)
    assert figures["rms_px"] == pytest.approx(np.sqrt(0.125 + 0.01), abs=1e-4)
    assert figures["rms_radii"] == pytest.approx(0.1 * figures["rms_px"], abs=1e-4)
    assert figures["scatter_px"] == pytest.approx(0.1)


def test_nothing_compared_is_said() -> None:
    assert summary(np.zeros((0, 2)), [], 10.0) == {"n": 0}
    assert against_sigma(np.zeros((0, 2)), []) == {}


def test_differences_are_counted_in_stated_sigmas() -> None:
    figures = against_sigma(np.array([[0.3, 0.4], [0.0, 0.1]]), [0.1, 0.1])
    assert figures["median_in_sigma"] == pytest.approx(3.0)
    assert figures["within_4_sigma"] == 0.5


def test_only_things_that_both_found_are_paired() -> None:
    places = {"rim": {}, "a": {(0, 0): (1.0, 1.0), (0, 1): (2.0, 2.0)}, "b": {(0, 0): (1.0, 1.5)}}
    assert pairs(places, 10.0)["a - b"]["rms_px"] == pytest.approx(0.5)


def test_the_independent_locators_see_a_drawn_sphere() -> None:
    y, x = np.mgrid[0:90, 0:90]
    away = np.hypot(x - 44.3, y - 45.6)
    edge = 0.5 - 0.5 * np.tanh(away - 10.0)
    core = 0.5 - 0.5 * np.tanh(away - 6.0)
    gray = np.rint(140.0 - 50.0 * edge + 140.0 * core).astype(np.uint8)
    for locate in (outline, bright_core):
        assert locate(gray, (44.0, 46.0), 10.0) == pytest.approx((44.3, 45.6), abs=0.05)
