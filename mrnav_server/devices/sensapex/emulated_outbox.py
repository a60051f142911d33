"""What an emulated manipulator sends: to whom, when, and whether at all."""

import math
import random
from collections.abc import Iterable
from dataclasses import dataclass

from mrnav_server.devices.sensapex.emulator_faults import Faults
from mrnav_server.devices.sensapex.smcp1 import ALL_PCS, Block, Kind, Message, Option

Address = tuple[str, int]
"""IPv4 address and UDP port of a client."""

_CLIENT_S = 30.0
_MOST_CLIENTS = 16
_REPEATS_S = 1.0
_APART_S = 1e-6


@dataclass(frozen=True, slots=True)
class Outgoing:
    """A datagram to be sent.

    Attributes:
        message: What it says.
        peer: To whom.
        due_s: Not before this time.
    """

    message: Message
    peer: Address
    due_s: float


class Outbox:
    """Addresses and delays what one device sends.

    Notifications go to every client that has asked for something in the last 30 s: where real devices
    broadcast, loopback cannot.

    Args:
        seed: Seed of the jitter.
    """

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self._clients: dict[Address, float] = {}
        self._last_due_s = -math.inf

    def meet(self, peer: Address, now_s: float) -> None:
        """Remember a client."""
        self._clients.pop(peer, None)
        self._clients[peer] = now_s
        fresh = [(client, at_s) for client, at_s in self._clients.items() if now_s - at_s < _CLIENT_S]
        self._clients = dict(fresh[-_MOST_CLIENTS:])

    def to_all(self, message: Message, faults: Faults, now_s: float) -> list[Outgoing]:
        """Return a message to every client."""
        return [item for peer in self._clients for item in self.to(peer, (message,), faults, now_s)]

    def to(self, peer: Address, messages: Iterable[Message], faults: Faults, now_s: float) -> list[Outgoing]:
        """Return messages to one client, in order, late as the faults want it; none if they mute it."""
        if faults.mute:
            return []
        outgoing = []
        for message in messages:
            delay_ms = faults.latency_ms + self._random.random() * faults.jitter_ms
            # A cable keeps the order: what is sent later arrives neither earlier nor at the same time.
            free_s = self._last_due_s + _APART_S if self._last_due_s > now_s else now_s
            self._last_due_s = max(free_s, now_s + delay_ms / 1000)
            outgoing.append(Outgoing(message, peer, self._last_due_s))
        return outgoing


class Notes:
    """Numbers a device's notifications.

    Args:
        sender: The device's id on the wire.
    """

    def __init__(self, sender: int) -> None:
        self._sender = sender
        self._number = 0

    def note(self, kind: Kind, *values: int) -> Message:
        """Return a notification for all clients."""
        # Clients drop a completion whose number is 0 or that of the one before.
        self._number = self._number % 0xFFFF + 1
        blocks = (Block(values),) if values else ()
        return Message(ALL_PCS, self._sender, self._number, Option.NOTIFY | Option.REQ, kind, blocks)


class Answered:
    """Requests of the last second and their answers: a retransmission is not carried out again.

    A retransmission is the same message from the same socket; a client that starts anew may well
    count from the number that it had before.
    """

    def __init__(self) -> None:
        self._known: dict[tuple[Address, int, int], tuple[float, Message, tuple[Message, ...]]] = {}

    def find(self, request: Message, peer: Address, now_s: float) -> tuple[Message, ...] | None:
        """Return the answers that a request has had; None if it is new."""
        known = self._known.get((peer, request.sender, request.id))
        if known is None or known[1] != request or now_s - known[0] >= _REPEATS_S:
            return None
        return known[2]

    def keep(self, request: Message, peer: Address, answers: tuple[Message, ...], now_s: float) -> None:
        """Remember what a request was answered."""
        self._known.pop((peer, request.sender, request.id), None)
        self._known[peer, request.sender, request.id] = (now_s, request, answers)
        while now_s - next(iter(self._known.values()))[0] >= _REPEATS_S:
            del self._known[next(iter(self._known))]

    def forget(self) -> None:
        """Forget all of them."""
        self._known.clear()
