"""The tracker on rendered sequences: its states, its accuracy, and what it must never take for the robot."""

from dataclasses import replace

import numpy as np
import pytest

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import StagePoint, VesselPoint
from mrnav_server.core.records import Frame, Track, TrackState
from mrnav_server.vision.tracker import Tracker, TrackerConfig
from tests.vision.rendered_bench import Bench


@pytest.fixture
def bench() -> Bench:
    """The robot's radius is 33.3 px."""
    return Bench(15.0)


@pytest.fixture
def fine_bench() -> Bench:
    """The robot's radius is 50 px."""
    return Bench(10.0)


HERE = VesselPoint(700.0, 900.0)


def acquire(bench: Bench, robot: VesselPoint = HERE) -> Track:
    for _ in range(10):
        track = bench.show(robot)
    assert track.state is TrackState.TRACKING
    return track


def walk(k: int) -> tuple[VesselPoint, StagePoint]:
    """Return a robot that swings along the channel at up to 3 mm/s, and a needle that sweeps past it."""
    t_s = k / 30.0
    robot = VesselPoint(700.0 + 280.0 * np.sin(1.07 * t_s), 900.0 + 55.0 * np.sin(2.3 * t_s))
    x_um, y_um = 1000.0 + 10.0 * robot.x_px, 1000.0 + 10.0 * robot.y_px
    tip = StagePoint(x_um - 900.0 + 1500.0 * np.sin(1.9 * t_s), y_um + 1900.0 * np.cos(0.9 * t_s), 11_720.0)
    return robot, tip


def tracked_errors_px(bench: Bench, numbers: list[int]) -> tuple[list[float], list[Track]]:
    errors, tracks = [], []
    for k in numbers:
        bench.number = k
        robot, tip = walk(k)
        track = bench.show(robot, tip)
        tracks.append(track)
        if track.state is TrackState.TRACKING and track.image is not None:
            errors.append(bench.error_px(track, robot))
    return errors, tracks


def test_ten_good_frames_acquire(bench: Bench) -> None:
    states = [bench.show(HERE).state for _ in range(12)]
    assert states == [TrackState.ACQUIRING] * 9 + [TrackState.TRACKING] * 3


def test_a_moving_robot_is_tracked_to_a_tenth_of_a_pixel_under_a_moving_needle(bench: Bench) -> None:
    errors, tracks = tracked_errors_px(bench, list(range(360)))
    assert np.sqrt(np.mean(np.square(errors))) < 0.1
    assert len(errors) > 290
    normalised = np.array(
        [t.sigma_um for t in tracks if t.image is not None and t.state is TrackState.TRACKING]
    )
    assert 0.3 < np.sqrt(np.mean((np.array(errors) * 15.0 / normalised) ** 2) / 2.0) < 1.5


def test_the_track_is_the_same_point_in_image_and_vessel(bench: Bench) -> None:
    track = acquire(bench)
    assert track.image is not None
    assert track.vessel is not None
    assert bench.calibration.image_point(track.vessel).x_px == pytest.approx(track.image.x_px)
    assert track.vessel.distance_px(HERE) < 0.15
    assert 0.3 < track.sigma_um < 1.5
    assert track.confidence > 0.9
    assert (track.frame_number, track.taken_s, track.good_frames) == (9, 9 / 30.0, 10)


def test_dropped_frames_do_no_harm(bench: Bench) -> None:
    kept = np.flatnonzero(np.random.default_rng(2).random(360) > 0.3).tolist()
    errors, _ = tracked_errors_px(bench, kept)
    assert np.sqrt(np.mean(np.square(errors))) < 0.1
    assert len(errors) > 190


def test_a_larger_scale_needs_no_other_setting(fine_bench: Bench) -> None:
    errors, _ = tracked_errors_px(fine_bench, list(range(150)))
    assert np.sqrt(np.mean(np.square(errors))) < 0.1
    assert len(errors) > 110


def test_three_misses_lose_and_ten_good_frames_acquire_again(bench: Bench) -> None:
    acquire(bench)
    misses = [bench.show(None) for _ in range(4)]
    assert [m.state for m in misses] == [TrackState.TRACKING] * 2 + [TrackState.SEARCHING] * 2
    assert all(m.image is None and m.vessel is None and m.confidence == 0.0 for m in misses)
    assert all(m.good_frames == 0 for m in misses)
    there = VesselPoint(1300.0, 660.0)
    back = [bench.show(there) for _ in range(10)]
    assert [b.state for b in back] == [TrackState.ACQUIRING] * 9 + [TrackState.TRACKING]
    assert bench.error_px(back[0], there) < 0.2


def test_two_misses_do_not_lose(bench: Bench) -> None:
    acquire(bench)
    bench.show(None)
    bench.show(None)
    track = bench.show(HERE)
    assert track.state is TrackState.TRACKING
    assert track.good_frames == 1


def test_a_robot_under_the_magnet_is_not_guessed_and_is_found_when_it_shows(bench: Bench) -> None:
    acquire(bench)
    hiding = bench.tip_hiding(HERE)
    hidden = [bench.show(HERE, hiding) for _ in range(20)]
    assert hidden[-1].state is TrackState.SEARCHING
    assert all(t.image is None or bench.error_px(t, HERE) < 1.0 for t in hidden)
    aside = replace(hiding, y_um=hiding.y_um + 1600.0)
    assert [bench.show(HERE, aside).state for _ in range(10)][-1] is TrackState.TRACKING


def test_a_half_hidden_robot_is_tracked(bench: Bench) -> None:
    acquire(bench)
    hiding = bench.tip_hiding(HERE)
    half = replace(hiding, y_um=hiding.y_um + 620.0)
    tracks = [bench.show(HERE, half) for _ in range(10)]
    assert all(t.image is not None and bench.error_px(t, HERE) < 0.5 for t in tracks)
    assert all(0.4 <= t.confidence < 0.85 for t in tracks)
    assert tracks[-1].sigma_um > 0.9


def test_an_empty_scene_is_never_accepted(bench: Bench) -> None:
    rng = np.random.default_rng(4)
    for _ in range(100):
        tip = StagePoint(*(float(rng.uniform(*span)) for span in ((1e3, 19e3), (1e3, 19e3), (9e3, 14e3))))
        track = bench.show(None, tip)
        assert track.image is None
        assert track.state is TrackState.SEARCHING


def test_a_magnet_that_passes_over_the_robot_does_not_carry_the_track_away(bench: Bench) -> None:
    acquire(bench)
    hiding = bench.tip_hiding(HERE)
    for k in range(60):
        track = bench.show(HERE, replace(hiding, x_um=hiding.x_um - 3000.0 + 100.0 * k))
        assert track.image is None or bench.error_px(track, HERE) < 1.0


def test_a_black_frame_is_a_miss(bench: Bench) -> None:
    acquire(bench)
    black = np.zeros((1200, 1600, 3), np.uint8)
    noise = np.random.default_rng(1)
    tracks = [bench.feed(black + noise.integers(0, 4, black.shape, np.uint8)) for _ in range(3)]
    assert [t.confidence for t in tracks] == [0.0] * 3
    assert tracks[0].image is None
    assert tracks[-1].state is TrackState.SEARCHING


def test_a_frozen_frame_is_a_miss(bench: Bench) -> None:
    acquire(bench)
    assert bench.last is not None
    frozen = bench.last
    tracks = [bench.feed(frozen.copy()) for _ in range(3)]
    assert all(t.image is None and t.confidence == 0.0 for t in tracks)
    assert tracks[-1].state is TrackState.SEARCHING
    assert bench.show(HERE).state is TrackState.ACQUIRING


def test_a_jump_beyond_the_gate_is_rejected_then_found_again(bench: Bench) -> None:
    acquire(bench)
    jumped = VesselPoint(HERE.x_px + 150.0, HERE.y_px)
    tracks = [bench.show(jumped) for _ in range(4)]
    assert [t.image for t in tracks[:3]] == [None] * 3
    assert tracks[3].state is TrackState.ACQUIRING
    assert bench.error_px(tracks[3], jumped) < 0.2


def test_a_jump_within_the_rays_but_beyond_the_gate_is_rejected(bench: Bench) -> None:
    acquire(bench)
    track = bench.show(VesselPoint(HERE.x_px + 13.0, HERE.y_px))
    assert track.image is None


def test_a_robot_that_touches_the_wall_is_tracked(bench: Bench) -> None:
    beside = VesselPoint(700.0, 900.0 + 130.0 - 50.5)
    acquire(bench, beside)
    errors = [bench.error_px(bench.show(beside), beside) for _ in range(20)]
    assert max(errors) < 0.25


def test_a_robot_that_leaves_the_picture_is_lost(bench: Bench) -> None:
    tracks = [bench.show(VesselPoint(1700.0 + 7.0 * k, 900.0)) for k in range(80)]
    assert tracks[20].state is TrackState.TRACKING
    assert bench.show(VesselPoint(2400.0, 900.0)).state is TrackState.SEARCHING


def test_a_bright_robot_on_dark_is_tracked_when_told_so_and_not_otherwise(bench: Bench) -> None:
    bright = Tracker(replace(TrackerConfig(), polarity="bright"), bench.calibration)
    for k in range(12):
        robot, tip = walk(k)
        frame = Frame(k, k / 30.0, 255 - bench.microscope.render(robot, tip))
        assert bench.tracker.update(frame).image is None
        track = bright.update(frame)
        assert track.image is not None
        assert bench.error_px(track, robot) < 0.1
    assert track.state is TrackState.TRACKING


def test_a_dark_robot_is_not_bright(bench: Bench) -> None:
    bright = Tracker(replace(TrackerConfig(), polarity="bright"), bench.calibration)
    tracks = [bright.update(Frame(k, k / 30.0, bench.microscope.render(*walk(k)))) for k in range(4)]
    assert all(t.image is None for t in tracks)


def test_reset_forgets(bench: Bench) -> None:
    acquire(bench)
    bench.tracker.reset()
    assert bench.show(None).state is TrackState.SEARCHING
    assert bench.show(HERE).good_frames == 1


@pytest.mark.parametrize(
    ("field", "value"), [("confidence_min", 0.1), ("misses_to_lose", 0), ("gate_um", float("nan"))]
)
def test_a_setting_out_of_range_names_itself(field: str, value: float) -> None:
    with pytest.raises(ConfigError, match=field):
        replace(TrackerConfig(), **{field: value})  # type: ignore[arg-type]
