"""The rim fit on synthetic discs, whose centres are known exactly."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrnav_server.core.arrays import ByteArray
from mrnav_server.vision.rim import RimFit

SIDE = 200


def disc(
    x_px: float, y_px: float, radius_px: float, inside: float, outside: float, noise: float = 0.0
) -> ByteArray:
    """Draw a disc with a soft rim about two pixels wide."""
    y, x = np.mgrid[0:SIDE, 0:SIDE]
    cover = 1.0 / (1.0 + np.exp((np.hypot(x - x_px, y - y_px) - radius_px) * 2.0))
    picture = outside + (inside - outside) * cover
    picture += np.random.default_rng(5).normal(0.0, noise, picture.shape) if noise else 0.0
    drawn: ByteArray = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    return drawn


offsets = st.floats(min_value=-4.0, max_value=4.0)


@settings(max_examples=60, deadline=None)
@given(
    radius_px=st.floats(16.0, 60.0),
    x_px=st.floats(90.0, 110.0),
    y_px=st.floats(90.0, 110.0),
    guess=st.tuples(offsets, offsets),
    inside=st.floats(10.0, 90.0),
    noise=st.sampled_from([0.0, 3.0]),
)
def test_a_disc_is_found_to_a_small_part_of_a_pixel(
    radius_px: float, x_px: float, y_px: float, guess: tuple[float, float], inside: float, noise: float
) -> None:
    rim = RimFit(radius_px, 25.0, 0.01)
    picture = disc(x_px, y_px, radius_px, inside, 190.0, noise)
    share = min(1.0, rim.reach_px / 8.0)
    found = rim.fit(picture, x_px + share * guess[0], y_px + share * guess[1])
    assert np.hypot(found.x_px - x_px, found.y_px - y_px) < (0.1 if noise else 0.05)
    assert abs(found.radius_px - radius_px) < 0.1
    assert found.confidence > 0.9
    assert found.sigma_px < 0.1


@settings(max_examples=30, deadline=None)
@given(level=st.floats(30.0, 200.0), x_px=st.floats(0.0, 199.0), y_px=st.floats(0.0, 199.0))
def test_nothing_is_believed_in_bare_noise(level: float, x_px: float, y_px: float) -> None:
    picture = np.random.default_rng(9).normal(level, 3.0, (SIDE, SIDE)).clip(0, 255).astype(np.uint8)
    assert RimFit(33.3, 25.0, 0.05).fit(picture, x_px, y_px).confidence < 0.1


def test_a_bright_disc_on_dark_is_not_the_robot() -> None:
    bright = disc(100.0, 100.0, 33.3, 190.0, 40.0)
    assert RimFit(33.3, 25.0, 0.05).fit(bright, 100.0, 100.0).confidence == 0.0


@pytest.mark.parametrize("radius_px", [30.0, 36.5])
def test_a_disc_of_another_size_is_refused_or_shows_in_the_radius(radius_px: float) -> None:
    found = RimFit(33.3, 25.0, 0.05).fit(disc(100.0, 100.0, radius_px, 40.0, 190.0), 100.0, 100.0)
    assert found.confidence == 0.0 or abs(found.radius_px - 33.3) > 0.05 * 33.3


def test_a_disc_of_nearly_the_right_size_shows_its_radius() -> None:
    found = RimFit(33.3, 25.0, 0.05).fit(disc(100.0, 100.0, 34.3, 40.0, 190.0), 100.0, 100.0)
    assert found.confidence > 0.9
    assert found.radius_px == pytest.approx(34.05, abs=0.2)


def test_half_a_disc_is_still_exact_and_says_that_it_knows_less() -> None:
    rim = RimFit(33.3, 25.0, 0.05)
    picture = disc(100.3, 99.6, 33.3, 40.0, 190.0, 3.0)
    whole = rim.fit(picture, 101.0, 100.0)
    picture[:, 104:] = 120
    half = rim.fit(picture, 101.0, 100.0)
    assert np.hypot(half.x_px - 100.3, half.y_px - 99.6) < 0.3
    assert 0.4 < half.confidence < 0.65
    assert half.sigma_px > 1.9 * whole.sigma_px


def test_a_dark_wall_that_touches_the_disc_does_not_pull_it() -> None:
    picture = disc(100.0, 100.0, 33.3, 40.0, 190.0)
    picture[:, 133:139] = 40
    found = RimFit(33.3, 25.0, 0.05).fit(picture, 100.0, 100.0)
    assert found.x_px == pytest.approx(100.0, abs=0.1)
    assert found.confidence > 0.7


def test_confidence_falls_with_contrast() -> None:
    rim = RimFit(33.3, 25.0, 0.05)
    strong, faint = (
        rim.fit(disc(100.0, 100.0, 33.3, inside, 190.0), 100.0, 100.0) for inside in (40.0, 172.0)
    )
    assert strong.confidence == 1.0
    assert 0.2 < faint.confidence < 0.7
