"""What is thought of a device's readings, in simulated time."""

import math

import pytest

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.frames import StagePoint
from mrnav_server.devices.sensapex.smcp1 import Status
from mrnav_server.devices.sensapex.tip_record import TipRecord

HOME = (10_000.0, 9_000.0, 8_000.0, 7_000.0)


def rested(until_s: float = 0.2) -> TipRecord:
    """Return a record of a tip at rest, read at 50 Hz."""
    record = TipRecord(4, "manipulator 1")
    for tick in range(round(until_s * 50) + 1):
        read(record, 0.0, tick / 50)
    return record


def read(record: TipRecord, x_um: float, now_s: float) -> None:
    assert record.on_position((HOME[0] + x_um, *HOME[1:]), now_s)
    record.on_answer(now_s)


def drive(record: TipRecord, start_s: float, speed_um_per_s: float, for_s: float) -> float:
    """Read a tip that moves along x; return when it ended."""
    for tick in range(1, round(for_s * 50) + 1):
        read(record, speed_um_per_s * tick / 50, start_s + tick / 50)
    return start_s + for_s


def test_a_reading_keeps_its_own_time() -> None:
    reading = rested(0.2).reading(0.25)
    assert reading.taken_s == 0.2
    assert reading.position == StagePoint(*HOME[:3])
    assert not reading.moving


def test_before_the_first_reading_there_is_none() -> None:
    with pytest.raises(DeviceError, match="not open"):
        TipRecord(4, "manipulator 1").reading(0.0)


@pytest.mark.parametrize("position_um", [HOME[:3], (*HOME, 1.0), (), (math.nan, *HOME[1:])])
def test_a_reading_with_other_axes_is_refused(position_um: tuple[float, ...]) -> None:
    record = rested()
    assert not record.on_position(position_um, 1.0)
    assert record.reading(0.2).taken_s == 0.2


def test_an_older_reading_never_replaces_a_newer_one() -> None:
    record = rested(0.2)
    assert not record.on_position((0.0, *HOME[1:]), 0.19)
    assert record.reading(0.2).position.x_um == HOME[0]


def test_silence_fails_after_100_ms_and_heals() -> None:
    record = rested(0.2)
    assert record.reading(0.3).taken_s == 0.2
    with pytest.raises(DeviceError, match="not answered for 101 ms"):
        record.reading(0.301)
    read(record, 0.0, 0.5)
    assert record.reading(0.5).taken_s == 0.5


def test_missing_acknowledgements_fail_after_100_ms() -> None:
    record = rested()
    record.require_acknowledged(0.1)
    with pytest.raises(DeviceError, match="not acknowledged a move for 101 ms"):
        record.require_acknowledged(0.101)


@pytest.mark.parametrize("axis", range(4))
@pytest.mark.parametrize("value_um", [-201.0, 20_201.0, 2_147_483.0])
def test_a_position_outside_the_travel_means_that_the_calibration_is_lost(axis: int, value_um: float) -> None:
    record = rested(0.2)
    lost_um = [value_um if number == axis else part for number, part in enumerate(HOME)]
    record.on_position(lost_um, 0.21)
    with pytest.raises(DeviceError, match=f"{'xyzw'[axis]} = .*zero calibration is lost; calibrate"):
        record.reading(0.21)


def test_the_edge_of_the_travel_is_no_loss() -> None:
    record = rested(0.2)
    record.on_position((-200.0, 20_200.0, 0.0, 20_000.0), 0.21)
    assert record.reading(0.21).position.y_um == 20_200.0


def test_an_error_status_fails_until_it_is_taken_back() -> None:
    record = rested(0.2)
    record.on_status(Status.ERROR, 0.2)
    with pytest.raises(DeviceError, match="reports an error"):
        record.reading(0.2)
    record.on_status(Status(0), 0.2)
    record.reading(0.2)


def test_a_hello_out_of_silence_is_a_restart_a_fault_for_a_second_and_a_warning_for_longer() -> None:
    record = rested(0.2)
    record.on_hello(2.0)
    read(record, 0.0, 2.1)
    with pytest.raises(DeviceError, match="started anew"):
        record.reading(2.1)
    read(record, 0.0, 3.1)
    record.reading(3.1)
    assert any("started anew" in text for text in record.warnings(3.1))


def test_a_hello_in_the_middle_of_answers_is_only_told() -> None:
    record = rested(0.2)
    record.on_hello(0.21)
    record.reading(0.21)
    assert any("anew" in text for text in record.warnings(0.21))
    assert record.warnings(11.0) == []


class TestMoving:
    def test_the_positions_alone_show_motion_and_rest(self) -> None:
        record = rested(0.2)
        ended_s = drive(record, 0.2, 100.0, 0.2)
        assert record.reading(ended_s).moving
        for tick in range(1, 12):
            read(record, 20.0, ended_s + tick / 50)
        assert not record.reading(ended_s + 0.22).moving

    def test_the_fourth_axis_moves_the_tip_too(self) -> None:
        record = rested(0.2)
        record.on_position((*HOME[:3], HOME[3] + 50.0), 0.22)
        assert record.reading(0.22).moving

    def test_scatter_is_no_motion(self) -> None:
        record = rested(0.2)
        for tick in range(20):
            read(record, 0.3 * (-1) ** tick, 0.2 + tick / 50)
        assert not record.reading(0.6).moving

    def test_a_status_is_believed_before_the_positions_show_it_but_not_for_ever(self) -> None:
        record = rested(0.2)
        record.on_status(Status.Z, 0.2)
        assert record.reading(0.21).moving
        for tick in range(1, 60):
            read(record, 0.0, 0.2 + tick / 50)
        assert not record.reading(1.38).moving

    def test_slack_is_the_way_since_the_reading(self) -> None:
        record = rested(0.2)
        assert record.slack_um(0.23) == 0.0
        ended_s = drive(record, 0.2, 1000.0, 0.2)
        assert record.slack_um(ended_s + 0.01) == pytest.approx(10.0)


class TestMissingNotifications:
    def test_motion_without_a_status_is_told(self) -> None:
        record = rested(0.2)
        ended_s = drive(record, 0.2, 500.0, 0.5)
        assert any("when it moves" in text for text in record.warnings(ended_s))

    def test_motion_with_a_status_is_not(self) -> None:
        record = rested(0.2)
        record.on_status(Status.X, 0.2)
        assert record.warnings(drive(record, 0.2, 500.0, 0.5)) == []

    @pytest.mark.parametrize(("completed", "said"), [(False, True), (True, False)])
    def test_an_arrival_without_completion_is_told(self, completed: bool, said: bool) -> None:
        record = rested(0.2)
        record.on_status(Status.X, 0.2)
        record.on_goto(StagePoint(HOME[0] + 50.0, *HOME[1:3]))
        ended_s = drive(record, 0.2, 250.0, 0.2)
        record.on_status(Status(0), ended_s)
        if completed:
            record.on_completed(0, ended_s)
        for tick in range(1, 30):
            read(record, 50.0, ended_s + tick / 50)
        assert any("has ended" in text for text in record.warnings(ended_s + 0.6)) is said

    def test_a_stop_expects_no_completion(self) -> None:
        record = rested(0.2)
        record.on_goto(StagePoint(*HOME[:3]))
        record.on_stop()
        for tick in range(50):
            read(record, 0.0, 0.2 + tick / 50)
        assert record.warnings(1.2) == []

    def test_a_failed_move_is_told(self) -> None:
        record = rested(0.2)
        record.on_goto(StagePoint(0.0, 0.0, 0.0))
        record.on_completed(3, 0.2)
        assert any("ended a move early" in text for text in record.warnings(0.2))


def test_a_status_that_says_moving_for_ever_is_told() -> None:
    record = rested(0.2)
    record.on_status(Status.X, 0.2)
    ended_s = drive(record, 0.2, 1000.0, 0.5)
    for tick in range(1, 46):
        read(record, 500.0, ended_s + tick / 50)
    assert record.warnings(ended_s + 0.9) == []
    for tick in range(46, 70):
        read(record, 500.0, ended_s + tick / 50)
    assert any("moves and rests" in text for text in record.warnings(ended_s + 1.4))
