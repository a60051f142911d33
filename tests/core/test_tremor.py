"""The tremor filter: what it suppresses, what it costs, and that steps of any length agree."""

import math

import pytest

from mrnav_server.core.tremor import TremorFilter, response


@pytest.mark.parametrize("frequency_hz", [8.0, 8.5, 9.0, 9.5, 10.0, 10.5, 11.0, 11.5, 12.0])
def test_tremor_is_ten_decibels_down(frequency_hz: float) -> None:
    assert 20.0 * math.log10(abs(response(10.0, frequency_hz))) < -10.0


def test_slow_motion_passes_whole_and_soon() -> None:
    slow_hz = 0.05
    gain = response(10.0, slow_hz)
    assert abs(gain) == pytest.approx(1.0, abs=0.001)
    delay_s = -math.atan2(gain.imag, gain.real) / (2.0 * math.pi * slow_hz)
    assert delay_s == pytest.approx(0.0238, abs=0.0005)
    assert max(abs(response(10.0, 0.1 * k)) for k in range(1, 80)) < 10 ** (0.1 / 20)


def test_many_short_steps_are_one_long_one() -> None:
    once, often = TremorFilter(), TremorFilter()
    once.advance((100.0, 0.0, -5.0), 0.033)
    for k in range(1, 34):
        often.advance((100.0 * k / 33, 0.0, -5.0 * k / 33), 0.001)
    assert often.position_um == pytest.approx(once.position_um)
    assert often.velocity_um_per_s == pytest.approx(once.velocity_um_per_s)


def test_it_comes_to_rest_on_its_goal_and_its_velocity_is_its_slope() -> None:
    smooth, moved_um = TremorFilter(), 0.0
    for _ in range(2000):
        smooth.advance((100.0, 0.0, 0.0), 0.0005)
        moved_um += 0.0005 * smooth.velocity_um_per_s[0]
    assert smooth.position_um == pytest.approx((100.0, 0.0, 0.0), abs=1e-6)
    assert moved_um == pytest.approx(100.0, rel=0.01)
