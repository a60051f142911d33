"""The emulated manipulator, told the time: every request, every notification, every knob."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.core.errors import ConfigError, WireError
from mrnav_server.devices.sensapex.emulated_device import VERSION, ZERO_LOST_UM, EmulatedDevice
from mrnav_server.devices.sensapex.emulated_outbox import Outgoing
from mrnav_server.devices.sensapex.emulated_registers import DeviceModel
from mrnav_server.devices.sensapex.emulator_faults import Faults
from mrnav_server.devices.sensapex.smcp1 import (
    ALL_DEVICES,
    ALL_PCS,
    COMMAND,
    MOVE,
    QUERY,
    UNDEFINED,
    Block,
    DataType,
    Feature,
    Kind,
    Message,
    Option,
    Parameter,
    Status,
    decode,
    encode,
)

PEER = ("127.0.0.1", 40_000)
OTHER = ("127.0.0.1", 40_001)
PC = 0x0257
MIDDLE_NM = 10_000_000
A = 50_000.0
QUIET = Faults(noise_um=0.0)


class Bench:
    """A device, a clock, and a client that numbers its requests."""

    def __init__(self, faults: Faults = QUIET, **model: object) -> None:
        self.device = EmulatedDevice(DeviceModel(**model), faults)  # type: ignore[arg-type]
        self.now_s = 100.0
        self.number = 0

    def ask(
        self,
        kind: Kind | int,
        *blocks: tuple[int, ...],
        options: Option = QUERY,
        receiver: int = 1,
        peer: tuple[str, int] = PEER,
        number: int | None = None,
    ) -> list[Message]:
        """Send a request and return what the device sends at once."""
        self.number += 1
        sent = tuple(Block(block) for block in blocks)
        message = Message(receiver, PC, self.number if number is None else number, options, kind, sent)
        return [item.message for item in self.device.receive(message, peer, self.now_s)]

    def data(self, kind: Kind, *values: int) -> tuple[int, ...]:
        """Ask for data and return them."""
        answers = self.ask(kind, values) if values else self.ask(kind)
        assert answers[-1].options == Option.REPLY
        return answers[-1].values

    def goto(self, *values: int, own: tuple[int, ...] = ()) -> list[Message]:
        return self.ask(Kind.GOTO, values, *([own] if own else []), options=MOVE)

    def run(self, for_s: float) -> list[tuple[float, Message]]:
        """Let time pass and return what is sent, and when."""
        until_s, heard = self.now_s + for_s, []
        while (due_s := self.device.due_s(self.now_s)) <= until_s:
            self.now_s = max(self.now_s, due_s)
            heard += [(self.now_s, item.message) for item in self.device.advance(self.now_s)]
        self.now_s = until_s
        return heard

    def true_um(self) -> list[float]:
        at_um = self.device.true_state(self.now_s)["true_um"]
        assert isinstance(at_um, list)
        return at_um

    def turn(self, **knobs: object) -> None:
        self.device.set_faults(self.device.faults.changed(knobs), self.now_s)


def kinds(heard: list[tuple[float, Message]]) -> list[int]:
    return [message.kind for _, message in heard]


def nm(*at_um: float) -> tuple[int, ...]:
    return tuple(round(um * 1000) for um in at_um)


# Exchange


def test_an_acknowledgement_repeats_number_and_kind_and_comes_first() -> None:
    answers = Bench().ask(Kind.GET_POSITIONS)
    head = Message(PC, 1, 1, Option.ACK, Kind.GET_POSITIONS)
    middle = (MIDDLE_NM,) * 4
    assert answers == [head, replace(head, options=Option.REPLY, blocks=(Block(middle),))]


def test_only_what_is_asked_for_is_answered() -> None:
    bench = Bench()
    assert bench.ask(Kind.STOP, options=Option.REQ) == []
    assert [m.options for m in bench.ask(Kind.STOP, options=COMMAND)] == [Option.ACK]
    alone = bench.ask(Kind.GET_VERSION, options=Option.REQ | Option.REQ_RESP)
    assert [m.options for m in alone] == [Option.REPLY]


def test_what_is_no_request_is_ignored() -> None:
    bench = Bench()
    assert bench.ask(Kind.PING, options=Option.ACK) == []
    assert bench.ask(Kind.PING, options=Option.REPLY) == []
    assert bench.ask(Kind.POSITION, options=Option.NOTIFY | Option.REQ | Option.REQ_ACK) == []


def test_it_listens_to_its_ids_and_to_everybody() -> None:
    device = EmulatedDevice(DeviceModel(id=3))
    assert all(device.listens_to(number) for number in (3, ALL_DEVICES, 0x04FF, 0x07FF, 0x1000 + 103))
    assert not any(device.listens_to(number) for number in (1, 0, 0x01FF, ALL_PCS, 0x03FF, 0x1003))


def test_a_device_with_a_serial_number_answers_under_its_direct_id() -> None:
    bench = Bench(id=11_400_123)
    assert bench.device.listens_to(0x107B)
    assert not bench.device.listens_to(123)
    assert bench.ask(Kind.PING, options=COMMAND, receiver=ALL_DEVICES)[0].sender == 0x107B


def test_an_unknown_request_is_an_error() -> None:
    answers = Bench().ask(99)
    assert [m.options for m in answers] == [Option.ACK | Option.ERROR, Option.ERROR]
    assert answers[1].blocks == ()


def test_a_retransmission_is_answered_but_not_carried_out_again() -> None:
    bench = Bench()
    step = (100_000, 0, 0, 0, 1000, 0, 0, 0, 0)
    assert bench.ask(Kind.STEP, step, options=COMMAND, number=7)[0].options == Option.ACK
    bench.run(0.5)
    again = bench.ask(Kind.STEP, step, options=COMMAND, number=7)
    assert [m.options for m in again] == [Option.ACK]
    bench.run(0.4)
    assert bench.true_um()[0] == 10_100.0


@pytest.mark.parametrize("how", ["new number", "other content", "other socket", "a second later"])
def test_what_is_no_retransmission_is_carried_out(how: str) -> None:
    bench = Bench()
    bench.ask(Kind.STEP, (100_000, 0, 0, 0, 1000, 0, 0, 0, 0), options=COMMAND, number=7)
    bench.run(1.0 if how == "a second later" else 0.5)
    bench.ask(
        Kind.STEP,
        (100_000, 0, 0, 0, 1001 if how == "other content" else 1000, 0, 0, 0, 0),
        options=COMMAND,
        number=8 if how == "new number" else 7,
        peer=OTHER if how == "other socket" else PEER,
    )
    bench.run(1.0)
    assert bench.true_um()[0] == pytest.approx(10_200.0)


def test_a_request_that_waits_for_the_trigger_is_taken_and_not_carried_out() -> None:
    bench = Bench()
    answers = bench.ask(Kind.GOTO, (0, 0, 0, 0, 1000, 1), options=MOVE | Option.WAIT_TRIGGER_1)
    assert [m.options for m in answers] == [Option.ACK]
    bench.run(1.0)
    assert bench.true_um() == [10_000.0] * 4


# Requests for data


@pytest.mark.parametrize("axes", [3, 4])
def test_positions_have_as_many_values_as_axes(axes: int) -> None:
    bench = Bench(axes=axes, start_um=(1.0, 2.5, 19_999.0))
    assert bench.data(Kind.GET_POSITIONS) == nm(1.0, 2.5, 19_999.0, 10_000.0)[:axes]
    assert bench.data(Kind.GET_PARAMETER, Parameter.AXIS_COUNT) == (Parameter.AXIS_COUNT, axes)


def test_ping_returns_the_request_if_asked() -> None:
    bench = Bench()
    assert bench.ask(Kind.PING, (1, 2))[-1].values == (1, 2)
    assert bench.ask(Kind.PING, options=COMMAND)[0].options == Option.ACK


def test_version_info_and_error_state() -> None:
    bench = Bench(axes=3)
    assert bench.data(Kind.GET_VERSION) == VERSION
    assert bench.ask(Kind.GET_INFO)[-1].blocks[0].text == "emulated uMp-3"
    assert bench.ask(Kind.GET_ERROR)[-1].blocks == (Block((0,), DataType.UINT32),)
    assert bench.ask(Kind.CLEAR_ERROR, options=COMMAND)[0].options == Option.ACK


@pytest.mark.parametrize("kind", [Kind.SLEEP, Kind.WAKE_UP, Kind.SAVE_ZERO, Kind.CLEAR_ERROR, Kind.STOP])
def test_commands_without_data_are_acknowledged(kind: Kind) -> None:
    bench = Bench()
    assert [m.options for m in bench.ask(kind, (0,), options=COMMAND)] == [Option.ACK]
    assert bench.ask(kind, (0,))[-1].values == (0,)


@pytest.mark.parametrize(
    ("number", "value"),
    [
        (Parameter.MEMORY_SPEED, 250),
        (Parameter.DEVICE_ID, 9),
        (Parameter.VIRTUAL_X_ANGLE, 899),
        (Parameter.UDP_PORT, 55_565),
        (Parameter.SOFT_START, 3),
        (Parameter.AXIS_HEAD, 15),
    ],
)
def test_a_parameter_keeps_what_it_is_set_to(number: Parameter, value: int) -> None:
    bench = Bench()
    assert bench.ask(Kind.SET_PARAMETER, (number, value), options=COMMAND)[0].options == Option.ACK
    assert bench.data(Kind.GET_PARAMETER, number) == (number, value)


@pytest.mark.parametrize(
    "arguments",
    [
        (Parameter.SERIAL, 5),
        (Parameter.AXIS_COUNT, 4),
        (Parameter.VIRTUAL_X_ANGLE, 900),
        (0x201, 1),
        (4,),
        (),
    ],
)
def test_a_parameter_that_cannot_be_set_so_is_an_error(arguments: tuple[int, ...]) -> None:
    bench = Bench()
    assert bench.ask(Kind.SET_PARAMETER, arguments)[-1].options == Option.ERROR
    assert bench.data(Kind.GET_PARAMETER, Parameter.SERIAL)[1] == 11_400_101


def test_an_unknown_parameter_is_an_error() -> None:
    assert Bench().ask(Kind.GET_PARAMETER, (0x201,))[-1].options == Option.ERROR


@pytest.mark.parametrize(
    ("setter", "getter", "numbers"),
    [
        (Kind.SET_FEATURE, Kind.GET_FEATURE, (Feature.LEDS_OFF, Feature.PREVENT_MOVEMENT)),
        (Kind.SET_EXTENDED_FEATURE, Kind.GET_EXTENDED_FEATURE, (Feature.LOW_SPEED, Feature.SOFT_START)),
    ],
)
def test_features_turn_on_and_off(setter: Kind, getter: Kind, numbers: tuple[int, ...]) -> None:
    bench = Bench()
    for number in numbers:
        for value in (1, 0):
            bench.ask(setter, (number, value), options=COMMAND)
            assert bench.data(getter, number) == (number, value)
    assert bench.ask(setter, (numbers[0], 2))[-1].options == Option.ERROR
    assert bench.ask(setter, (99, 1))[-1].options == Option.ERROR
    assert bench.ask(getter, (99,))[-1].options == Option.ERROR


def test_the_mask_of_features_has_a_bit_for_each_that_is_on() -> None:
    bench = Bench()
    bench.ask(Kind.SET_FEATURE, (Feature.LEDS_OFF, 1), options=COMMAND)
    bench.ask(Kind.SET_EXTENDED_FEATURE, (Feature.SOFT_START, 1), options=COMMAND)
    assert bench.ask(Kind.GET_FEATURES)[-1].blocks == (Block((1 << 16 | 1 << 33,), DataType.UINT64),)


def test_the_axis_angle_is_the_one_that_was_set() -> None:
    bench = Bench()
    bench.ask(Kind.SET_PARAMETER, (Parameter.VIRTUAL_X_ANGLE, 305), options=COMMAND)
    assert bench.data(Kind.AXIS_ANGLE, 3, 1) == (305,)


# Motion


def test_a_goto_is_acknowledged_reported_and_completed() -> None:
    bench = Bench()
    at_once = bench.goto(*nm(10_500.0, 9_900.0), UNDEFINED, UNDEFINED, 2000, 1)
    assert [m.kind for m in at_once] == [Kind.GOTO, Kind.STATUS]
    assert at_once[0].options == Option.ACK
    assert at_once[1].values == (Status.X | Status.Y,)
    began_s = bench.now_s
    heard = bench.run(1.0)
    statuses = [message.values[0] for _, message in heard if message.kind == Kind.STATUS]
    assert statuses == [Status.X, 0]
    assert kinds(heard)[-3:] == [Kind.STATUS, Kind.POSITION, Kind.GOTO_DONE]
    done_s, done = heard[-1]
    assert done_s - began_s == pytest.approx(500.0 / 2000.0 + 2000.0 / A)
    assert done.values == (0,)
    assert (done.receiver, done.options) == (PC, Option.NOTIFY | Option.REQ | Option.REQ_ACK)
    assert heard[-2][1].values == nm(10_500.0, 9_900.0, 10_000.0, 10_000.0)
    numbers = [message.id for _, message in heard]
    assert 0 not in numbers
    assert len(set(numbers)) == len(numbers)


def test_positions_come_every_ten_milliseconds_and_follow_the_trapezoid() -> None:
    bench = Bench()
    bench.goto(*nm(11_000.0), UNDEFINED, UNDEFINED, UNDEFINED, 1000, 1)
    began_s = bench.now_s
    reports = [(t, m.values[0]) for t, m in bench.run(0.505) if m.kind == Kind.POSITION]
    assert [t - began_s for t, _ in reports] == pytest.approx([0.01 * n for n in range(1, 51)])
    ramp_s = 1000.0 / A
    for t, at_nm in reports[2:]:
        assert at_nm / 1000 == pytest.approx(10_000.0 + 1000.0 * (t - began_s - ramp_s / 2), abs=0.001)


def test_reports_go_to_every_client_and_the_completion_to_the_one_who_asked() -> None:
    bench = Bench()
    bench.ask(Kind.PING, peer=OTHER)
    bench.goto(*nm(10_100.0), UNDEFINED, UNDEFINED, UNDEFINED, 1000, 1)
    sent: list[Outgoing] = []
    while (due_s := bench.device.due_s(bench.now_s)) < math.inf:
        bench.now_s = max(bench.now_s, due_s)
        sent += bench.device.advance(bench.now_s)
    to = {kind: {item.peer for item in sent if item.message.kind == kind} for kind in (101, 102, 104)}
    assert to == {101: {PEER, OTHER}, 102: {PEER, OTHER}, 104: {PEER}}


def test_a_client_that_is_silent_for_long_is_told_no_more() -> None:
    bench = Bench()
    bench.ask(Kind.PING, peer=OTHER)
    bench.now_s += 31.0
    bench.ask(Kind.PING)
    bench.goto(*nm(10_100.0), UNDEFINED, UNDEFINED, UNDEFINED, 1000, 1)
    assert {item.peer for item in bench.device.advance(bench.now_s + 0.01)} == {PEER}


def test_without_a_wish_to_be_notified_there_is_no_completion() -> None:
    bench = Bench()
    bench.ask(Kind.GOTO, (*nm(10_100.0, 1.0, 1.0, 1.0), 5000, 1), options=COMMAND)
    assert Kind.GOTO_DONE not in kinds(bench.run(5.0))


@pytest.mark.parametrize("values", [(UNDEFINED,) * 4, (MIDDLE_NM,) * 4])
def test_a_goto_that_moves_nothing_is_completed_at_once(values: tuple[int, ...]) -> None:
    answers = Bench().goto(*values)
    assert [m.kind for m in answers] == [Kind.GOTO, Kind.GOTO_DONE]


def test_own_speeds_win_over_the_common_one() -> None:
    bench = Bench()
    bench.goto(*nm(0.0, 0.0, 0.0, 0.0), 2000, 1, own=(100, 0, 300))
    bench.run(0.5)
    state = bench.device.true_state(bench.now_s)
    assert state["velocity_um_per_s"] == [-100.0, -2000.0, -300.0, -2000.0]


@pytest.mark.parametrize(
    ("speed", "um_per_s"), [(0, 1000.0), (UNDEFINED, 1000.0), (-250, 0.25), (7, 7.0), (900_000, 5000.0)]
)
def test_speeds_are_micrometres_or_if_negative_nanometres_a_second(speed: int, um_per_s: float) -> None:
    bench = Bench()
    bench.goto(*nm(0.0), UNDEFINED, UNDEFINED, UNDEFINED, speed, 1)
    bench.run(0.5)
    velocities = bench.device.true_state(bench.now_s)["velocity_um_per_s"]
    assert velocities == [pytest.approx(-um_per_s), 0.0, 0.0, 0.0]


def test_the_memory_speed_is_that_of_a_goto_without_one() -> None:
    bench = Bench()
    bench.ask(Kind.SET_PARAMETER, (Parameter.MEMORY_SPEED, 300), options=COMMAND)
    bench.goto(*nm(0.0, 10_000.0, 10_000.0))
    bench.run(0.5)
    velocities = bench.device.true_state(bench.now_s)["velocity_um_per_s"]
    assert velocities == [-300.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(("asked", "used"), [(0, A), (1000, 1000.0), (900_000, A)])
def test_a_goto_can_lower_the_acceleration(asked: int, used: float) -> None:
    bench = Bench()
    began_s = bench.now_s
    bench.goto(*nm(10_500.0), UNDEFINED, UNDEFINED, UNDEFINED, 500, 1, asked)
    assert bench.run(3.0)[-1][0] - began_s == pytest.approx(1.0 + 500.0 / used)


def test_without_a_mode_axes_move_one_after_another() -> None:
    bench = Bench()
    bench.goto(*nm(10_100.0, 10_100.0, 10_100.0, 10_100.0), 1000)
    statuses = [message.values[0] for _, message in bench.run(3.0) if message.kind == Kind.STATUS]
    assert statuses == [Status.Y, Status.Z, Status.W, 0]
    assert bench.true_um() == [10_100.0] * 4


def test_a_new_goto_replaces_and_only_the_last_is_completed() -> None:
    bench = Bench()
    bench.goto(*nm(15_000.0), UNDEFINED, UNDEFINED, UNDEFINED, 2000, 1)
    bench.run(0.3)
    bench.goto(*nm(10_000.0), UNDEFINED, UNDEFINED, UNDEFINED, 2000, 1)
    heard = bench.run(5.0)
    assert kinds(heard).count(Kind.GOTO_DONE) == 1
    assert bench.true_um()[0] == 10_000.0


def test_stop_brakes_and_ends_the_goto_with_a_code() -> None:
    bench = Bench()
    bench.goto(*nm(15_000.0), UNDEFINED, UNDEFINED, UNDEFINED, 2400, 1)
    bench.run(0.5)
    before_um = bench.true_um()[0]
    assert [m.options for m in bench.ask(Kind.STOP, options=COMMAND)] == [Option.ACK]
    stopped_s = bench.now_s
    done_s, done = bench.run(1.0)[-1]
    assert (done.kind, done.values) == (Kind.GOTO_DONE, (1,))
    assert done_s - stopped_s == pytest.approx(2400.0 / A)
    assert bench.true_um()[0] - before_um == pytest.approx(2400.0**2 / (2 * A))


def test_stop_to_everybody_without_an_acknowledgement_stops() -> None:
    bench = Bench()
    bench.goto(*nm(15_000.0), UNDEFINED, UNDEFINED, UNDEFINED, 2400, 1)
    bench.run(0.5)
    assert bench.ask(Kind.STOP, options=Option.REQ, receiver=ALL_DEVICES) == []
    bench.run(0.1)
    assert bench.device.due_s(bench.now_s) == math.inf


def test_a_step_moves_by_a_distance_with_own_speeds() -> None:
    bench = Bench()
    began_s = bench.now_s
    answers = bench.ask(Kind.STEP, (*nm(50.0, -20.0, 0.0, 0.0), 100, 10, 0, 0, 0), options=COMMAND)
    assert answers[0].options == Option.ACK
    heard = bench.run(5.0)
    assert heard[-1][0] - began_s == pytest.approx(2.0 + 10.0 / A)
    assert bench.true_um() == [10_050.0, 9_980.0, 10_000.0, 10_000.0]


def test_motion_without_its_arguments_is_an_error() -> None:
    bench = Bench()
    assert bench.ask(Kind.GOTO)[-1].options == Option.ERROR
    assert bench.ask(Kind.STEP, (1, 2, 3))[-1].options == Option.ERROR
    assert bench.ask(Kind.GOTO_MEMORY, (3,))[-1].options == Option.ERROR


def test_a_stored_position_is_gone_back_to() -> None:
    bench = Bench()
    bench.ask(Kind.STORE_MEMORY, (2,), options=COMMAND)
    bench.goto(*nm(12_000.0, 9_000.0, 1.0, 1.0), 5000, 1)
    bench.run(5.0)
    bench.ask(Kind.GOTO_MEMORY, (2, 4000, 1, 0), options=MOVE)
    assert bench.run(5.0)[-1][1].kind == Kind.GOTO_DONE
    assert bench.true_um() == [10_000.0] * 4


@pytest.mark.parametrize(("mask", "moved"), [((0x05,), (0, 2)), ((0,), (0, 1, 2, 3)), ((), (0, 1, 2, 3))])
def test_the_zero_drive_finds_the_zero_again(mask: tuple[int, ...], moved: tuple[int, ...]) -> None:
    bench = Bench(Faults(noise_um=0.0, calibration_lost=True))
    bench.ask(Kind.ZERO_DRIVE, mask, options=COMMAND)
    heard = bench.run(20.0)
    assert (heard[-1][1].kind, heard[-1][1].values) == (Kind.ZERO_DRIVE_DONE, (0,))
    expected_um = [0.0 if axis in moved else 10_000.0 for axis in range(4)]
    assert bench.true_um() == expected_um
    assert bench.data(Kind.GET_POSITIONS) == nm(*expected_um)


def test_a_calibration_is_completed() -> None:
    answers = Bench().ask(Kind.CALIBRATE, (0,), options=COMMAND)
    assert [m.kind for m in answers] == [Kind.CALIBRATE, Kind.CALIBRATE_DONE]


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [(Kind.GOTO, (0, 0, 0, 0)), (Kind.STEP, (1000,) * 8), (Kind.ZERO_DRIVE, ()), (Kind.GOTO_MEMORY, (0,))],
)
def test_prevented_motion_is_not_even_acknowledged(kind: Kind, arguments: tuple[int, ...]) -> None:
    bench = Bench()
    bench.ask(Kind.STORE_MEMORY, (0,), options=COMMAND)
    bench.ask(Kind.SET_FEATURE, (Feature.PREVENT_MOVEMENT, 1), options=COMMAND)
    assert bench.ask(kind, arguments, options=MOVE) == []
    bench.run(1.0)
    assert bench.true_um() == [10_000.0] * 4


def test_beyond_the_travel_is_its_end() -> None:
    bench = Bench()
    bench.goto(*nm(30_000.0, -500.0), UNDEFINED, UNDEFINED, 5000, 1)
    bench.run(5.0)
    assert bench.true_um()[:2] == [20_000.0, 0.0]


# Knobs


def test_dropped_acknowledgements_count_down_and_the_request_is_carried_out() -> None:
    bench = Bench(Faults(noise_um=0.0, drop_acks=2))
    step = (100_000, 0, 0, 0, 1000, 0, 0, 0, 0)
    answers = [bench.ask(Kind.STEP, step, options=COMMAND, number=7) for _ in range(3)]
    assert [[m.kind for m in each if m.options & Option.ACK] for each in answers] == [[], [], [Kind.STEP]]
    assert bench.device.faults.drop_acks == 0
    bench.run(1.0)
    assert bench.true_um()[0] == 10_100.0


def test_dropped_requests_count_down_and_never_arrive() -> None:
    bench = Bench(Faults(noise_um=0.0, drop_requests=1))
    assert bench.goto(0, 0, 0, 0) == []
    bench.run(1.0)
    assert bench.true_um() == [10_000.0] * 4
    assert bench.ask(Kind.PING, options=COMMAND)[0].options == Option.ACK


def test_a_lost_completion_is_not_sent() -> None:
    bench = Bench(Faults(lose_completion=True))
    bench.goto(*nm(10_100.0), UNDEFINED, UNDEFINED, UNDEFINED, 1000, 1)
    assert set(kinds(bench.run(1.0))) == {Kind.STATUS, Kind.POSITION}


def test_without_status_positions_and_completion_still_come() -> None:
    bench = Bench(Faults(no_status=True))
    at_once = bench.goto(*nm(10_100.0), UNDEFINED, UNDEFINED, UNDEFINED, 1000, 1)
    assert [m.kind for m in at_once] == [Kind.GOTO]
    assert set(kinds(bench.run(1.0))) == {Kind.POSITION, Kind.GOTO_DONE}


def test_a_mute_device_says_nothing_and_obeys() -> None:
    bench = Bench(Faults(noise_um=0.0, mute=True))
    assert bench.goto(*nm(10_100.0), UNDEFINED, UNDEFINED, UNDEFINED, 1000, 1) == []
    assert bench.run(1.0) == []
    assert bench.true_um()[0] == 10_100.0


@given(st.floats(0.0, 500.0), st.floats(0.0, 500.0), st.lists(st.floats(0.0, 0.1), max_size=20))
def test_what_is_late_is_late_within_bounds_and_in_order(
    latency_ms: float, jitter_ms: float, pauses_s: list[float]
) -> None:
    bench = Bench(Faults(latency_ms=latency_ms, jitter_ms=jitter_ms))
    last_s = 0.0
    for number, pause_s in enumerate(pauses_s):
        bench.now_s += pause_s
        query = Message(1, PC, number + 1, QUERY, Kind.GET_POSITIONS)
        for item in bench.device.receive(query, PEER, bench.now_s):
            assert item.due_s >= bench.now_s + latency_ms / 1000
            assert item.due_s > last_s or item.due_s == bench.now_s
            assert item.due_s <= bench.now_s + (latency_ms + jitter_ms) / 1000 + 1e-4
            last_s = item.due_s


def test_a_stalled_axis_stays_while_the_device_says_that_it_moves() -> None:
    bench = Bench()
    bench.goto(*nm(11_000.0, 11_000.0), UNDEFINED, UNDEFINED, 1000, 1)
    bench.run(0.5)
    bench.turn(stall="x")
    stuck_um = bench.true_um()[0]
    heard = bench.run(5.0)
    assert bench.true_um()[:2] == [stuck_um, 11_000.0]
    assert [m.values[0] for _, m in heard if m.kind == Kind.STATUS] == [Status.X]
    assert Kind.GOTO_DONE not in kinds(heard)
    bench.turn(stall="")
    assert bench.run(5.0)[-1][1].kind == Kind.GOTO_DONE
    assert bench.true_um()[0] == 11_000.0


def test_a_stalled_device_obeys_stop() -> None:
    bench = Bench(Faults(noise_um=0.0, stall="xyzw"))
    bench.goto(0, 0, 0, 0)
    bench.run(0.1)
    bench.ask(Kind.STOP, options=COMMAND)
    assert bench.device.due_s(bench.now_s) == math.inf
    assert bench.true_um() == [10_000.0] * 4


def test_an_offset_is_in_every_reading_and_not_in_the_truth() -> None:
    bench = Bench(Faults(noise_um=0.0, offset_um=(0.5, -3.0)))
    expected = nm(10_000.5, 9_997.0, 10_000.0, 10_000.0)
    assert bench.data(Kind.GET_POSITIONS) == expected
    bench.goto(*nm(10_100.0), UNDEFINED, UNDEFINED, UNDEFINED, 1000, 1)
    last = [m for _, m in bench.run(1.0) if m.kind == Kind.POSITION][-1]
    assert last.values == nm(10_100.5, 9_997.0, 10_000.0, 10_000.0)
    assert bench.true_um() == [10_100.0, 10_000.0, 10_000.0, 10_000.0]


def test_a_frozen_reading_stays_and_comes_free() -> None:
    bench = Bench()
    bench.turn(freeze_reading=True)
    bench.goto(*nm(10_100.0), UNDEFINED, UNDEFINED, UNDEFINED, 1000, 1)
    heard = bench.run(1.0)
    assert {m.values[0] for _, m in heard if m.kind == Kind.POSITION} == {MIDDLE_NM}
    assert heard[-1][1].kind == Kind.GOTO_DONE
    assert bench.data(Kind.GET_POSITIONS)[0] == MIDDLE_NM
    bench.turn(freeze_reading=False)
    assert bench.data(Kind.GET_POSITIONS)[0] == 10_100_000


def test_a_lost_zero_shifts_readings_and_targets() -> None:
    bench = Bench()
    bench.turn(calibration_lost=True)
    assert bench.data(Kind.GET_POSITIONS) == nm(*[10_000.0 + ZERO_LOST_UM] * 4)
    bench.goto(*nm(10_000.0), UNDEFINED, UNDEFINED, UNDEFINED, 5000, 1)
    bench.run(5.0)
    assert bench.true_um()[0] == 20_000.0


def test_the_noise_is_as_wide_as_told_and_the_same_for_the_same_seed() -> None:
    def readings(seed: int) -> list[float]:
        bench = Bench(Faults(noise_um=0.05), seed=seed)
        return [v / 1000 - 10_000.0 for _ in range(500) for v in bench.data(Kind.GET_POSITIONS)]

    one = readings(1)
    assert math.sqrt(sum(v * v for v in one) / len(one)) == pytest.approx(0.05, rel=0.1)
    assert one == readings(1)
    assert one != readings(2)


def test_a_reboot_stands_still_is_deaf_and_dumb_and_says_hello() -> None:
    bench = Bench()
    bench.goto(*nm(15_000.0), UNDEFINED, UNDEFINED, UNDEFINED, 2400, 1)
    bench.run(0.5)
    at_um = bench.true_um()
    assert [m.options for m in bench.ask(Kind.REBOOT, options=COMMAND)] == [Option.ACK]
    rebooted_s = bench.now_s
    assert bench.goto(0, 0, 0, 0) == []
    [(hello_s, hello)] = bench.run(3.0)
    assert hello_s == pytest.approx(rebooted_s + 2.0)
    assert (hello.kind, hello.blocks, hello.receiver) == (Kind.HELLO, (), ALL_PCS)
    assert bench.true_um() == at_um
    assert bench.data(Kind.GET_POSITIONS) == nm(*at_um)


def test_a_reboot_forgets_what_was_asked_before() -> None:
    bench = Bench(Faults(noise_um=0.0, silence_s=0.1))
    step = (100_000, 0, 0, 0, 1000, 0, 0, 0, 0)
    bench.ask(Kind.STEP, step, options=COMMAND, number=7)
    bench.run(0.3)
    bench.device.reboot(bench.now_s)
    bench.run(0.2)
    bench.ask(Kind.STEP, step, options=COMMAND, number=7)
    bench.run(1.0)
    assert bench.true_um()[0] == 10_200.0


def test_how_long_a_reboot_takes_is_a_knob() -> None:
    bench = Bench(Faults(silence_s=0.25))
    bench.device.reboot(bench.now_s)
    assert bench.device.due_s(bench.now_s) == bench.now_s + 0.25


@pytest.mark.parametrize(
    "knobs",
    [
        {"drop_acks": -1},
        {"drop_acks": True},
        {"drop_requests": 1.5},
        {"mute": 1},
        {"latency_ms": float("nan")},
        {"latency_ms": -1},
        {"jitter_ms": 1e9},
        {"stall": "q"},
        {"stall": None},
        {"offset_um": [1, 2, 3, 4, 5]},
        {"offset_um": [float("inf")]},
        {"offset_um": "1,2"},
        {"noise_um": "much"},
        {"silence_s": 61},
        {"unknown": 1},
    ],
)
def test_a_knob_that_does_not_fit_is_named(knobs: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match=next(iter(knobs))):
        Faults().changed(knobs)


@pytest.mark.parametrize("model", [{"axes": 2}, {"id": 0}, {"id": 255}, {"start_um": (-1.0,)}])
def test_a_device_that_cannot_be_is_refused(model: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match=next(iter(model)).replace("start_um", "at")):
        DeviceModel(**model)  # type: ignore[arg-type]


# Garbage


@given(st.lists(st.binary(max_size=80), max_size=10))
def test_garbage_neither_raises_nor_moves(datagrams: list[bytes]) -> None:
    bench = Bench()
    for data in datagrams:
        try:
            message = decode(data)
        except WireError:
            continue
        bench.device.receive(message, PEER, bench.now_s)
    bench.run(1.0)
    assert bench.ask(Kind.PING, options=COMMAND, number=0xABCD)[0].options == Option.ACK


@given(
    st.lists(
        st.builds(
            Message,
            st.sampled_from((1, ALL_DEVICES, 0x1065)),
            st.integers(0, 0xFFFF),
            st.integers(0, 0xFFFF),
            st.integers(0, 0x3FF).map(Option),
            st.one_of(st.sampled_from(Kind), st.integers(0, 0xFFFF)).filter(lambda kind: kind != Kind.REBOOT),
            st.lists(
                st.one_of(
                    st.lists(st.integers(-(2**31), 2**31 - 1), max_size=12).map(lambda v: Block(tuple(v))),
                    st.lists(st.integers(-(2**63), 2**63 - 1), max_size=12).map(
                        lambda v: Block(tuple(v), DataType.INT64)
                    ),
                    st.binary(max_size=12).map(lambda v: Block(tuple(v), DataType.CHAR)),
                ),
                max_size=3,
            ).map(tuple),
        ),
        max_size=20,
    ),
    st.lists(st.floats(0.0, 2.0), min_size=20, max_size=20),
)
def test_any_request_is_answered_in_form_and_keeps_the_axes_in_their_travel(
    messages: list[Message], pauses_s: list[float]
) -> None:
    bench = Bench()
    for message, pause_s in zip(messages, pauses_s, strict=False):
        bench.now_s += pause_s
        for item in bench.device.receive(message, PEER, bench.now_s):
            assert decode(encode(item.message)) == item.message
        assert all(0.0 <= at_um <= 20_000.0 for at_um in bench.true_um())
        assert bench.device.due_s(bench.now_s) > bench.now_s
