"""Re-detection over whole pictures."""

import cv2
import numpy as np
import pytest

from mrnav_server.core.frames import StagePoint, VesselPoint
from mrnav_server.vision.redetect import Redetector
from mrnav_server.vision.rim import RimFit
from tests.vision.rendered_bench import Bench


@pytest.fixture
def bench() -> Bench:
    """The robot's radius is 33.3 px."""
    return Bench(15.0)


@pytest.fixture
def fine_bench() -> Bench:
    """The robot's radius is 50 px."""
    return Bench(10.0)


def redetector(radius_px: float) -> Redetector:
    return Redetector(RimFit(radius_px, 25.0, 0.05), radius_tolerance=0.05)


@pytest.mark.parametrize(
    "place", [(320.0, 900.0), (760.4, 931.7), (1440.0, 560.0), (1400.0, 1260.0), (500.0, 340.0)]
)
def test_the_robot_is_found_anywhere(bench: Bench, place: tuple[float, float]) -> None:
    robot = VesselPoint(*place)
    true = bench.calibration.image_point(robot)
    tip = StagePoint(9_000.0, 2_000.0, 11_720.0)
    found = redetector(500.0 / 15.0).find(bench.microscope.render(robot, tip))
    assert found is not None
    assert np.hypot(found.x_px - true.x_px, found.y_px - true.y_px) < 0.2
    assert found.confidence > 0.7


def test_a_larger_scale_needs_no_other_setting(fine_bench: Bench) -> None:
    robot = VesselPoint(700.3, 880.6)
    true = fine_bench.calibration.image_point(robot)
    found = redetector(50.0).find(fine_bench.microscope.render(robot, StagePoint(4_000.0, 4_000.0, 11_720.0)))
    assert found is not None
    assert np.hypot(found.x_px - true.x_px, found.y_px - true.y_px) < 0.2


def test_a_robot_of_another_size_is_not_taken(bench: Bench) -> None:
    found = redetector(44.0).find(
        bench.microscope.render(VesselPoint(800.0, 900.0), bench.tip_hiding(VesselPoint(0, 0)))
    )
    assert found is None or found.confidence < 0.3


@pytest.mark.parametrize("radius_px", [10.3, 33.3])
def test_a_clear_sphere_with_a_bright_middle_is_found(radius_px: float) -> None:
    y, x = np.mgrid[0:400, 0:500]
    away = np.hypot(x - 231.4, y - 187.7) / radius_px
    picture = 140.0 - 60.0 * (np.abs(away - 0.82) < 0.18) + 100.0 * (away < 0.6)
    picture += np.random.default_rng(3).normal(0.0, 2.0, picture.shape)
    gray = cv2.GaussianBlur(np.clip(picture, 0, 255).astype(np.uint8), (0, 0), 1.0)
    found = redetector(radius_px).find(cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR).astype(np.uint8))
    assert found is not None
    assert np.hypot(found.x_px - 231.4, found.y_px - 187.7) < 0.1
    assert found.confidence > 0.7
