"""A UDP socket in the event loop: what is sent leaves at once, what arrives goes to a callback."""

import asyncio
import socket
from collections.abc import Callable

Address = tuple[str, int]


class Endpoint(asyncio.DatagramProtocol):
    """Sends and receives datagrams from a port of its own.

    Args:
        on_datagram: Called with every datagram and the address that it came from.
    """

    def __init__(self, on_datagram: Callable[[bytes, str], None]) -> None:
        self._on_datagram = on_datagram
        self._transport: asyncio.BaseTransport | None = None
        # Never connected: an ICMP answer to one datagram would make the kernel refuse the next one.
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self._socket.bind(("", 0))

    async def open(self) -> None:
        """Start to receive."""
        loop = asyncio.get_running_loop()
        self._transport, _ = await loop.create_datagram_endpoint(lambda: self, sock=self._socket)

    def send(self, data: bytes, to: Address) -> bool:
        """Put a datagram on the wire before returning; tells whether the network took it. Never waits."""
        try:
            self._socket.sendto(data, to)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Give the socket back."""
        if self._transport is not None:
            self._transport.close()
        else:
            self._socket.close()

    def datagram_received(self, data: bytes, addr: tuple[str | int, ...]) -> None:
        """Pass a datagram on."""
        self._on_datagram(data, str(addr[0]))
