"""The tracker's standard deviation covers its true error, whatever hides the robot."""

import numpy as np
import pytest

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.frames import ImagePoint, VesselPoint
from mrnav_server.vision.rim import RimFit
from mrnav_server.vision.sphere import SphereDetector
from mrnav_server.vision.tracker import TrackerConfig
from tests.vision.rendered_bench import Bench

UM_PER_PX = 15.0
RADIUS_PX = 500.0 / UM_PER_PX


def hidden(image: ByteArray, robot: ImagePoint, share: float, angle: float, blur_px: float) -> ByteArray:
    """Return a picture in which a dark blurred edge from one side hides a share of the robot's width."""
    left, top = int(robot.x_px) - 90, int(robot.y_px) - 90
    box = image.copy()[top : top + 180, left : left + 180]
    y, x = np.mgrid[0:180, 0:180]
    along = np.cos(angle) * (x + left - robot.x_px) + np.sin(angle) * (y + top - robot.y_px)
    edge_px = RADIUS_PX * (2.0 * share - 1.0)
    dark = 1.0 / (1.0 + np.exp((along - edge_px - 3.0 * blur_px) / blur_px))
    covered = image.copy()
    covered[top : top + 180, left : left + 180] = np.rint(
        box * (1.0 - dark[..., None]) + 55.0 * dark[..., None]
    )
    return covered


@pytest.fixture(scope="module")
def sightings() -> np.ndarray:
    """Rows of true error, sigma, share hidden, confidence of what the tracker would accept."""
    bench = Bench(UM_PER_PX)
    config = TrackerConfig()
    rim = RimFit(RADIUS_PX, config.edge_strength, config.systematic_um / UM_PER_PX)
    detector = SphereDetector(rim, config.radius_tolerance)
    rng = np.random.default_rng(31)
    rows = []
    for _ in range(360):
        robot = VesselPoint(rng.uniform(380.0, 950.0), 900.0 + rng.uniform(-60.0, 60.0))
        true = bench.calibration.image_point(robot)
        picture = bench.microscope.render(robot, bench.AWAY)
        share = rng.choice([0.0, rng.uniform(0.0, 1.1)])
        if share:
            picture = hidden(picture, true, share, rng.uniform(0.0, 2.0 * np.pi), rng.uniform(2.0, 12.0))
        near = ImagePoint(true.x_px + rng.normal(0.0, 0.7), true.y_px + rng.normal(0.0, 0.7))
        found = detector.follow(picture, near)
        if found is not None and found.confidence >= config.confidence_min:
            error_px = np.hypot(found.x_px - true.x_px, found.y_px - true.y_px)
            rows.append((error_px, found.sigma_px, share, found.confidence))
    return np.array(rows)


def normalised(rows: np.ndarray) -> float:
    """Return the root mean square of the error in sigma along each axis; 1 is exactly honest."""
    return float(np.sqrt(np.mean((rows[:, 0] / rows[:, 1]) ** 2) / 2.0))


def test_the_standard_deviation_is_honest_for_a_robot_in_the_open(sightings: np.ndarray) -> None:
    rows = sightings[sightings[:, 2] == 0.0]
    assert len(rows) > 90
    # Rather too large than too small: real light is less even than the simulated one.
    assert 0.2 < normalised(rows) < 2.0


def test_the_standard_deviation_is_honest_for_a_robot_half_hidden(sightings: np.ndarray) -> None:
    rows = sightings[sightings[:, 2] > 0.15]
    assert len(rows) > 30
    assert 0.5 < normalised(rows) < 2.0


def test_what_is_hidden_makes_the_standard_deviation_grow(sightings: np.ndarray) -> None:
    open_px = np.median(sightings[sightings[:, 2] == 0.0, 1])
    assert np.median(sightings[sightings[:, 2] > 0.35, 1]) > 1.5 * open_px


def test_nothing_is_accepted_that_is_more_than_four_sigma_off(sightings: np.ndarray) -> None:
    assert np.max(sightings[:, 0] / sightings[:, 1]) < 4.0
    assert np.max(sightings[:, 0]) < 0.5


def lit_from_one_side(shade: float, limb: float, seed: int) -> tuple[ByteArray, float, float]:
    """Draw a sphere that brightens towards one side, or has a lit edge there; return its centre, too."""
    y, x = np.mgrid[0:200, 0:200].astype(np.float64)
    x_px, y_px, angle = 100.4 + 0.13 * seed % 1.0, 99.8 + 0.29 * seed % 1.0, 1.1 * seed
    reach = np.hypot(x - x_px, y - y_px) / RADIUS_PX
    lit = np.clip(((x - x_px) * np.cos(angle) + (y - y_px) * np.sin(angle)) / RADIUS_PX, 0.0, 1.0)
    inside = (
        60.0 + shade * 50.0 * lit * reach**6 + limb * 100.0 * lit * np.exp(-(((reach - 0.97) / 0.08) ** 2))
    )
    cover = 0.5 - 0.5 * np.tanh(0.9 * RADIUS_PX * (reach - 1.0))
    picture = 170.0 + (inside - 170.0) * cover + np.random.default_rng(seed).normal(0.0, 3.0, x.shape)
    gray: ByteArray = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    return gray, x_px, y_px


def error_and_sigma(shade: float, limb: float) -> np.ndarray:
    """Rows of true error and sigma under one light."""
    rim = RimFit(RADIUS_PX, TrackerConfig().edge_strength, TrackerConfig().systematic_um / UM_PER_PX)
    rows = []
    for seed in range(24):
        gray, x_px, y_px = lit_from_one_side(shade, limb, seed)
        found = rim.fit(gray, x_px + 0.5, y_px - 0.4)
        rows.append((np.hypot(found.x_px - x_px, found.y_px - y_px), found.sigma_px))
    return np.array(rows)


@pytest.mark.parametrize(("shade", "limb"), [(0.3, 0.0), (0.6, 0.0), (1.0, 0.0), (0.0, 0.3), (0.0, 0.6)])
def test_the_standard_deviation_covers_light_from_one_side(shade: float, limb: float) -> None:
    rows = error_and_sigma(shade, limb)
    assert normalised(rows) < 1.5
    assert np.max(rows[:, 0] / rows[:, 1]) < 2.5


def test_even_light_costs_no_confidence_in_the_place() -> None:
    even, uneven = error_and_sigma(0.0, 0.0), error_and_sigma(1.0, 0.0)
    assert np.median(even[:, 1]) < 1.6 * TrackerConfig().systematic_um / UM_PER_PX
    assert np.median(uneven[:, 1]) > 2.0 * np.median(even[:, 1])
