"""STOP, repeated until the tip rests, by a process that has no driver: the supervisor, or a terminal.

Standard library only, like all that stops a manipulator when the server has died.
"""

import os
import socket
import time
from collections import deque
from contextlib import suppress

from mrnav_server.core.errors import WireError
from mrnav_server.devices.sensapex.raw_stop import RawStop
from mrnav_server.devices.sensapex.smcp1 import QUERY, Kind, Message, decode, encode

_SENDER = 0x2FE
_REPEAT_S = 0.01
_GIVE_UP_S = 2.0
_REST_S = 0.03
"""Two readings this far apart must agree: a tip that creeps is nearly still for a moment."""
_STILL_UM = 0.7


class Tip:
    """Asks the controller where the tip is, on a socket of its own.

    Args:
        target: The controller's address and port.
        device_id: The device's id in messages.
    """

    def __init__(self, target: tuple[str, int], device_id: int) -> None:
        self._target = target
        self._device_id = device_id
        self._number = os.getpid() & 0xFFFF
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def position_um(self, timeout_s: float) -> tuple[float, ...] | None:
        """Return the position, or None if no answer comes in time."""
        self._number = (self._number + 1) & 0xFFFF
        question = Message(self._device_id, _SENDER, self._number, QUERY, Kind.GET_POSITIONS)
        end_s = time.monotonic() + timeout_s
        with suppress(OSError):
            self._socket.sendto(encode(question), self._target)
            while (left_s := end_s - time.monotonic()) > 0.0:
                self._socket.settimeout(left_s)
                with suppress(WireError):
                    answer = decode(self._socket.recv(2048))
                    if answer.kind == Kind.GET_POSITIONS and answer.id == self._number and answer.values:
                        return tuple(value / 1000.0 for value in answer.values)
        return None


def stop_until_rest(stop: RawStop, tip: Tip) -> tuple[int, tuple[float, ...] | None, bool]:
    """Repeat a STOP, whose first was just sent, every 10 ms until the tip rests; at most for 2 s.

    Args:
        stop: Puts a STOP on the wire.
        tip: Where the tip is.

    Returns:
        The number of STOPs with the first, the last position in µm if any came, and whether the tip rests.
    """
    began_s = time.monotonic()
    readings: deque[tuple[float, tuple[float, ...]]] = deque(maxlen=16)
    stops = 1
    while True:
        asked_s = time.monotonic()
        at_um = tip.position_um(_REPEAT_S)
        if at_um is not None:
            if any(asked_s - s >= _REST_S and _same(at_um, before_um) for s, before_um in readings):
                return stops, at_um, True
            readings.append((asked_s, at_um))
        time.sleep(max(0.0, asked_s + _REPEAT_S - time.monotonic()))
        if time.monotonic() - began_s > _GIVE_UP_S:
            return stops, readings[-1][1] if readings else None, False
        stop.send()
        stops += 1


def _same(a_um: tuple[float, ...], b_um: tuple[float, ...]) -> bool:
    return len(a_um) == len(b_um) and all(abs(a - b) <= _STILL_UM for a, b in zip(a_um, b_um, strict=True))
