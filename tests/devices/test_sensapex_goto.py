"""Targets that a uMp takes, and those that it is never told."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.frames import StagePoint
from mrnav_server.devices.sensapex.goto import goto
from mrnav_server.devices.sensapex.smcp1 import UNDEFINED

HOME = StagePoint(10_000.0, 10_000.0, 10_000.0)
travel_um = st.floats(0.0, 20_000.0)


def test_the_arguments_are_those_of_the_example_on_the_wire() -> None:
    move = goto(StagePoint(10_100.0, 9_950.5, 10_010.25), 500.0, HOME)
    position, speeds = move.blocks
    assert position.values == (10_100_000, 9_950_500, 10_010_250, UNDEFINED, max(speeds.values), 1)
    assert len(speeds.values) == 3


def test_all_axes_arrive_together_on_a_straight_line() -> None:
    move = goto(StagePoint(10_300.0, 9_600.0, 10_000.0), 1000.0, HOME)
    assert move.speeds_um_per_s == (600, 800, 1)
    assert move.speed_um_per_s == 1000


def test_where_the_tip_is_already_there_the_common_speed_serves() -> None:
    assert goto(HOME, 700.0, HOME).speeds_um_per_s == (700, 700, 700)


def test_an_uncertain_start_leaves_no_axis_crawling() -> None:
    move = goto(StagePoint(10_100.0, 10_000.0, 10_000.0), 1000.0, HOME, slack_um=20.0)
    assert move.speeds_um_per_s == (1000, 200, 200)


@given(
    target=st.builds(StagePoint, travel_um, travel_um, travel_um),
    start=st.builds(StagePoint, travel_um, travel_um, travel_um),
    speed=st.floats(1.0, 20_000.0),
    slack_um=st.floats(0.0, 500.0),
)
def test_every_move_is_within_travel_and_speed(
    target: StagePoint, start: StagePoint, speed: float, slack_um: float
) -> None:
    move = goto(target, speed, start, slack_um)
    assert all(0 <= value_nm <= 20_000_000 for value_nm in move.positions_nm)
    assert all(1 <= part <= round(speed) for part in move.speeds_um_per_s)
    sent = move.target
    assert math.dist((sent.x_um, sent.y_um, sent.z_um), (target.x_um, target.y_um, target.z_um)) < 0.001
    assert max(move.speeds_um_per_s) >= 0.57 * speed - 1


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("value_um", [math.nan, math.inf, -math.inf, -0.1, 20_000.1, 1e300])
def test_a_target_out_of_bounds_is_refused_by_name(axis: str, value_um: float) -> None:
    target = StagePoint(**{f"{name}_um": value_um if name == axis else 1.0 for name in "xyz"})
    with pytest.raises(DeviceError, match=f"{axis} = "):
        goto(target, 100.0, HOME)


@pytest.mark.parametrize("speed", [math.nan, math.inf, -5.0, 0.0, 0.99, 20_001.0])
def test_a_speed_out_of_bounds_is_refused(speed: float) -> None:
    with pytest.raises(DeviceError, match="speed"):
        goto(HOME, speed, HOME)
