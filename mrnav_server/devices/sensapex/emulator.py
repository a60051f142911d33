"""The emulated controller on the network: manipulators on one UDP socket, and a port for their knobs."""

import asyncio
import json
import math
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TextIO

from mrnav_server.core.errors import ConfigError, WireError
from mrnav_server.devices.sensapex.emulated_device import EmulatedDevice
from mrnav_server.devices.sensapex.emulated_outbox import Address, Outgoing
from mrnav_server.devices.sensapex.smcp1 import Kind, decode, encode

CONTROL_OFFSET = 1000
"""The control port is the device port plus this."""
_LONGEST_LINE = 4096


@dataclass(frozen=True, slots=True)
class Ports:
    """Where a running emulator is.

    Attributes:
        host: IPv4 address.
        port: UDP port of the devices.
        control_port: TCP port of the knobs.
    """

    host: str
    port: int
    control_port: int


class Emulator(asyncio.DatagramProtocol):
    """Emulated manipulators behind one socket.

    Args:
        devices: The manipulators; ids must differ.
        trace: Gets one JSON line for each datagram, if given.

    Raises:
        ConfigError: If two devices have one id.
    """

    def __init__(self, devices: Sequence[EmulatedDevice], trace: TextIO | None = None) -> None:
        self._devices = {device.id: device for device in devices}
        if len(self._devices) < len(devices):
            raise ConfigError("two emulated devices have the same id")
        self._trace = trace
        self._transport: asyncio.DatagramTransport | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._control: asyncio.Server | None = None
        self._turners: set[asyncio.StreamWriter] = set()

    async def open(self, host: str, port: int, control_port: int | None = None) -> Ports:
        """Begin to listen.

        Args:
            host: IPv4 address.
            port: UDP port; 0 takes a free one.
            control_port: TCP port of the knobs; 0 takes a free one, None that of the devices plus 1000.

        Raises:
            ConfigError: If a port cannot be had.
        """
        loop = asyncio.get_running_loop()
        try:
            transport, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=(host, port))
            self._transport = transport
            port = transport.get_extra_info("sockname")[1]
            wanted = port + CONTROL_OFFSET if control_port is None else control_port
            self._control = await asyncio.start_server(self._serve_knobs, host, wanted, limit=_LONGEST_LINE)
        except OSError as error:
            await self.close()
            raise ConfigError(
                f"the emulated controller cannot listen on {host}:{port}: {error}; is another one running?"
            ) from None
        return Ports(host, port, self._control.sockets[0].getsockname()[1])

    async def close(self) -> None:
        """Give the ports back. Safe to call twice."""
        if self._timer is not None:
            self._timer.cancel()
        if self._control is not None:
            self._control.close()
            # Whoever stays connected must not hold the end up.
            for writer in self._turners:
                writer.close()
            await self._control.wait_closed()
        if self._transport is not None:
            self._transport.close()

    def datagram_received(self, data: bytes, peer: Address) -> None:
        """Let the devices that a datagram is for answer it."""
        now_s = time.monotonic()
        try:
            message = decode(data)
        except WireError as error:
            self._note(now_s, "rx", peer, data, f"bad: {error}")
            return
        self._note(now_s, "rx", peer, data, _name(message.kind))
        for device in self._devices.values():
            if device.listens_to(message.receiver):
                self._send(device.receive(message, peer, now_s))
        self._schedule()

    def error_received(self, error: Exception) -> None:
        """Go on: a client that has gone is no fault of the controller."""

    def _schedule(self) -> None:
        now_s = time.monotonic()
        due_s = min((device.due_s(now_s) for device in self._devices.values()), default=math.inf)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if due_s < math.inf:
            self._timer = asyncio.get_running_loop().call_at(due_s, self._advance)

    def _advance(self) -> None:
        now_s = time.monotonic()
        for device in self._devices.values():
            self._send(device.advance(now_s))
        self._schedule()

    def _send(self, outgoing: Sequence[Outgoing]) -> None:
        loop = asyncio.get_running_loop()
        for item in outgoing:
            if item.due_s > time.monotonic():
                loop.call_at(item.due_s, self._send_now, item)
            else:
                self._send_now(item)

    def _send_now(self, item: Outgoing) -> None:
        data = encode(item.message)
        if self._transport is not None and not self._transport.is_closing():
            self._transport.sendto(data, item.peer)
            self._note(time.monotonic(), "tx", item.peer, data, _name(item.message.kind))

    def _note(self, t_s: float, way: str, peer: Address, data: bytes, kind: str) -> None:
        if self._trace is not None:
            line = {"t": t_s, "dir": way, "peer": f"{peer[0]}:{peer[1]}", "hex": data.hex(), "kind": kind}
            self._trace.write(json.dumps(line) + "\n")

    async def _serve_knobs(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._turners.add(writer)
        try:
            with suppress(ConnectionError, ValueError):
                while line := await reader.readline():
                    writer.write(json.dumps(self._turned(line)).encode() + b"\n")
                    await writer.drain()
        finally:
            self._turners.discard(writer)
            writer.close()

    def _turned(self, line: bytes) -> dict[str, object]:
        try:
            return self.turn(json.loads(line))
        except (ConfigError, ValueError, RecursionError) as error:
            return {"error": str(error)}

    def turn(self, ask: object) -> dict[str, object]:
        """Set knobs of one device and return how it is.

        Args:
            ask: ``{"device": 1, "reboot": true, KNOB: VALUE, ...}``, all of it optional: ``device`` is
                the first if left out; without a knob, nothing changes.

        Returns:
            ``device``, ``knobs`` (all of them), ``true_um``, ``velocity_um_per_s``, ``moving``,
            ``rebooting``, and ``t``, the monotonic time of it.

        Raises:
            ConfigError: If there is no such device or knob, or a value does not fit.
        """
        if not isinstance(ask, dict):
            raise ConfigError('a line is one JSON object, like {"device": 1, "mute": true}')
        knobs = dict(ask)
        number = knobs.pop("device", next(iter(self._devices)))
        reboot = knobs.pop("reboot", False)
        device = self._devices.get(number) if isinstance(number, int) else None
        if device is None:
            raise ConfigError(f"no device {number}; there are {', '.join(map(str, self._devices))}")
        if not isinstance(reboot, bool):
            raise ConfigError(f"reboot is true or false, not {reboot!r}")
        now_s = time.monotonic()
        self._send(device.advance(now_s))
        if knobs:
            device.set_faults(device.faults.changed(knobs), now_s)
        if reboot:
            device.reboot(now_s)
        self._schedule()
        return {
            "device": number,
            "knobs": device.faults.as_json(),
            **device.true_state(now_s),
            "t": now_s,
        }


def _name(kind: int) -> str:
    try:
        return Kind(kind).name
    except ValueError:
        return str(kind)
