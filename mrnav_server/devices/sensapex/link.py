"""What is asked of one device and what it answers: numbers, retries, newest wins. Pure; is told the time."""

import itertools
from collections import Counter
from dataclasses import dataclass

from mrnav_server.core.errors import WireError
from mrnav_server.devices.sensapex.goto import Goto
from mrnav_server.devices.sensapex.loss import LossRate
from mrnav_server.devices.sensapex.smcp1 import (
    ALL_PCS,
    MOVE,
    QUERY,
    Block,
    Kind,
    Message,
    Option,
    decode,
    encode,
)

TRIES = 3
"""The vendor's library gives up after as many."""
_ALL_UNITS = 0x01FF
_BOTH = 0x03FF
_KEEP_S = 1.0
"""Answers that arrive later than this belong to nothing any more."""


@dataclass(slots=True)
class Request:
    """One request under way.

    Attributes:
        message: What is asked.
        first_s: When it was sent first.
        last_s: When it was sent last.
        tries_left: How often it may be sent again.
        wait_s: How long each try waits.
    """

    message: Message
    first_s: float
    last_s: float
    tries_left: int
    wait_s: float


@dataclass(frozen=True, slots=True)
class Heard:
    """One message of the device.

    Attributes:
        message: What it said.
        request: What this answers; None for a notification.
        reply: Datagram that it wants to be sent back; empty for none.
    """

    message: Message
    request: Request | None
    reply: bytes = b""


class Link:
    """The exchange with one device.

    A query is repeated under its number until its data arrive, at most three times in all. Of all moves only
    the newest is ever repeated.

    Counted in ``counters``: ``sent``, ``repeated``, ``unanswered``, ``late`` (answers to nothing),
    ``reordered`` (moves that changed places on the way), ``foreign`` (of another device, or for another PC),
    ``garbage``.

    Args:
        device_id: The device's id in messages.
        own_id: This side's id, one of a PC.
        first_id: Number of the first request; random, so that a new run repeats none of the last one.
        timeout_s: How long each try waits.
    """

    def __init__(self, device_id: int, own_id: int, first_id: int, timeout_s: float) -> None:
        self.counters: Counter[str] = Counter()
        self.loss = LossRate()
        self._device_id = device_id
        self._own_id = own_id
        self._ids = itertools.count(first_id)
        self._timeout_s = timeout_s
        self._queries: dict[int, Request] = {}
        self._moves: dict[int, Request] = {}
        self._outrun: dict[int, Request] = {}
        self._newest: Goto | None = None

    def ask(self, kind: Kind, values: tuple[int, ...], now_s: float) -> bytes:
        """Return the datagram of a query."""
        blocks = (Block(values),) if values else ()
        message = Message(self._device_id, self._own_id, self._next_id(), QUERY, kind, blocks)
        return self._send(self._queries, Request(message, now_s, now_s, TRIES - 1, self._timeout_s))

    def poll(self, now_s: float) -> bytes:
        """Return the datagram of a question for the position; the next one stands in for a repetition."""
        message = Message(self._device_id, self._own_id, self._next_id(), QUERY, Kind.GET_POSITIONS)
        return self._send(self._queries, Request(message, now_s, now_s, 0, TRIES * self._timeout_s))

    @property
    def waiting(self) -> int:
        """How many queries wait for their answer."""
        return len(self._queries)

    def waited_s(self, now_s: float) -> float:
        """Return for how long the oldest query has waited; 0 while none waits."""
        return now_s - min((query.first_s for query in self._queries.values()), default=now_s)

    def goto(self, move: Goto, now_s: float) -> bytes:
        """Return the datagram of a move; it replaces every move before it."""
        self._newest = move
        message = Message(self._device_id, self._own_id, self._next_id(), MOVE, Kind.GOTO, move.blocks)
        return self._send(self._moves, Request(message, now_s, now_s, TRIES - 1, self._timeout_s))

    def drop_moves(self) -> None:
        """Forget every move: none is repeated, and none is missed."""
        self._newest = None
        self._moves.clear()
        self._outrun.clear()

    def unacknowledged_s(self, now_s: float) -> float:
        """Return for how long no move was acknowledged while one waits for it; 0 while none waits."""
        return now_s - min((move.first_s for move in self._moves.values()), default=now_s)

    def due(self, now_s: float) -> list[bytes]:
        """Return the datagrams to send again now, and give up what was tried often enough."""
        again = []
        for number, query in list(self._queries.items()):
            if now_s - query.last_s < query.wait_s:
                continue
            if query.tries_left:
                again.append(self._repeat(query, now_s))
            else:
                del self._queries[number]
                self.counters["unanswered"] += 1
                self.loss.on_loss(now_s)
        newest = next(reversed(self._moves.values()), None)
        if newest and newest.tries_left and now_s - newest.last_s >= self._timeout_s:
            again.append(self._repeat(newest, now_s))
        for number, move in list(self._outrun.items()):
            if now_s - move.last_s > _KEEP_S:
                del self._outrun[number]
        return again

    def receive(self, data: bytes, now_s: float) -> Heard | None:
        """Take a datagram; None if it says nothing to this side."""
        try:
            message = decode(data)
        except WireError:
            self.counters["garbage"] += 1
            return None
        ours = message.receiver in (self._own_id, _ALL_UNITS, ALL_PCS, _BOTH)
        if message.sender != self._device_id or not ours:
            self.counters["foreign"] += 1
            return None
        if message.options & Option.NOTIFY:
            return Heard(message, None, self._acknowledgement(message))
        if message.options & Option.REQ:
            self.counters["foreign"] += 1
            return None
        if message.options & Option.ACK:
            return self._acknowledged(message, now_s)
        request = self._queries.get(message.id)
        if request is None or request.message.kind != message.kind:
            self.counters["late"] += 1
            return None
        del self._queries[message.id]
        return Heard(message, request)

    def _acknowledged(self, message: Message, now_s: float) -> Heard | None:
        """Note that a request was understood; a move that a newer one had outrun is set right by it."""
        outrun = self._outrun.pop(message.id, None)
        if outrun is not None and self._newest is not None:
            # The device took an older move after the newest: datagrams changed places on the way.
            self.counters["reordered"] += 1
            return Heard(message, outrun, self.goto(self._newest, now_s))
        move = self._moves.get(message.id)
        if move is None or message.kind != Kind.GOTO:
            if message.id not in self._queries:
                self.counters["late"] += 1
            return None
        for number in list(self._moves):
            older = self._moves.pop(number)
            if older is move:
                break
            self._outrun[number] = older
        return Heard(message, move)

    def _acknowledgement(self, message: Message) -> bytes:
        if not message.options & Option.REQ_ACK or message.receiver == _BOTH:
            return b""
        return encode(Message(message.sender, self._own_id, message.id, Option.ACK, message.kind))

    def _send(self, pending: dict[int, Request], request: Request) -> bytes:
        pending[request.message.id] = request
        self.counters["sent"] += 1
        self.loss.on_request(request.first_s)
        return encode(request.message)

    def _repeat(self, request: Request, now_s: float) -> bytes:
        request.last_s = now_s
        request.tries_left -= 1
        self.counters["repeated"] += 1
        self.loss.on_loss(now_s)
        self.loss.on_request(now_s)
        return encode(request.message)

    def _next_id(self) -> int:
        return next(self._ids) % 0xFFFF + 1
