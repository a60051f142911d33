"""Robots that are no spheres, followed on the simulated microscope's background."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import ImagePoint, StagePoint, VesselPoint
from mrnav_server.core.records import Track, TrackState
from mrnav_server.vision.detector import Sighting
from mrnav_server.vision.moving_shape import MovingShapeDetector
from mrnav_server.vision.tracker import Tracker, TrackerConfig
from tests.vision.rendered_bench import Bench
from tests.vision.shapes import Shape, helix, swarm

LEARNING = 15
CONFIG = replace(TrackerConfig(), detector="moving-shape", learning_frames=LEARNING)


def walk(k: int) -> VesselPoint:
    t_s = k / 30.0
    return VesselPoint(700.0 + 280.0 * np.sin(1.07 * t_s), 900.0 + 55.0 * np.sin(2.3 * t_s))


def needle(k: int) -> StagePoint:
    t_s = k / 30.0
    x_um, y_um = 1000.0 + 10.0 * walk(k).x_px, 1000.0 + 10.0 * walk(k).y_px
    return StagePoint(x_um - 900.0 + 1500.0 * np.sin(1.9 * t_s), y_um + 1900.0 * np.cos(0.9 * t_s), 11_720.0)


def film(
    bench: Bench, shape: Shape | None, frames: range, sweep: bool = False, bright: bool = False
) -> list[Track]:
    tracks = []
    for k in frames:
        image = bench.microscope.render(None, needle(k) if sweep else bench.AWAY)
        if shape is not None and k >= LEARNING:
            at = bench.calibration.image_point(walk(k))
            image = shape.paint(image, at.x_px, at.y_px)
        bench.number = k
        tracks.append(bench.feed(255 - image if bright else image))
    return tracks


def errors_px(bench: Bench, tracks: list[Track]) -> np.ndarray:
    tracked = [t for t in tracks if t.state is TrackState.TRACKING and t.image is not None]
    return np.array([bench.error_px(t, walk(t.frame_number)) for t in tracked])


@pytest.fixture
def bench() -> Bench:
    bench = Bench(15.0)
    bench.tracker = Tracker(CONFIG, bench.calibration)
    return bench


@pytest.mark.parametrize("shape", [helix(), swarm(1), swarm(2)], ids=["helix", "swarm", "another swarm"])
def test_a_robot_of_any_shape_is_tracked_to_half_a_pixel(bench: Bench, shape: Shape) -> None:
    tracks = film(bench, shape, range(75))
    assert all(t.image is None for t in tracks[:LEARNING])
    errors = errors_px(bench, tracks)
    assert len(errors) > 45
    assert np.max(errors) < 0.5
    sigmas_px = np.array([t.sigma_um for t in tracks if t.state is TrackState.TRACKING]) / 15.0
    assert np.max(errors / sigmas_px) < 3.0


def test_a_bright_shape_is_followed_when_told_so(bench: Bench) -> None:
    bench.tracker = Tracker(replace(CONFIG, polarity="bright"), bench.calibration)
    errors = errors_px(bench, film(bench, helix(), range(45), bright=True))
    assert len(errors) > 15
    assert np.max(errors) < 0.5


def test_a_needle_that_sweeps_past_is_never_tracked(bench: Bench) -> None:
    tracks = film(bench, None, range(120), sweep=True)
    assert all(t.state is not TrackState.TRACKING for t in tracks)


def test_under_a_needle_the_standard_deviation_covers_the_error(bench: Bench) -> None:
    tracks = film(bench, helix(), range(240), sweep=True)
    tracked = [t for t in tracks if t.state is TrackState.TRACKING and t.image is not None]
    assert len(tracked) > 80
    off = errors_px(bench, tracks) * 15.0 / np.array([t.sigma_um for t in tracked])
    assert np.max(off) < 4.0
    assert np.sqrt(np.mean(off**2) / 2.0) < 1.5


def test_a_robot_that_rested_while_learning_is_found_once_it_has_moved(bench: Bench) -> None:
    shape = helix()
    for k in range(70):
        at = bench.calibration.image_point(VesselPoint(500.0 + 6.0 * max(0, k - 25), 900.0))
        image = shape.paint(bench.microscope.render(None, bench.AWAY), at.x_px, at.y_px)
        track = bench.feed(image)
        assert k > 25 or track.image is None
    assert track.state is TrackState.TRACKING
    assert bench.error_px(track, VesselPoint(500.0 + 6.0 * 44, 900.0)) < 0.5


def test_light_that_changes_slowly_does_no_harm(bench: Bench) -> None:
    shape = swarm(1)
    for k in range(90):
        at = bench.calibration.image_point(walk(k))
        image = bench.microscope.render(None, bench.AWAY)
        image = shape.paint(image, at.x_px, at.y_px) if k >= LEARNING else image
        track = bench.feed(cv2.convertScaleAbs(image, alpha=0.8 + 0.2 * np.cos(0.05 * k)).astype(np.uint8))
    assert track.state is TrackState.TRACKING
    assert bench.error_px(track, walk(89)) < 0.5


def test_what_has_another_size_is_not_the_robot(bench: Bench) -> None:
    bench.tracker = Tracker(replace(CONFIG, robot_radius_um=1600.0), bench.calibration)
    assert all(t.image is None for t in film(bench, helix(), range(45)))


def test_nothing_is_followed_outside_the_picture() -> None:
    detector = MovingShapeDetector(33.3, 25.0, "dark", 1)
    picture = np.full((240, 320, 3), 150, np.uint8)
    assert detector.find(picture) is None
    assert detector.follow(picture, ImagePoint(900.0, -700.0)) is None


def test_an_unknown_detector_or_polarity_names_the_choices() -> None:
    with pytest.raises(ConfigError, match="sphere or moving-shape"):
        replace(TrackerConfig(), detector="cube")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="dark or bright"):
        replace(TrackerConfig(), polarity="gray")  # type: ignore[arg-type]


class Beacon:
    """The smallest detector: the brightest pixel."""

    radius_px = 5.0

    def find(self, image: np.ndarray) -> Sighting | None:
        row, column = np.unravel_index(int(np.argmax(image[:, :, 1])), image.shape[:2])
        return Sighting(float(column), float(row), 1.0, 0.5)

    def follow(self, image: np.ndarray, near: ImagePoint) -> Sighting | None:
        return self.find(image)


def test_a_detector_of_ones_own_is_one_class(bench: Bench) -> None:
    bench.tracker = Tracker(TrackerConfig(), bench.calibration, Beacon())
    noise = np.random.default_rng(5)
    for k in range(12):
        image = noise.integers(80, 100, (240, 320, 3), np.uint8)
        image[50, 60 + k] = 255
        track = bench.feed(image)
    assert track.state is TrackState.TRACKING
    assert track.image is not None
    assert (track.image.x_px, track.image.y_px) == pytest.approx((71.0, 50.0), abs=0.5)
    image = noise.integers(80, 100, (240, 320, 3), np.uint8)
    image[50, 160] = 255
    assert bench.feed(image).image is None
