import asyncio
import json
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any

import pytest

from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.core.frames import HandPoint
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.wire_hand import Hello
from mrnav_server.loops.hand_link import HandLinkConfig, HandLinkServer, TellLease, TwinState

TOKENS = {"op": "operator", "view": "viewer", "root": "admin"}


class Rig:
    """What stands behind the link in these tests; its clock stands still unless told."""

    def __init__(self, config: HandLinkConfig) -> None:
        self.now_s = 1000.0
        self.samples: list[HandSample] = []
        self.closed: list[str] = []
        self.bad_numbers: list[str] = []
        self.hellos: list[Hello] = []
        self.free = True
        self.tell: TellLease = lambda *_: None
        self.twin: TwinState | None = None
        self.changed = asyncio.Event()
        self.server = HandLinkServer(
            config,
            authorize=TOKENS.get,
            acquire=self.acquire,
            on_sample=lambda sample: self.note(self.samples, sample),
            on_closed=lambda session: self.note(self.closed, session),
            twin_source=lambda: self.twin,
            clock=lambda: self.now_s,
            on_bad_numbers=lambda session: self.note(self.bad_numbers, session),
            limits={"speed_um_per_s": 3000.0},
            transform={"gain": 0.04},
        )

    def acquire(self, session: str, hello: Hello, tell: TellLease) -> None:
        self.hellos.append(hello)
        if not self.free:
            raise RefusedError("lease_held", "test has control")
        self.free, self.tell = False, tell

    def note(self, where: list[Any], what: object) -> None:
        where.append(what)
        self.changed.set()

    async def until(self, condition: Callable[[], bool]) -> None:
        while not condition():
            self.changed.clear()
            await self.changed.wait()


class Client:
    """A headset that writes lines and reads lines."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader = reader
        self.writer = writer

    def send(self, *messages: dict[str, Any]) -> None:
        self.raw(b"".join(json.dumps(message).encode() + b"\n" for message in messages))

    def raw(self, data: bytes) -> None:
        self.writer.write(data)

    async def read(self) -> dict[str, Any]:
        return json.loads(await self.reader.readline())  # type: ignore[no-any-return]

    async def hello(self, **changes: object) -> dict[str, Any]:
        self.send({**HELLO, **changes})
        return await self.read()

    async def synchronise(self) -> None:
        """Wait until everything that was sent is handled."""
        self.send({"type": "ping", "t": 0})
        while (await self.read())["type"] != "pong":
            pass

    async def ended(self) -> bool:
        """Wait for the end of the connection; tell whether nothing was left to read."""
        try:
            return await self.reader.read() == b""
        except ConnectionResetError:
            return True


HELLO = {
    "type": "hello",
    "v": 1,
    "role": "operator",
    "token": "op",
    "client": "test",
    "frame": "webxr",
    "rate_hz": 60,
    "simulated": True,
}


def hand(seq: int, t_s: float = 0.0, x_m: float = 0.0, **changes: object) -> dict[str, Any]:
    return {"type": "hand", "seq": seq, "t": t_s, "p": [x_m, 0, 0], "clutch": True, "valid": True, **changes}


@asynccontextmanager
async def running(**config: Any) -> AsyncIterator[Rig]:  # noqa: ANN401 - passed on to the settings
    rig = Rig(HandLinkConfig(**{"port": 0, **config}))
    started = asyncio.Event()
    async with asyncio.TaskGroup() as group:
        task = group.create_task(rig.server.run(started))
        await started.wait()
        try:
            yield rig
        finally:
            task.cancel()


@asynccontextmanager
async def connected(rig: Rig) -> AsyncIterator[Client]:
    reader, writer = await asyncio.open_connection("127.0.0.1", rig.server.port)
    try:
        yield Client(reader, writer)
    finally:
        writer.transport.abort()
        with suppress(OSError):
            await writer.wait_closed()


async def test_a_hello_is_welcomed_and_hand_messages_become_samples() -> None:
    async with running() as rig, connected(rig) as client:
        welcome = await client.hello(model="steering", seed=4)
        assert welcome["type"] == "welcome"
        assert welcome["lease"] is True
        assert welcome["limits"] == {"speed_um_per_s": 3000.0}
        assert welcome["transform"] == {"gain": 0.04}
        assert (rig.hellos[0].model, rig.hellos[0].seed) == ("steering", 4)
        client.send(hand(1, 5.0, 0.25, pose=3))
        await rig.until(lambda: len(rig.samples) == 1)
        assert rig.samples == [
            HandSample(
                welcome["session"],
                1,
                5.0,
                1000.0,
                HandPoint(0.25, 0.0, 0.0),
                clutch=True,
                valid=True,
                new_pose=True,
            )
        ]


async def test_the_declared_frame_is_converted() -> None:
    async with running() as rig, connected(rig) as client:
        await client.hello(frame="unity")
        client.send(hand(1, p=[0.1, 0.2, 0.3]))
        await rig.until(lambda: bool(rig.samples))
        assert rig.samples[0].point == HandPoint(0.1, 0.2, -0.3)


async def test_lines_may_come_in_single_bytes() -> None:
    async with running() as rig, connected(rig) as client:
        await client.hello()
        for byte in json.dumps(hand(1)).encode() + b"\n":
            client.raw(bytes([byte]))
            await client.writer.drain()
        await rig.until(lambda: len(rig.samples) == 1)


async def test_sessions_differ_and_the_second_hand_gets_no_lease() -> None:
    async with running() as rig, connected(rig) as first, connected(rig) as second:
        one, two = await first.hello(), await second.hello()
        assert one["session"] != two["session"]
        assert (one["lease"], two["lease"]) == (True, False)
        assert await second.read() == {
            "type": "lease",
            "lease": False,
            "code": "lease_held",
            "message": "test has control",
        }


async def test_a_hand_is_told_that_it_lost_its_seat_and_stays_connected() -> None:
    async with running() as rig, connected(rig) as client:
        await client.hello()
        rig.tell(False, "displaced", "Chief took control over: connect anew")
        told = await client.read()
        assert (told["type"], told["lease"], told["code"]) == ("lease", False, "displaced")
        assert "Chief" in told["message"]
        await client.synchronise()


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"v": 2}, "bad_version"),
        ({"token": "guess"}, "bad_token"),
        ({"token": "view"}, "forbidden"),
        ({"role": "boss"}, "bad_message"),
        ({"type": "hand"}, "hello_first"),
        ({"rate_hz": 1e9}, "bad_number"),
    ],
)
async def test_a_wrong_hello_gets_an_error_and_the_door(changes: dict[str, object], code: str) -> None:
    async with running() as rig, connected(rig) as client:
        answer = await client.hello(**changes)
        assert (answer["type"], answer["code"]) == ("error", code)
        assert await client.ended()
        assert rig.hellos == []
        assert rig.closed == []


async def test_a_viewer_watches_and_never_moves_anything() -> None:
    async with running() as rig, connected(rig) as client:
        welcome = await client.hello(token="view", role="viewer")
        assert welcome["lease"] is False
        assert rig.hellos == []
        client.send(hand(1))
        assert (await client.read())["code"] == "forbidden"
        assert await client.ended()
        assert rig.samples == []


async def test_no_hello_in_time_is_the_end() -> None:
    async with running(hello_timeout_s=0.05) as rig, connected(rig) as client:
        assert (await client.read())["code"] == "no_hello"
        assert await client.ended()
        assert rig.closed == []


@pytest.mark.parametrize("before_hello", [True, False])
async def test_an_endless_line_is_cut(before_hello: bool) -> None:
    async with running() as rig, connected(rig) as client:
        if not before_hello:
            await client.hello()
        client.raw(b"x" * 5000)
        assert (await client.read())["code"] == "line_too_long"
        assert await client.ended()


@pytest.mark.parametrize(
    "junk",
    [b"}{", b"\xff", b"[" * 4000, b'{"type":"hand"}', b"", json.dumps(hand(2, clutch=1)).encode()],
)
async def test_a_malformed_line_ends_the_connection(junk: bytes) -> None:
    async with running() as rig, connected(rig) as client:
        welcome = await client.hello()
        client.raw(json.dumps(hand(1)).encode() + b"\n" + junk + b"\n" + json.dumps(hand(3)).encode() + b"\n")
        assert (await client.read())["type"] == "error"
        assert await client.ended()
        await rig.until(lambda: bool(rig.closed))
        assert [sample.seq for sample in rig.samples] == [1]
        assert rig.closed == [welcome["session"]]
        assert rig.server.counters["hand_malformed"] == 1


@pytest.mark.parametrize("literal", ["NaN", "-Infinity", "1e999", "9" * 500, "1e12"])
async def test_numbers_that_measure_nothing_are_counted_and_the_third_is_told(literal: str) -> None:
    async with running() as rig, connected(rig) as client:
        welcome = await client.hello()
        bad = json.dumps(hand(1, p=[0, "@", 0])).replace('"@"', literal).encode() + b"\n"
        client.raw(bad * 2)
        await client.synchronise()
        assert rig.bad_numbers == []
        client.raw(bad)
        await client.synchronise()
        assert rig.bad_numbers == [welcome["session"]]
        assert rig.server.counters["non_finite"] == 3
        assert rig.samples == []
        client.send(hand(2))
        await rig.until(lambda: len(rig.samples) == 1)


async def test_bad_numbers_far_apart_are_not_told() -> None:
    async with running() as rig, connected(rig) as client:
        await client.hello()
        for _ in range(5):
            client.raw(b'{"type":"ping","t":NaN}\n')
            await client.synchronise()
            rig.now_s += 0.6
        assert rig.bad_numbers == []


async def test_duplicates_and_reordering_do_not_drift() -> None:
    async with running() as rig, connected(rig) as client:
        await client.hello()
        sent = [hand(seq, seq / 60, 0.01 * seq) for seq in range(1, 21)]
        client.send(*sent[:10], *sent[:10], sent[12], sent[11], sent[10], sent[12], *sent[13:], sent[0])
        await client.synchronise()
        assert [sample.seq for sample in rig.samples] == [*range(1, 11), *range(13, 21)]
        assert rig.samples[-1].point.x_m == pytest.approx(0.20)
        assert rig.server.counters["hand_out_of_order"] == 14


async def test_increments_become_the_same_cumulative_position() -> None:
    async with running() as rig, connected(rig) as client:
        await client.hello(frame="unity")
        for seq in range(1, 5):
            client.send(
                {"type": "increment", "seq": seq, "t": 0, "d": [0, 0, 0.01], "clutch": True, "valid": True}
            )
        await rig.until(lambda: len(rig.samples) == 4)
        assert rig.samples[-1].point.z_m == pytest.approx(-0.04)


async def test_a_stale_burst_moves_nothing() -> None:
    async with running() as rig, connected(rig) as client:
        await client.hello()
        client.send(hand(0, 0.0))
        await rig.until(lambda: len(rig.samples) == 1)
        rig.now_s += 1.2
        client.send(*(hand(seq, seq / 60, 0.01 * seq) for seq in range(1, 57)))
        await client.synchronise()
        assert len(rig.samples) == 1
        assert rig.server.counters["hand_stale"] == 56
        client.send(hand(57, 1.2, 0.5))
        await rig.until(lambda: len(rig.samples) == 2)


async def test_a_flood_is_not_read() -> None:
    async with running() as rig, connected(rig) as client:
        await client.hello()
        client.send(*(hand(seq) for seq in range(1000)))
        client.writer.write_eof()
        await rig.until(lambda: bool(rig.closed))
        assert len(rig.samples) == 119
        assert rig.server.counters["hand_rate_limited"] == 1000 - 119


async def test_a_repeated_pose_is_said_to_be_one() -> None:
    async with running() as rig, connected(rig) as client:
        await client.hello()
        client.send(*(hand(seq, seq / 60, pose=seq // 2) for seq in range(6)))
        await rig.until(lambda: len(rig.samples) == 6)
        assert [sample.new_pose for sample in rig.samples] == [True, False, True, False, True, False]


async def test_ping_is_answered_with_the_server_time() -> None:
    async with running() as rig, connected(rig) as client:
        await client.hello()
        client.send({"type": "ping", "t": 12.5})
        assert await client.read() == {"type": "pong", "t": 12.5, "t_server": 1000.0}


async def test_the_newest_twin_goes_back_and_each_only_once() -> None:
    async with running() as rig, connected(rig) as client:
        rig.twin = {"type": "state", "seq": 1, "mode": "MANUAL", "path": []}
        await client.hello(rate_hz=120)
        assert await client.read() == {"type": "twin", "seq": 1, "mode": "MANUAL", "path": []}
        rig.twin = {"type": "state", "seq": 2, "mode": "HOLD", "path": []}
        assert (await client.read())["seq"] == 2


async def test_a_twin_line_never_exceeds_a_line() -> None:
    async with running() as rig, connected(rig) as client:
        rig.twin = {"type": "state", "seq": 1, "path": [[1234.5, 1234.5]] * 400}
        await client.hello()
        assert await client.read() == {"type": "twin", "seq": 1, "path": []}


async def test_a_client_that_reads_nothing_costs_a_bounded_buffer() -> None:
    async with running(max_unsent_bytes=4096) as rig, connected(rig) as client:
        await client.hello(rate_hz=120)
        client.writer.transport.pause_reading()  # type: ignore[attr-defined]
        (peer,) = rig.server.peers
        peer._transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)

        def another() -> TwinState:
            return {"type": "state", "seq": 1, "path": [], "reason": "x" * 3000}

        rig.server.twin_source = another
        while rig.server.counters["twin_dropped"] == 0:
            peer._send_twin()
        assert peer._transport.get_write_buffer_size() < 2 * 4096


async def test_a_silent_connection_is_freed() -> None:
    async with running(silence_timeout_s=0.05) as rig, connected(rig) as client:
        welcome = await client.hello()
        await rig.until(lambda: bool(rig.closed))
        assert rig.closed == [welcome["session"]]
        assert rig.server.counters["hand_silent"] == 1
        assert not rig.server.peers
        told = await client.read()
        assert (told["type"], told["code"]) == ("error", "silent")


async def test_the_end_of_a_connection_is_told_once() -> None:
    async with running() as rig:
        async with connected(rig) as client:
            welcome = await client.hello()
        await rig.until(lambda: bool(rig.closed))
        assert rig.closed == [welcome["session"]]
        assert not rig.server.peers


async def test_stopping_the_server_tells_and_closes_every_connection() -> None:
    rig = Rig(HandLinkConfig(port=0))
    started = asyncio.Event()
    async with asyncio.TaskGroup() as group:
        task = group.create_task(rig.server.run(started))
        await started.wait()
        async with connected(rig) as client:
            welcome = await client.hello()
            task.cancel()
            assert (await client.read())["code"] == "closing"
            assert await client.ended()
            assert rig.closed == [welcome["session"]]


async def test_nagle_is_off() -> None:
    async with running() as rig, connected(rig) as client:
        await client.hello()
        (peer,) = rig.server.peers
        assert peer._transport.get_extra_info("socket").getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


async def test_too_many_connections_are_refused() -> None:
    async with running(max_peers=1) as rig, connected(rig) as first:
        await first.hello()
        async with connected(rig) as second:
            assert (await second.read())["code"] == "too_many"
            assert await second.ended()
        await first.synchronise()


async def test_a_port_in_use_is_one_clear_line() -> None:
    async with running() as rig:
        port = rig.server.port
        with pytest.raises(
            ConfigError, match=rf"hand_link: cannot listen on 127.0.0.1 port {port} \(.*\); set"
        ):
            await Rig(HandLinkConfig(port=port)).server.run()


async def test_a_bug_in_a_callback_ends_the_server(caplog: pytest.LogCaptureFixture) -> None:
    rig = Rig(HandLinkConfig(port=0))

    def broken(_sample: HandSample) -> None:
        raise ZeroDivisionError

    rig.server.on_sample = broken
    started = asyncio.Event()

    async def one_hand_message() -> None:
        await started.wait()
        async with connected(rig) as client:
            await client.hello()
            client.send(hand(1))
            await client.ended()

    async with asyncio.TaskGroup() as group:
        group.create_task(one_hand_message())
        with pytest.raises(ZeroDivisionError):
            await rig.server.run(started)
    assert "data_received" in caplog.text


def test_settings_out_of_range_are_refused() -> None:
    for name, value in (("port", 70_000), ("hello_timeout_s", 0.0), ("max_peers", 0), ("lines_per_s", 10.0)):
        with pytest.raises(ValueError, match=name):
            HandLinkConfig(**{name: value})  # type: ignore[arg-type]


async def test_a_choice_of_scale_is_answered_and_a_refusal_keeps_the_connection() -> None:
    def choose(session: str, scale: str) -> None:
        if scale != "fine":
            raise RefusedError("clutch_closed", "open the clutch first")

    async with running() as rig, connected(rig) as client:
        rig.server.choose_scale = choose
        await client.hello()
        client.send({"type": "scale", "scale": "fine"}, {"type": "scale", "scale": "coarse"})
        assert await client.read() == {"type": "scale", "scale": "fine", "ok": True, "message": ""}
        refused = {"type": "scale", "scale": "coarse", "ok": False, "message": "open the clutch first"}
        assert await client.read() == refused
        await client.synchronise()
