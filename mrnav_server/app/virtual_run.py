"""A simulated rig, its server and its clients in one process and one virtual time, over real sockets."""

import asyncio
import socket
from collections.abc import Callable
from typing import TypeVar

from mrnav_server.app.ready import Ready
from mrnav_server.app.reporting import Report
from mrnav_server.app.rig import Rig
from mrnav_server.app.serve import RigServer, bound_socket, ready_for, uvicorn_config
from mrnav_server.app.server import create_app
from mrnav_server.core.errors import ConfigError
from mrnav_server.settings import Settings
from mrnav_server.sim.virtual_time import VirtualTimeLoop

_T = TypeVar("_T")

Play = Callable[[Ready, VirtualTimeLoop], _T]
"""What the clients do, as blocking code: it runs as a job of the loop and waits on ``loop.waiting``."""


def run_in_virtual_time(settings: Settings, report: Report, play: Play[_T]) -> _T:
    """Run a rig and its server as long as its clients play; return what they return.

    Everything is as in real time, but time passes as fast as the machine computes, and computing takes none.

    Args:
        settings: A rig that is simulated altogether. Tokens that are missing are made.
        report: Makes a finished trial's report; it must start no process.
        play: What the clients do.

    Raises:
        ConfigError: If a part of the rig is real, for real things take real time.
    """
    require_simulated(settings)
    settings = settings.with_tokens()
    with bound_socket(settings.server.host, settings.server.port) as listener:
        loop = VirtualTimeLoop()
        with asyncio.Runner(loop_factory=lambda: loop) as runner:
            try:
                return runner.run(_play(settings, report, play, listener, loop))
            except BaseExceptionGroup as group:
                raise _first(group) from None


def require_simulated(settings: Settings) -> None:
    """Refuse what cannot live in virtual time.

    Raises:
        ConfigError: Naming the setting.
    """
    for name, driver in (
        ("manipulator.driver", settings.manipulator.driver),
        ("rig.camera", settings.rig.camera),
    ):
        if driver != "simulated":
            raise ConfigError(
                f"{name} is {driver!r}, which takes real time: virtual time needs the whole rig simulated"
            )
    if settings.server.tls_certificate is not None:
        raise ConfigError("server.tls_certificate is set: virtual time is for clients of this process alone")


async def _play(
    settings: Settings, report: Report, play: Play[_T], listener: socket.socket, loop: VirtualTimeLoop
) -> _T:
    rig = Rig(settings, loop.time, loop.waiting.sleep, report)
    app = create_app(rig, settings)
    server = RigServer(uvicorn_config(app, settings.server))
    started = asyncio.Event()
    try:
        async with asyncio.TaskGroup() as process:
            moving = process.create_task(rig.run(started), name="rig")
            await started.wait()
            await rig.states.newer_than(0)
            listener.listen()
            web = process.create_task(server.serve([listener]), name="web")
            ready = ready_for(settings.server, listener, rig.hand_port)
            result = await loop.run_in_executor(None, play, ready, loop)
            # What moves stops first; clients still see how it ends.
            moving.cancel()
            await asyncio.wait({moving})
            server.should_exit = True
            await web
    finally:
        app.state.context.encoder.close()
    return result


def _first(group: BaseExceptionGroup[BaseException]) -> BaseException:
    """Return the error that ended a run: the first that was raised."""
    first = group.exceptions[0]
    return _first(first) if isinstance(first, BaseExceptionGroup) else first
