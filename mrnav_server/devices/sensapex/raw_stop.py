"""STOP by a way of its own: one socket, one datagram, behind no lock, queue, thread or answer.

Standard library only: the process that stops a manipulator when the server has died imports nothing heavy.
"""

import ipaddress
import itertools
import secrets
import socket

from mrnav_server.devices.sensapex.smcp1 import COMMAND, Kind, Message, encode

_FIRST_SENDER, _SENDERS = 0x2D0, 0x2F
"""Among the ids of PCs, apart from those of the vendor's library (up to 0x29B) and of the drivers."""
_IDS = 0x10000


class RawStop:
    """Puts STOP datagrams on the wire.

    Every one is a new request from a sender of its own: a controller executes a request that it has seen
    before, by sender and number, no second time.

    Args:
        address: The controller's IPv4 address; a broadcast address reaches every controller.
        port: The controller's UDP port.
        device_id: The device's id in messages; ``smcp1.ALL_DEVICES`` stops all of them.
    """

    def __init__(self, address: str, port: int, device_id: int) -> None:
        self._target = (str(ipaddress.IPv4Address(address)), port)
        self.device_id = device_id
        self._sender = _FIRST_SENDER + secrets.randbelow(_SENDERS)
        self._ids = itertools.count(secrets.randbelow(_IDS))
        # Never connected: an ICMP answer to one datagram would make the kernel refuse the next one.
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)

    @property
    def target(self) -> tuple[str, int]:
        """Address and port of the controller."""
        return self._target

    def send(self) -> bool:
        """Send one STOP at once, from any thread; tells whether the network took it. Never raises."""
        message = Message(self.device_id, self._sender, next(self._ids) % _IDS, COMMAND, Kind.STOP)
        try:
            self._socket.sendto(encode(message), self._target)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Give the socket back; ``send`` does nothing from then on."""
        self._socket.close()
