"""The hand link: a headset sends the fingertip over TCP and gets the twin back (docs/protocol.md).

A sample is handed on in the very call that received its bytes, so that the control loop can step on it.
"""

import asyncio
import secrets
import socket
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import cast

import orjson

from mrnav_server.core.errors import ConfigError, RefusedError, WireError
from mrnav_server.core.hand_stream import HandSample, HandStream
from mrnav_server.core.peer_limits import Strikes, TokenBucket
from mrnav_server.core.wire import MAX_LINE_BYTES, NumberError
from mrnav_server.core.wire_hand import (
    Hello,
    Ping,
    ScaleChoice,
    error_line,
    lease_line,
    parse_hello,
    parse_message,
    pong_line,
    scale_line,
    welcome_line,
)

TwinState = Mapping[str, object]
TellLease = Callable[[bool, str, str], None]
_CLOSING = "the server ends, or goes over to another vessel: connect anew"
_LINGER_S = 1.0


@dataclass(frozen=True, slots=True)
class HandLinkConfig:
    """How the hand link listens.

    Attributes:
        host: Address to listen on; the default is this computer alone.
        port: TCP port, 0 for any free one.
        hello_timeout_s: A client that has not said hello by then is dropped, 0.01 to 10 s.
        silence_timeout_s: A client that sends nothing for this long is dropped, 0.01 to 60 s.
        max_peers: Connections at once, 1 to 1000.
        lines_per_s: Lines a second that one client may send, 60 to 1000; more are not read.
        max_unsent_bytes: Twin messages are left out while this much waits for a slow client.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    host: str = "127.0.0.1"
    port: int = 9000
    hello_timeout_s: float = 2.0
    silence_timeout_s: float = 5.0
    max_peers: int = 256
    lines_per_s: float = 120.0
    max_unsent_bytes: int = 65_536

    def __post_init__(self) -> None:
        for name, low, high in (
            ("port", 0, 65_535),
            ("hello_timeout_s", 0.01, 10.0),
            ("silence_timeout_s", 0.01, 60.0),
            ("max_peers", 1, 1000),
            ("lines_per_s", 60.0, 1000.0),
            ("max_unsent_bytes", MAX_LINE_BYTES, 1 << 24),
        ):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} must lie between {low} and {high}")


class HandLinkServer:
    """Listens for headsets. Everything that it calls must not wait.

    Args:
        config: How it listens.
        authorize: Returns a token's role ("viewer", "operator" or "admin"), or None for an unknown token.
        acquire: Makes a new session the rig's hand, or raises RefusedError; keeps the function that tells it
            later, with a code and plain words, that it lost the seat or has it again.
        on_sample: Takes an accepted sample, in the call that received it.
        on_closed: Told the session that ended.
        twin_source: Returns the newest twin state, None before the first.
        clock: Monotonic time in seconds.
        on_bad_numbers: Told the session when three messages within 1 s had numbers that measure nothing.
        limits: The motion limits, for the welcome; units in the names.
        transform: How the server maps the hand, for the welcome.
        choose_scale: Told the session and the scale that it wants; raises RefusedError. None: one scale only.
        session_name: Returns the session under which everybody sees a connection, of its secret and its role.
    """

    def __init__(
        self,
        config: HandLinkConfig,
        authorize: Callable[[str], str | None],
        acquire: Callable[[str, Hello, TellLease], None],
        on_sample: Callable[[HandSample], None],
        on_closed: Callable[[str], None],
        twin_source: Callable[[], TwinState | None],
        clock: Callable[[], float],
        *,
        on_bad_numbers: Callable[[str], None],
        limits: Mapping[str, float],
        transform: Mapping[str, object],
        choose_scale: Callable[[str, str], None] | None = None,
        session_name: Callable[[str, str], str] = lambda secret, _: secret,
    ) -> None:
        self.config = config
        self.authorize = authorize
        self.acquire = acquire
        self.on_sample = on_sample
        self.on_closed = on_closed
        self.twin_source = twin_source
        self.clock = clock
        self.on_bad_numbers = on_bad_numbers
        self.limits = limits
        self.transform = transform
        self.choose_scale = choose_scale
        self.session_name = session_name
        self.counters: Counter[str] = Counter()
        self.peers: set[_Peer] = set()
        self._port = config.port
        self._failure: asyncio.Future[None] | None = None

    @property
    def port(self) -> int:
        """The port it listens on; the real one once it runs."""
        return self._port

    async def run(self, started: asyncio.Event | None = None) -> None:
        """Listen until cancelled; then every connection is told and closed.

        Args:
            started: Set once clients can connect.

        Raises:
            ConfigError: If the address cannot be had.
            Exception: Whatever a callback raised: that is a bug, and nothing is served on top of it.
        """
        loop = asyncio.get_running_loop()
        self._failure = loop.create_future()
        host, port = self.config.host, self.config.port
        try:
            listener = await loop.create_server(lambda: _Peer(self), host, port)
        except OSError as error:
            reason = error.strerror or str(error)
            raise ConfigError(
                f"hand_link: cannot listen on {host} port {port} ({reason}); "
                "set server.host or server.hand_port"
            ) from None
        self._port = listener.sockets[0].getsockname()[1]
        try:
            if started is not None:
                started.set()
            await self._failure
        finally:
            listener.close()
            for peer in tuple(self.peers):
                peer.end()
            # One turn of the loop: aborted connections report that they are closed.
            await asyncio.sleep(0)

    @contextmanager
    def bugs_end_it(self) -> Iterator[None]:
        """Let an error that escapes from a callback end ``run``; the event loop alone would only log it."""
        try:
            yield
        except Exception as error:
            if self._failure is not None and not self._failure.done():
                self._failure.set_exception(error)
            raise


class _Peer(asyncio.Protocol):
    """One connection: hello, then hand messages in and twin messages out."""

    def __init__(self, server: HandLinkServer) -> None:
        self._server = server
        self._loop = asyncio.get_running_loop()
        self._unread = b""
        self._hello: Hello | None = None
        self._operator = False
        self._session = ""
        self._stream = HandStream("", server.counters)
        self._bucket = TokenBucket(server.config.lines_per_s, burst=server.config.lines_per_s)
        self._bad_numbers = Strikes()
        self._heard_s = self._loop.time()
        self._twin_due_s = 0.0
        self._twin_sent: TwinState | None = None
        self._timers: dict[str, asyncio.TimerHandle] = {}

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        sock = self._transport.get_extra_info("socket")
        # Without it a 60 Hz stream with replies waits for acknowledgements, up to 40 ms.
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._server.peers.add(self)
        if len(self._server.peers) > self._server.config.max_peers:
            self._drop("too_many", "this server has all the connections that it takes")
            return
        self._at("deadline", self._loop.time() + self._server.config.hello_timeout_s, self._hello_missed)

    def data_received(self, data: bytes) -> None:
        if self._transport.is_closing():
            return
        self._heard_s = self._loop.time()
        *lines, self._unread = (self._unread + data).split(b"\n")
        with self._server.bugs_end_it():
            try:
                self._on_lines(lines)
            except WireError as error:
                self._server.counters["hand_malformed"] += 1
                self._drop(error.code, str(error))

    def connection_lost(self, exc: Exception | None) -> None:
        self._server.peers.discard(self)
        for timer in self._timers.values():
            timer.cancel()
        if self._hello is None:
            return
        self._hello = None
        with self._server.bugs_end_it():
            self._server.on_closed(self._session)

    def end(self) -> None:
        """Tell the peer that the server ends, and close now; what it did not read in time is lost."""
        if not self._transport.is_closing():
            self._transport.write(error_line("closing", _CLOSING))
        self._transport.abort()

    def _on_lines(self, lines: list[bytes]) -> None:
        for line in lines:
            self._on_line(line)
            if self._transport.is_closing():
                return
        if len(self._unread) > MAX_LINE_BYTES:
            raise WireError("line_too_long", f"a line has at most {MAX_LINE_BYTES} bytes")

    def _on_line(self, line: bytes) -> None:
        now_s = self._server.clock()
        if not self._bucket.take(now_s):
            self._server.counters["hand_rate_limited"] += 1
        elif self._hello is None:
            self._welcome(parse_hello(line))
        else:
            try:
                self._on_message(line, self._hello, now_s)
            except NumberError:
                self._server.counters["non_finite"] += 1
                if self._bad_numbers.strike(now_s):
                    self._server.on_bad_numbers(self._session)

    def _welcome(self, hello: Hello) -> None:
        role = self._server.authorize(hello.token)
        if role is None:
            raise WireError("bad_token", "the token is not known here; copy it from the server's start page")
        if hello.role == "operator" and role == "viewer":
            raise WireError("forbidden", "this token only lets you watch: say role viewer, or use another")
        self._hello = hello
        self._operator = hello.role == "operator"
        secret = secrets.token_hex(16)
        self._session = self._server.session_name(secret, role)
        self._stream = HandStream(self._session, self._server.counters)
        refused = self._sit_down(hello) if self._operator else None
        lease = self._operator and refused is None
        self._transport.write(welcome_line(secret, lease, self._server.limits, self._server.transform))
        if refused is not None:
            self._tell_lease(False, refused.code, str(refused))
        self._twin_due_s = self._loop.time()
        self._watch_silence()
        self._send_twin()

    def _sit_down(self, hello: Hello) -> RefusedError | None:
        try:
            self._server.acquire(self._session, hello, self._tell_lease)
        except RefusedError as refused:
            return refused
        return None

    def _tell_lease(self, lease: bool, code: str, message: str) -> None:
        if not self._transport.is_closing():
            self._transport.write(lease_line(lease, code, message))

    def _on_message(self, line: bytes, hello: Hello, now_s: float) -> None:
        message = parse_message(line, hello.frame)
        if isinstance(message, Ping):
            if self._has_room():
                self._transport.write(pong_line(message.t_s, now_s))
            return
        if not self._operator:
            raise WireError("forbidden", "a viewer sends no hand messages")
        if isinstance(message, ScaleChoice):
            self._choose(message.scale)
            return
        sample = self._stream.take(message, now_s)
        if sample is not None:
            self._server.on_sample(sample)

    def _choose(self, scale: str) -> None:
        choose, refusal = self._server.choose_scale, ""
        try:
            if choose is None:
                raise RefusedError("one_scale", "this server has one scale only")
            choose(self._session, scale)
        except RefusedError as refused:
            refusal = str(refused)
        if self._has_room():
            self._transport.write(scale_line(scale, refusal))

    def _send_twin(self) -> None:
        if self._hello is None or self._transport.is_closing():
            return
        with self._server.bugs_end_it():
            state = self._server.twin_source()
            if state is not None and state is not self._twin_sent and self._has_room():
                self._twin_sent = state
                self._transport.write(_twin_line(state))
        period_s = 1.0 / self._hello.rate_hz
        self._twin_due_s = max(self._twin_due_s + period_s, self._loop.time())
        self._at("twin", self._twin_due_s, self._send_twin)

    def _has_room(self) -> bool:
        """Tell whether the client keeps up; a message that it has no room for is left out and counted."""
        room = self._transport.get_write_buffer_size() <= self._server.config.max_unsent_bytes
        if not room:
            self._server.counters["twin_dropped"] += 1
        return room

    def _hello_missed(self) -> None:
        self._drop("no_hello", f"no hello within {self._server.config.hello_timeout_s:g} s")

    def _watch_silence(self) -> None:
        deadline_s = self._heard_s + self._server.config.silence_timeout_s
        if self._loop.time() < deadline_s:
            self._at("deadline", deadline_s, self._watch_silence)
        else:
            self._server.counters["hand_silent"] += 1
            # Perhaps nobody is left to read it; a headset that slept does.
            self._drop(
                "silent", f"nothing came for {self._server.config.silence_timeout_s:g} s: connect anew"
            )

    def _drop(self, code: str, message: str) -> None:
        """Tell the peer why, and close."""
        if self._transport.is_closing():
            return
        self._unread = b""
        self._transport.write(error_line(code, message))
        self._transport.close()
        # A peer that reads nothing would keep a closing connection for ever.
        self._at("deadline", self._loop.time() + _LINGER_S, self._transport.abort)

    def _at(self, name: str, when_s: float, call: Callable[[], None]) -> None:
        if name in self._timers:
            self._timers[name].cancel()
        self._timers[name] = self._loop.call_at(when_s, call)


def _twin_line(state: TwinState) -> bytes:
    line = orjson.dumps({**state, "type": "twin"}, option=orjson.OPT_APPEND_NEWLINE)
    if len(line) <= MAX_LINE_BYTES:
        return line
    return orjson.dumps({**state, "type": "twin", "path": []}, option=orjson.OPT_APPEND_NEWLINE)
