"""The exchange with a device in simulated time, over a network that loses, doubles and reorders."""

import heapq
import itertools
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.core.frames import StagePoint
from mrnav_server.devices.sensapex.goto import Goto, goto
from mrnav_server.devices.sensapex.link import Heard, Link
from mrnav_server.devices.sensapex.loss import LossRate
from mrnav_server.devices.sensapex.smcp1 import Block, Kind, Message, Option, decode, encode

DEVICE, US, STRANGER = 7, 0x2A5, 9
TIMEOUT_S = 0.02
ORIGIN = StagePoint(0.0, 0.0, 0.0)


def new_link() -> Link:
    return Link(DEVICE, US, 100, TIMEOUT_S)


def move(x_um: float) -> Goto:
    return goto(StagePoint(x_um, 0.0, 0.0), 1000.0, ORIGIN)


def ack(request: bytes) -> bytes:
    asked = decode(request)
    return encode(Message(asked.sender, asked.receiver, asked.id, Option.ACK, asked.kind))


def data(request: bytes, *values: int, options: Option = Option.REPLY) -> bytes:
    asked = decode(request)
    return encode(Message(asked.sender, asked.receiver, asked.id, options, asked.kind, (Block(values),)))


def notification(kind: Kind, *values: int, options: Option = Option.NOTIFY | Option.REQ) -> bytes:
    return encode(Message(0x2FF, DEVICE, 3, options, kind, (Block(values),)))


def heard(link: Link, datagram: bytes, now_s: float = 0.0) -> Heard:
    said = link.receive(datagram, now_s)
    assert said is not None
    return said


class TestQueries:
    def test_a_query_asks_for_acknowledgement_and_data(self) -> None:
        asked = decode(new_link().ask(Kind.GET_PARAMETER, (0x105,), 0.0))
        assert (asked.receiver, asked.sender, asked.kind) == (DEVICE, US, Kind.GET_PARAMETER)
        assert asked.options == Option.REQ | Option.REQ_ACK | Option.REQ_RESP
        assert asked.values == (0x105,)

    def test_an_unanswered_query_is_sent_three_times_under_its_number_and_given_up(self) -> None:
        link = new_link()
        first = link.ask(Kind.GET_VERSION, (), 0.0)
        sent = [(0.0, first)]
        for tick in range(100):
            sent += [(tick / 1000, again) for again in link.due(tick / 1000)]
        assert [time_s for time_s, _ in sent] == [0.0, 0.02, 0.04]
        assert {datagram for _, datagram in sent} == {first}
        assert link.waiting == 0
        assert link.counters["unanswered"] == 1

    def test_an_acknowledgement_alone_does_not_end_a_query(self) -> None:
        link = new_link()
        asked = link.ask(Kind.GET_VERSION, (), 0.0)
        assert link.receive(ack(asked), 0.001) is None
        assert link.due(TIMEOUT_S) == [asked]

    def test_the_answer_names_its_question_once(self) -> None:
        link = new_link()
        asked = link.ask(Kind.GET_VERSION, (), 1.0)
        answer = heard(link, data(asked, 1, 2), 1.5)
        assert answer.message.values == (1, 2)
        assert answer.request is not None
        assert answer.request.first_s == 1.0
        assert link.receive(data(asked, 1, 2), 1.6) is None
        assert link.counters["late"] == 1

    def test_an_answer_of_another_kind_is_none(self) -> None:
        link = new_link()
        asked = decode(link.ask(Kind.GET_VERSION, (), 0.0))
        other = Message(US, DEVICE, asked.id, Option.REPLY, Kind.GET_INFO, (Block((1,)),))
        assert link.receive(encode(other), 0.0) is None
        assert link.waiting == 1

    def test_a_question_for_the_position_is_never_repeated(self) -> None:
        link = new_link()
        link.poll(0.0)
        assert [link.due(tick / 1000) for tick in range(59)] == [[]] * 59
        assert link.waited_s(0.05) == 0.05
        assert link.waiting == 1
        link.due(0.0601)
        assert link.waiting == 0

    def test_numbers_go_on_past_sixteen_bits(self) -> None:
        link = Link(DEVICE, US, 0xFFFE, TIMEOUT_S)
        numbers = [decode(link.poll(0.0)).id for _ in range(3)]
        assert numbers == [0xFFFF, 1, 2]


class TestMoves:
    def test_only_the_newest_move_is_repeated(self) -> None:
        link = new_link()
        link.goto(move(1.0), 0.0)
        newest = link.goto(move(2.0), 0.01)
        sent = [again for tick in range(200) for again in link.due(tick / 1000)]
        assert sent == [newest, newest]

    def test_an_acknowledged_move_is_left_alone(self) -> None:
        link = new_link()
        sent = link.goto(move(1.0), 0.0)
        link.receive(ack(sent), 0.001)
        assert link.due(1.0) == []
        assert link.unacknowledged_s(1.0) == 0.0

    def test_missing_acknowledgements_are_timed_from_the_first(self) -> None:
        link = new_link()
        for tick in range(12):
            link.goto(move(tick), tick / 100)
        assert link.unacknowledged_s(0.11) == pytest.approx(0.11)

    def test_an_acknowledgement_vouches_for_the_moves_before(self) -> None:
        link = new_link()
        link.goto(move(1.0), 0.0)
        second = link.goto(move(2.0), 0.01)
        link.goto(move(3.0), 0.02)
        link.receive(ack(second), 0.021)
        assert link.unacknowledged_s(0.05) == pytest.approx(0.03)

    def test_a_move_that_overtook_the_newest_is_put_right(self) -> None:
        link = new_link()
        older = link.goto(move(1.0), 0.0)
        newest = link.goto(move(2.0), 0.01)
        link.receive(ack(newest), 0.02)
        again = decode(heard(link, ack(older), 0.021).reply)
        assert again.blocks == decode(newest).blocks
        assert again.id not in (decode(older).id, decode(newest).id)
        assert link.counters["reordered"] == 1

    def test_after_a_stop_nothing_is_repeated_or_put_right(self) -> None:
        link = new_link()
        older = link.goto(move(1.0), 0.0)
        newest = link.goto(move(2.0), 0.01)
        link.receive(ack(newest), 0.02)
        link.goto(move(3.0), 0.02)
        link.drop_moves()
        assert link.receive(ack(older), 0.021) is None
        assert [link.due(tick / 1000) for tick in range(100)] == [[]] * 100
        assert link.unacknowledged_s(1.0) == 0.0

    def test_a_refusal_is_told(self) -> None:
        link = new_link()
        sent = decode(link.goto(move(1.0), 0.0))
        refusal = Message(US, DEVICE, sent.id, Option.ACK | Option.ERROR, Kind.GOTO)
        assert heard(link, encode(refusal)).message.options & Option.ERROR


class TestStrangers:
    @pytest.mark.parametrize(
        ("datagram", "counted"),
        [
            (b"", "garbage"),
            (b"\x10" * 15, "garbage"),
            (b"\x11" + notification(Kind.HELLO)[1:], "garbage"),
            (notification(Kind.POSITION, 1, 2, 3)[:-1], "garbage"),
            (encode(Message(US, STRANGER, 1, Option.ACK, Kind.GOTO)), "foreign"),
            (encode(Message(US + 1, DEVICE, 1, Option.ACK, Kind.GOTO)), "foreign"),
            (encode(Message(US, DEVICE, 1, Option.REQ, Kind.GOTO)), "foreign"),
            (encode(Message(US, DEVICE, 1, Option.ACK, Kind.GOTO)), "late"),
            (encode(Message(US, DEVICE, 1, Option.REPLY, Kind.GOTO)), "late"),
        ],
    )
    def test_what_says_nothing_to_us_is_counted(self, datagram: bytes, counted: str) -> None:
        link = new_link()
        link.goto(move(1.0), 0.0)
        assert link.receive(datagram, 0.0) is None
        assert link.counters[counted] == 1
        assert link.unacknowledged_s(1.0) == 1.0

    @given(datagram=st.binary(max_size=64))
    def test_nothing_that_arrives_raises(self, datagram: bytes) -> None:
        link = new_link()
        link.goto(move(1.0), 0.0)
        link.receive(datagram, 0.0)
        link.receive(b"\x10\x00" + US.to_bytes(2, "big") + DEVICE.to_bytes(2, "big") + datagram, 0.0)


class TestNotifications:
    def test_one_that_wants_it_is_acknowledged(self) -> None:
        options = Option.NOTIFY | Option.REQ | Option.REQ_ACK
        told = heard(new_link(), notification(Kind.GOTO_DONE, 0, options=options))
        assert told.request is None
        assert decode(told.reply) == Message(DEVICE, US, 3, Option.ACK, Kind.GOTO_DONE)

    def test_one_that_wants_nothing_gets_nothing(self) -> None:
        assert heard(new_link(), notification(Kind.STATUS, 0x10)).reply == b""


class TestLoss:
    def test_three_losses_among_few_requests_are_told_for_ten_seconds(self) -> None:
        link = new_link()
        link.ask(Kind.GET_VERSION, (), 0.0)
        for tick in range(100):
            link.due(tick / 1000)
        assert link.loss.warnings(0.1)[0].startswith("the controller left 3 of 3 requests")
        assert link.loss.warnings(10.2) == []

    def test_a_few_among_many_are_not(self) -> None:
        loss = LossRate()
        for tick in range(100):
            loss.on_request(tick / 100)
        for _ in range(5):
            loss.on_loss(1.0)
        assert loss.warnings(1.0) == []
        loss.on_loss(1.0)
        assert len(loss.warnings(1.0)) == 1


class Network:
    """A device that executes each request once, and a network that does with datagrams what it is told.

    Args:
        fate: For each request the delays of its copies in s; none is a loss.
        answer_fate: The same for each answer.
    """

    def __init__(self, fate: Callable[[], list[float]], answer_fate: Callable[[], list[float]]) -> None:
        self.link = new_link()
        self.executed: list[int] = []
        self.sent: list[bytes] = []
        self._fate, self._answer_fate = fate, answer_fate
        self._seen: set[int] = set()
        self._order = itertools.count()
        self._under_way: list[tuple[float, int, bool, bytes]] = []

    def put(self, datagram: bytes, now_s: float) -> None:
        self.sent.append(datagram)
        self._spread(True, datagram, now_s, self._fate())

    def _spread(self, to_device: bool, datagram: bytes, now_s: float, delays_s: list[float]) -> None:
        for delay_s in delays_s:
            heapq.heappush(self._under_way, (now_s + delay_s, next(self._order), to_device, datagram))

    def advance(self, now_s: float) -> None:
        while self._under_way and self._under_way[0][0] <= now_s:
            at_s, _, to_device, datagram = heapq.heappop(self._under_way)
            if to_device:
                request = decode(datagram)
                if request.kind == Kind.GOTO and request.id not in self._seen:
                    self._seen.add(request.id)
                    self.executed.append(request.values[0])
                if request.options & Option.REQ:
                    self._spread(False, ack(datagram), at_s, self._answer_fate())
            elif (said := self.link.receive(datagram, at_s)) and said.reply:
                self.put(said.reply, at_s)

    def stream(self, moves: int, until_s: float) -> float:
        """Send a move every 10 ms; return the longest time without an acknowledgement."""
        missing_s = 0.0
        for tick in range(round(until_s * 1000)):
            now_s = tick / 1000
            self.advance(now_s)
            if tick % 10 == 0 and tick // 10 < moves:
                self.put(self.link.goto(move(1.0 + tick // 10), now_s), now_s)
            for again in self.link.due(now_s):
                self.put(again, now_s)
            missing_s = max(missing_s, self.link.unacknowledged_s(now_s))
        return missing_s


@given(
    moves=st.integers(1, 20),
    fates=st.lists(st.sampled_from([0, 1, 1, 2]), max_size=80),
    answers=st.lists(st.sampled_from([0, 1, 1, 2]), max_size=80),
)
def test_with_losses_and_copies_the_newest_wins_or_its_loss_is_known(
    moves: int, fates: list[int], answers: list[int]
) -> None:
    """Order kept: whatever is lost, the device ends at the newest target, or the silence is noticed."""
    drawn, drawn_answers = iter(fates), iter(answers)
    network = Network(lambda: [0.001] * next(drawn, 1), lambda: [0.001] * next(drawn_answers, 1))
    missing_s = network.stream(moves, 1.0)
    assert network.executed == sorted(network.executed)
    assert (network.executed and network.executed[-1] == moves * 1000) or missing_s > 0.1
    assert all(network.sent.count(datagram) <= 3 for datagram in network.sent)


@given(moves=st.integers(1, 20), delays_ms=st.lists(st.integers(0, 35), max_size=80))
def test_the_newest_wins_over_a_network_that_reorders(moves: int, delays_ms: list[int]) -> None:
    drawn = iter(delays_ms)
    network = Network(lambda: [next(drawn, 0) / 1000], lambda: [0.0])
    assert network.stream(moves, 1.0) < 0.1
    assert network.executed[-1] == moves * 1000


@given(
    moves=st.integers(1, 20),
    fates=st.lists(st.lists(st.integers(0, 60), max_size=3), max_size=80),
    answers=st.lists(st.lists(st.integers(0, 60), max_size=3), max_size=80),
    stop_tick=st.integers(0, 250),
)
def test_no_move_leaves_after_a_stop_whatever_the_network_does(
    moves: int, fates: list[list[int]], answers: list[list[int]], stop_tick: int
) -> None:
    drawn, drawn_answers = iter(fates), iter(answers)
    network = Network(
        lambda: [delay / 1000 for delay in next(drawn, [0])],
        lambda: [delay / 1000 for delay in next(drawn_answers, [0])],
    )
    network.stream(moves, stop_tick / 1000)
    network.link.drop_moves()
    before = len(network.sent)
    for tick in range(stop_tick, stop_tick + 500):
        network.advance(tick / 1000)
        for again in network.link.due(tick / 1000):
            network.put(again, tick / 1000)
    assert network.sent[before:] == []
