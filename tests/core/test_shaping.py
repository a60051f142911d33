"""The shaper: bounds on speed, acceleration and jerk across any switch of reference."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrnav_server.core.frames import StagePoint
from mrnav_server.core.limits import Limits
from mrnav_server.core.shaping import Reference, Shaper

LIMITS = Limits()
coordinate = st.floats(-20_000, 20_000)
rate = st.floats(-4000, 4000)
references = st.one_of(
    st.none(),
    st.builds(
        lambda x, y, z, vx, vy: Reference(StagePoint(x, y, z), (vx, vy, 0.0), 3000.0),
        coordinate,
        coordinate,
        coordinate,
        rate,
        rate,
    ),
)


def running_at(speed_um_per_s: float) -> Shaper:
    shaper = Shaper(LIMITS)
    for _ in range(200):
        shaper.step(0.01, Reference(StagePoint(1e7, 0, 0), (speed_um_per_s, 0, 0), speed_um_per_s))
    return shaper


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(references, st.integers(1, 60)), min_size=1, max_size=12))
def test_bounds_hold_across_any_switch(plan: list[tuple[Reference | None, int]]) -> None:
    shaper = Shaper(LIMITS)
    before = np.zeros(3)
    for reference, steps in plan:
        for _ in range(steps):
            shaper.step(0.001, reference)
            acceleration = np.array(shaper.acceleration_um_per_s2)
            assert np.linalg.norm(acceleration - before) / 0.001 <= LIMITS.jerk_um_per_s3 * (1 + 1e-9)
            assert np.linalg.norm(acceleration) <= LIMITS.acceleration_um_per_s2 * (1 + 1e-9)
            assert shaper.speed_um_per_s <= 3000.0 * (1 + 1e-6)
            before = acceleration


def test_it_stops_from_full_speed_within_the_promised_path() -> None:
    shaper = running_at(3000.0)
    start_um, elapsed_s = shaper.position.x_um, 0.0
    while not shaper.at_rest:
        shaper.step(0.001, None)
        elapsed_s += 0.001
    # v/a + a/J = 150 ms and about v·t/2 = 225 µm; the servo's tail below 30 µm/s adds time, not path.
    assert 200.0 < shaper.position.x_um - start_um < 240.0
    assert elapsed_s < 0.25


@settings(max_examples=40, deadline=None)
@given(st.floats(100.0, 4000.0), st.integers(1, 400))
def test_it_knows_where_it_comes_to_rest(speed_um_per_s: float, milliseconds: int) -> None:
    """While it speeds up as well as at its speed."""
    shaper = Shaper(LIMITS)
    for _ in range(milliseconds):
        shaper.step(0.001, Reference(StagePoint(1e7, 0, 0), (speed_um_per_s, 0, 0), speed_um_per_s))
    expected_um, start_um = shaper.rest_point.x_um, shaper.position.x_um
    while not shaper.at_rest:
        shaper.step(0.001, None)
    assert shaper.position.x_um == pytest.approx(expected_um, abs=0.06 * (expected_um - start_um) + 5.0)


def test_it_follows_a_moving_reference_without_lag() -> None:
    shaper = Shaper(LIMITS)
    worst_um = 0.0
    for k in range(600):
        t_s, w = 0.01 * k, math.pi
        shaper.step(
            0.01,
            Reference(StagePoint(500 * math.sin(w * t_s), 0, 0), (500 * w * math.cos(w * t_s), 0, 0), 3000),
        )
        if k > 100:
            worst_um = max(worst_um, abs(shaper.position.x_um - 500 * math.sin(w * (t_s + 0.01))))
    assert worst_um < 10.0


def test_it_arrives_without_overshoot_and_rests() -> None:
    shaper, farthest_um = Shaper(LIMITS), 0.0
    for _ in range(300):
        farthest_um = max(
            farthest_um, shaper.step(0.01, Reference(StagePoint(2000, 0, 0), (0, 0, 0), 3000)).x_um
        )
    assert farthest_um < 2040.0
    assert abs(shaper.position.x_um - 2000.0) < 1.0


def test_a_stall_of_the_process_is_not_a_leap() -> None:
    shaper = running_at(3000.0)
    before_um = shaper.position.x_um
    shaper.step(3.0, Reference(StagePoint(1e7, 0, 0), (3000, 0, 0), 3000))
    assert shaper.position.x_um - before_um < 3000 * 0.051


def test_a_switch_moves_only_the_reference() -> None:
    shaper = running_at(2000.0)
    position, velocity = shaper.position, shaper.velocity_um_per_s
    shaper.step(0.0, Reference(StagePoint(0, 0, 0), (0, 0, 0), 3000))
    assert (shaper.position, shaper.velocity_um_per_s) == (position, velocity)
