"""The mean over a span that slides, against closed forms."""

import math

import pytest

from mrnav_server.core.moving_mean import MovingMean


def test_a_step_becomes_a_ramp_of_the_span() -> None:
    mean = MovingMean()
    mean.add((0.0, 2.0), 0.0)
    mean.add((1.0, 2.0), 10.0)
    assert mean.mean(0.4, 10.1) == pytest.approx((0.25, 2.0))
    assert mean.mean(0.4, 10.3) == pytest.approx((0.75, 2.0))
    assert mean.mean(0.4, 11.0) == pytest.approx((1.0, 2.0))


def test_no_span_is_the_newest_value() -> None:
    mean = MovingMean()
    mean.add((1.0,), 0.0)
    mean.add((5.0,), 1.0)
    assert mean.mean(0.0, 1.0) == (5.0,)


def test_a_vibration_of_the_spans_period_vanishes() -> None:
    mean = MovingMean()
    for step in range(3000):
        mean.add((math.sin(2 * math.pi * step / 120),), step / 1000)
    assert mean.mean(0.12, 2.999) == pytest.approx((0.0,), abs=1e-9)
