"""The newest state for all clients at once: framed once, and written straight to each connection.

A state costs one system call a client and wakes no task, so that a hundred clients hold the control loop up
no longer than a hundred calls take. Who still has the last state on the way gets none: the newest wins.
"""

import asyncio
from collections.abc import AsyncIterator
from contextlib import ExitStack, asynccontextmanager

import orjson
from websockets.frames import Frame, Opcode

from mrnav_server.app import connections
from mrnav_server.app.connections import WriteFrame
from mrnav_server.app.rig_port import RigPort
from mrnav_server.core.wire_twin import twin_state


class TwinStates:
    """Sends each client the newest state, as often as it asked for.

    Args:
        rig: Where the states come from, and the calibration that they are told in.
    """

    def __init__(self, rig: RigPort) -> None:
        self._rig = rig
        self._clients: set[_Client] = set()
        self._listening = ExitStack()
        self._later: asyncio.TimerHandle | None = None

    @asynccontextmanager
    async def sent_to(self, write: WriteFrame, rate_hz: float) -> AsyncIterator[asyncio.TaskGroup]:
        """Serve a client as long as the group's tasks last; they end with TimeoutError if it reads nothing.

        Args:
            write: Of its connection.
            rate_hz: States a second at most.
        """
        loop = asyncio.get_running_loop()
        client = _Client(write, 1.0 / rate_hz, loop.time())
        if not self._clients:
            self._listening.enter_context(self._rig.states.told(self._send))
        self._clients.add(client)
        self._send()
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(client.lasts(), name="twin states")
                yield group
        finally:
            self._clients.discard(client)
            if not self._clients:
                self._listening.close()
                self._wake_at(None)

    def _send(self) -> None:
        state, version = self._rig.states.value, self._rig.states.version
        if state is None:
            return
        frame: bytes | None = None
        now_s = asyncio.get_running_loop().time()
        for client in self._clients:
            if client.version == version or client.due_s > now_s:
                continue
            if frame is None:
                text = orjson.dumps(twin_state(state, self._rig.calibration))
                frame = Frame(Opcode.TEXT, text).serialize(mask=False)
            client.take(frame, version, now_s)
        # A fresh state is better than one that has waited, but if none comes the last must not be missed.
        self._wake_at(min((c.overdue_s for c in self._clients if c.version != version), default=None))

    def _wake_at(self, due_s: float | None) -> None:
        if self._later is not None:
            self._later.cancel()
        loop = asyncio.get_running_loop()
        self._later = loop.call_at(due_s, self._send) if due_s is not None else None


class _Client:
    """When one client gets its next state."""

    def __init__(self, write: WriteFrame, period_s: float, now_s: float) -> None:
        self._write = write
        self._period_s = period_s
        self._stuck_since_s: float | None = None
        self.due_s = now_s
        self.version = 0
        self._reads_nothing = asyncio.Event()

    async def lasts(self) -> None:
        """Wait until the client reads nothing any more, and say so by TimeoutError."""
        await self._reads_nothing.wait()
        raise TimeoutError

    @property
    def overdue_s(self) -> float:
        """When it gets a state even if that is not fresh."""
        return self.due_s + self._period_s

    def take(self, frame: bytes, version: int, now_s: float) -> None:
        """Write a state, or try again a period later."""
        if self._write(frame):
            self.version, self._stuck_since_s = version, None
        elif self._stuck_since_s is None:
            self._stuck_since_s = now_s
        elif now_s - self._stuck_since_s > connections.SLOW_READER_S:
            self._reads_nothing.set()
        # From where it was due, so that states that come a little late cost no rate.
        self.due_s = max(self.due_s + self._period_s, now_s)
