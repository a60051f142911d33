"""Measuring a robot's radius and polarity in a picture."""

import cv2
import numpy as np
import pytest

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import StagePoint, VesselPoint
from mrnav_server.vision.measure import measure_robot
from tests.vision.rendered_bench import Bench


def scene(discs: list[tuple[float, float, float]], inside: float, outside: float) -> ByteArray:
    """Draw discs (x, y, radius) on a floor with some shade and noise."""
    y, x = np.mgrid[0:600, 0:800]
    picture = outside + 8.0 * np.sin(x / 170.0) + np.random.default_rng(1).normal(0.0, 2.0, x.shape)
    for x_px, y_px, radius_px in discs:
        cover = 0.5 - 0.5 * np.tanh(np.hypot(x - x_px, y - y_px) - radius_px)
        picture += (inside - outside) * cover
    gray = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    drawn: ByteArray = cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)
    return drawn


@pytest.mark.parametrize("radius_px", [8.0, 14.3, 33.3, 71.0, 99.0])
@pytest.mark.parametrize(("inside", "outside", "polarity"), [(40, 190, "dark"), (200, 60, "bright")])
def test_radius_and_polarity_are_measured(
    radius_px: float, inside: float, outside: float, polarity: str
) -> None:
    look = measure_robot(scene([(311.3, 240.8, radius_px)], inside, outside), 15.0)
    assert look.polarity == polarity
    assert look.radius_px == pytest.approx(radius_px, abs=0.15)
    assert look.radius_um == pytest.approx(15.0 * look.radius_px)
    assert (look.center.x_px, look.center.y_px) == pytest.approx((311.3, 240.8), abs=0.1)
    assert look.confidence > 0.8


@pytest.mark.parametrize("um_per_px", [15.0, 10.0])
@pytest.mark.parametrize("bright", [False, True])
def test_the_robot_is_measured_in_the_vessel_beside_the_needle(um_per_px: float, bright: bool) -> None:
    bench = Bench(um_per_px)
    picture = bench.microscope.render(VesselPoint(760.4, 931.7), StagePoint(9_000.0, 2_000.0, 11_720.0))
    look = measure_robot(255 - picture if bright else picture, um_per_px)
    assert look.radius_um == pytest.approx(500.0, rel=0.01)
    assert look.polarity == ("bright" if bright else "dark")


def lens(
    radius_px: float, middle: float, share: float, off: float = 0.0, halo: float = 0.0, rim: float = 45.0
) -> ByteArray:
    """Draw a clear sphere: a dark ring with a middle, which may be off centre, and a halo around it."""
    y, x = np.mgrid[0:600, 0:800]
    picture = 170.0 + 8.0 * np.sin(x / 170.0) + np.random.default_rng(1).normal(0.0, 2.0, x.shape)
    reach = np.hypot(x - 311.3, y - 240.8)
    picture += halo * np.exp(-(((reach - 1.12 * radius_px) / (0.05 * radius_px)) ** 2))
    cover = 0.5 - 0.5 * np.tanh(reach - radius_px)
    picture += (rim - picture) * cover
    inner = np.hypot(x - 311.3 + off * radius_px, y - 240.8 + off * radius_px) - share * radius_px
    picture += (middle - picture) * (0.5 - 0.5 * np.tanh(inner))
    gray = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    drawn: ByteArray = cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)
    return drawn


@pytest.mark.parametrize("radius_px", [20.0, 33.3, 71.0])
@pytest.mark.parametrize("share", [0.35, 0.6, 0.8])
@pytest.mark.parametrize("middle", [170.0, 240.0])
def test_the_bright_middle_of_a_clear_sphere_is_no_robot(
    radius_px: float, share: float, middle: float
) -> None:
    look = measure_robot(lens(radius_px, middle, share), 15.0)
    assert look.polarity == "dark"
    assert look.radius_px == pytest.approx(radius_px, abs=0.3)
    assert (look.center.x_px, look.center.y_px) == pytest.approx((311.3, 240.8), abs=0.2)


@pytest.mark.parametrize("off", [-0.25, 0.2, 0.35])
def test_a_highlight_beside_the_middle_is_no_robot(off: float) -> None:
    look = measure_robot(lens(40.0, 250.0, 0.4, off), 15.0)
    assert look.polarity == "dark"
    assert look.radius_px == pytest.approx(40.0, abs=0.3)


@pytest.mark.parametrize("radius_px", [20.0, 33.3])
def test_a_halo_around_the_robot_is_not_its_rim(radius_px: float) -> None:
    look = measure_robot(lens(radius_px, 45.0, 0.1, halo=45.0), 15.0)
    assert look.polarity == "dark"
    assert look.radius_px == pytest.approx(radius_px, abs=0.6)


def test_a_bright_sphere_with_a_dark_middle_is_measured_at_its_rim() -> None:
    look = measure_robot(255 - lens(33.3, 240.0, 0.6), 15.0)
    assert look.polarity == "bright"
    assert look.radius_px == pytest.approx(33.3, abs=0.3)


def test_a_middle_is_not_taken_for_a_robot_whose_rim_is_hidden_in_part() -> None:
    picture = lens(40.0, 240.0, 0.6)
    y, x = np.mgrid[0:600, 0:800]
    beside = (np.abs(np.arctan2(y - 240.8, x - 311.3)) < 1.4) & (np.hypot(x - 311.3, y - 240.8) > 32.0)
    picture[beside] = 50
    with pytest.raises(RefusedError):
        measure_robot(picture, 15.0)


def test_an_empty_vessel_is_refused() -> None:
    bench = Bench(15.0)
    with pytest.raises(RefusedError, match="no disc"):
        measure_robot(bench.microscope.render(None, StagePoint(9_000.0, 2_000.0, 11_720.0)), 15.0)


def test_bare_noise_is_refused() -> None:
    with pytest.raises(RefusedError, match="no disc"):
        measure_robot(scene([], 0.0, 120.0), 15.0)


def test_two_robots_are_refused_with_both_radii() -> None:
    with pytest.raises(RefusedError, match=r"33\.\d px and 20\.\d px|20\.\d px and 33\.\d px"):
        measure_robot(scene([(200.0, 300.0, 33.3), (560.0, 280.0, 20.4)], 40.0, 190.0), 15.0)


def test_a_robot_that_is_hidden_in_part_is_refused() -> None:
    picture = scene([(311.0, 240.0, 33.3)], 40.0, 190.0)
    picture[:, 305:] = 120
    with pytest.raises(RefusedError):
        measure_robot(picture, 15.0)


def test_a_scale_at_which_no_robot_fits_is_refused() -> None:
    with pytest.raises(RefusedError, match="zoom"):
        measure_robot(scene([], 0.0, 120.0), 15.0, (10.0, 50.0))
