"""Offset and friction from approaches, critical height from a descent."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.errors import RefusedError
from mrnav_server.vision.magnet_fit import fit_height, fit_magnet


def headings(count: int = 4, first: float = 0.2, turn: float = 2 * np.pi) -> FloatArray:
    angles = first + turn * np.arange(count) / count
    return np.column_stack([np.cos(angles), np.sin(angles)])


@given(x=st.floats(-3000, 3000), y=st.floats(-3000, 3000), lead=st.floats(0, 1000), count=st.integers(4, 12))
def test_offset_and_lead_come_back(x: float, y: float, lead: float, count: int) -> None:
    along = headings(count)
    fit = fit_magnet(np.array([x, y]) + lead * along, along)
    assert fit.offset_um == pytest.approx((x, y), abs=1e-6)
    assert fit.friction_lead_um == pytest.approx(lead, abs=1e-6)
    assert fit.rms_um < 1e-6


def test_the_mean_is_the_offset_and_half_the_spread_the_lead() -> None:
    along = headings(first=0.0)
    gaps = np.array([[1400.0, 10.0], [1000.0, 420.0], [600.0, -10.0], [1000.0, -380.0]])
    fit = fit_magnet(gaps, along)
    assert fit.offset_um == pytest.approx((1000.0, 10.0))
    assert fit.friction_lead_um == pytest.approx(400.0)
    # Four approaches are eight equations; three numbers are fitted.
    assert fit.rms_um == pytest.approx(np.sqrt(np.sum((gaps - [1000.0, 10.0] - 400.0 * along) ** 2) / 2.5))
    assert fit.rms_um > 0.0


@pytest.mark.parametrize(
    ("along", "said"),
    [
        (headings(3), "not enough"),
        (headings(6, turn=np.pi), "one side"),
        (np.array([[1.0, 0.0], [-1.0, 0.0]] * 2), "one side"),
    ],
)
def test_one_sided_approaches_are_refused(along: FloatArray, said: str) -> None:
    with pytest.raises(RefusedError, match=said):
        fit_magnet(300.0 * along, along)


def test_a_robot_that_does_not_follow_is_refused() -> None:
    along = headings()
    with pytest.raises(RefusedError, match="contradict"):
        fit_magnet(np.array([[0.0, 0.0], [878.0, 1162.0], [878.0, 1162.0], [878.0, 1162.0]]), along)
    with pytest.raises(RefusedError, match="ahead of the magnet"):
        fit_magnet(-500.0 * along, along)


def test_the_height_lies_between_the_last_stop_and_the_next() -> None:
    fit = fit_height(np.array([13_000.0, 12_900.0, 12_800.0, 12_700.0]), [True, True, True, False], 2000.0)
    assert fit.critical_height_um == pytest.approx(10_750.0)
    assert (fit.step_um, fit.jump_z_um) == pytest.approx((100.0, 12_700.0))


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        ([], "no robot"),
        ([False, False], "no robot"),
        ([True, True], "did not jump"),
        ([True, False, True], "again"),
    ],
)
def test_a_descent_without_a_jump_is_refused(seen: list[bool], said: str) -> None:
    with pytest.raises(RefusedError, match=said):
        fit_height(np.array([13_000.0 - 100.0 * stop for stop in range(len(seen))]), seen, 2000.0)
