"""When a task is given up."""

import math

import pytest

from mrnav_server.core.frames import VesselPoint
from mrnav_server.loops.progress import Progress

AT = VesselPoint(500.0, 500.0)


@pytest.fixture
def progress() -> Progress:
    progress = Progress(patience_s=2.0, most_reversals=3, longest_s=60.0, um_per_px=10.0)
    progress.begin(AT, 0.0)
    return progress


def test_before_a_task_nothing_is_wrong() -> None:
    assert Progress(2.0, 3, 60.0, 10.0).objection(1e6) == ""


def test_a_robot_that_gets_on_is_left_alone(progress: Progress) -> None:
    for tick in range(3000):
        now_s = 0.01 * tick
        progress.note(VesselPoint(500.0 + 100.0 * now_s, 500.0), 30_000.0 - 1000.0 * now_s, now_s)
        assert progress.objection(now_s) == ""


def test_a_robot_that_trembles_has_not_moved(progress: Progress) -> None:
    for tick in range(201):
        progress.note(VesselPoint(500.0 + 2.0 * math.sin(tick), 500.0), 5000.0, 0.01 * tick)
    assert progress.objection(2.0) == ""
    assert "has not moved for 2 s" in progress.objection(2.01)


def test_a_robot_that_turns_in_circles_comes_no_nearer(progress: Progress) -> None:
    for tick in range(202):
        turn = 0.05 * tick
        robot = VesselPoint(500.0 + 60.0 * math.cos(turn), 500.0 + 60.0 * math.sin(turn))
        progress.note(robot, 5000.0 + 20.0 * math.cos(turn), 0.01 * tick)
    assert "no nearer for 2 s" in progress.objection(2.02 + 0.01)


def test_a_robot_that_goes_back_and_forth_is_stopped_early(progress: Progress) -> None:
    for tick in range(60):
        progress.note(VesselPoint(500.0 + 10.0 * (tick // 10 % 2), 500.0), 5000.0, 0.01 * tick)
    assert "turned back" in progress.objection(0.6)


def test_turning_back_on_the_way_there_is_no_harm(progress: Progress) -> None:
    for tick in range(60):
        progress.note(VesselPoint(500.0 + 10.0 * (tick // 10 % 2), 500.0), 5000.0 - 10.0 * tick, 0.01 * tick)
    assert progress.objection(0.6) == ""


def test_another_path_is_another_way_left(progress: Progress) -> None:
    progress.note(AT, 100.0, 1.5)
    progress.restart(AT, 1.9)
    progress.note(AT, 9000.0, 1.9)
    assert progress.objection(3.8) == ""
    assert progress.objection(3.95)


def test_no_task_takes_for_ever(progress: Progress) -> None:
    for tick in range(6100):
        now_s = 0.01 * tick
        progress.note(VesselPoint(500.0 + 10.0 * now_s, 500.0), 1e6 - 100.0 * now_s, now_s)
    assert "longer than 60 s" in progress.objection(60.99)
