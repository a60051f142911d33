"""The process: signals, the rig and the web server, each stopped in its turn."""

import asyncio
import gc
import logging
import os
import signal
import socket
import ssl
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from pathlib import Path
from types import FrameType

import uvicorn
from fastapi import FastAPI

from mrnav_server.app import connections
from mrnav_server.app.context import AppContext
from mrnav_server.app.ready import Ready, announced, own_file
from mrnav_server.app.rig_port import RigPort
from mrnav_server.app.server import create_app
from mrnav_server.app.study_progress import LedStudy
from mrnav_server.app.vessel_desk import BuildRig
from mrnav_server.core.errors import ConfigError
from mrnav_server.loops.priority import prefer_this_process
from mrnav_server.settings import ServerConfig, Settings

_SWITCH_INTERVAL_S = 0.0005
_SLOW_TO_LOAD = "mrnav_server.autonomy.torchscript"
_GRACE_S = 2
_TRIES, _AGAIN_S = 5, 1.0
"""For devices that the rig before has just given back: some take a moment until they can be opened again."""
_log = logging.getLogger(__name__)


class RigServer(uvicorn.Server):
    """uvicorn without its hands on the signals: the process decides what stops first."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave signals alone."""
        yield


def serve(
    build_rig: BuildRig,
    settings: Settings,
    announce: Callable[[Ready], None],
    ready_file: Path | None = None,
    study: LedStudy | None = None,
) -> None:
    """Run a rig and its server until SIGTERM or SIGINT.

    Args:
        build_rig: Builds the rig; touches no device.
        settings: Tokens that are missing are made.
        announce: Told once clients may come.
        ready_file: Gets what ``announce`` is told, as a line of JSON, readable by this user alone.
        study: What to lead the experimenter through; None without a study.

    Raises:
        ConfigError: If a port is taken, the certificate cannot be used, or the rig cannot be built or opened.
    """
    # Threads that compute (JPEG, tracking) give the interpreter back in time for a 10 ms control tick.
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    preferred = prefer_this_process()
    settings = settings.with_tokens()
    _check_certificate(settings.server)
    if ready_file is not None:
        ready_file.unlink(missing_ok=True)
    with bound_socket(settings.server.host, settings.server.port) as listener:
        # The slowest to load does so while the rig is built.
        threading.Thread(target=import_module, args=(_SLOW_TO_LOAD,), name="loading", daemon=True).start()
        # What loads is no garbage.
        gc.disable()
        try:
            first = build_rig(settings)
            asyncio.run(_rigs(first, build_rig, listener, announce, ready_file, study, preferred=preferred))
        except BaseExceptionGroup as group:
            config = group.subgroup(ConfigError)
            if config is None:
                raise
            raise _leaf(config) from None
        finally:
            gc.enable()


async def _rigs(
    rig: RigPort,
    build_rig: BuildRig,
    listener: socket.socket,
    announce: Callable[[Ready], None],
    ready_file: Path | None,
    study: LedStudy | None,
    *,
    preferred: bool,
) -> None:
    """Run a rig until a signal ends it, or until the vessel is changed: then its successor, and so on."""

    def tell(ready: Ready) -> None:
        try:
            files.enter_context(announced(ready, own_file()))
        except OSError as error:
            _log.warning("`mrnav stop` will not find this server: %s", error)
        if ready_file is not None:
            files.enter_context(announced(ready, ready_file))
        announce(ready)
        if not preferred:
            _log.info("the system gives the rig no preference over other programs: keep this machine idle")

    with _stop_signals() as stop, ExitStack() as files:
        tries = 1
        while True:
            app = create_app(rig, rig.settings, study, build_rig)
            try:
                await _process(rig, app, listener, tell, stop)
            except BaseExceptionGroup as group:
                config, others = group.split(ConfigError)
                tries -= 1
                if config is None or others is not None or tries == 0 or stop.is_set():
                    raise
                _log.warning("%s; trying again", _leaf(config))
                await asyncio.sleep(_AGAIN_S)
                rig = build_rig(rig.settings)
                continue
            successor = app.state.context.vessels.successor
            if successor is None or stop.is_set():
                break
            tell, rig, tries = _told_before, successor, _TRIES
            # The rig before leaves a hundred megabytes; a pause holds up nothing now.
            del app
            gc.unfreeze()
            gc.collect()


def _told_before(ready: Ready) -> None:
    """Say nothing: address and tokens are those of the rig before."""
    _log.info("going on at port %d with another vessel", ready.port)


async def _process(
    rig: RigPort,
    app: FastAPI,
    listener: socket.socket,
    tell: Callable[[Ready], None],
    stop: asyncio.Event,
) -> None:
    """Run a rig and its server until a signal, or a change of the vessel."""
    parts: AppContext = app.state.context
    server = RigServer(uvicorn_config(app, rig.settings.server))
    started = asyncio.Event()

    async def run_rig() -> None:
        await rig.run(started)
        raise RuntimeError("the rig ended by itself")

    async def run_web() -> None:
        await started.wait()
        # A collector's full round over all that is loaded takes 0.2 s, for which no control loop can wait.
        gc.freeze()
        gc.enable()
        listener.listen()
        tell(ready_for(rig.settings.server, listener, rig.hand_port))
        # The server closes what it is given; who comes between two rigs waits in the queue of the original.
        with listener.dup() as door:
            await server.serve([door])

    try:
        async with asyncio.TaskGroup() as process:
            moving = process.create_task(run_rig(), name="rig")
            web = process.create_task(run_web(), name="web")
            reasons = [process.create_task(event.wait()) for event in (stop, parts.vessels.changed)]
            await asyncio.wait(reasons, return_when=asyncio.FIRST_COMPLETED)
            for reason in reasons:
                reason.cancel()
            # What moves stops first; clients still see how it ends.
            moving.cancel()
            await asyncio.wait({moving})
            server.should_exit = True
            if not server.started:
                web.cancel()
    finally:
        parts.training.cancel()
        parts.encoder.close()


def uvicorn_config(app: FastAPI, config: ServerConfig) -> uvicorn.Config:
    """Return how the web server runs an application."""
    return uvicorn.Config(
        app,
        http=connections.TimedHttp,
        ws=connections.TimedWebSocket,
        ws_max_size=4096,
        ws_ping_interval=connections.PING_S,
        ws_ping_timeout=connections.PONG_DEADLINE_S,
        ws_per_message_deflate=False,
        lifespan="off",
        # uvicorn's own lines hold URLs, and URLs may hold tokens.
        log_config=None,
        log_level="warning",
        access_log=False,
        proxy_headers=False,
        server_header=False,
        limit_concurrency=512,
        h11_max_incomplete_event_size=16_384,
        timeout_graceful_shutdown=_GRACE_S,
        ssl_certfile=config.tls_certificate,
        ssl_keyfile=config.tls_key,
    )


@contextmanager
def bound_socket(host: str, port: int) -> Iterator[socket.socket]:
    """Hold a TCP port for a ``with`` block; it does not listen yet.

    Args:
        host: Address or name.
        port: 0 takes a free one.

    Raises:
        ConfigError: If the address is unknown or the port is taken.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, kind, protocol)
    except OSError as error:
        raise ConfigError(f"server.host {host!r} is no address of this machine ({error})") from None
    with listener:
        if os.name == "posix":
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, connections.SEND_BUFFER_BYTES)
        try:
            listener.bind(address)
        except OSError as error:
            raise ConfigError(
                f"{host} port {port} cannot be used ({error.strerror}): choose another one"
            ) from None
        yield listener


def _check_certificate(config: ServerConfig) -> None:
    if config.tls_certificate is None:
        return
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(config.tls_certificate, config.tls_key)
    except OSError as error:
        files = f"{config.tls_certificate} and {config.tls_key}"
        raise ConfigError(f"server.tls_certificate: {files} cannot be used ({error})") from None


def ready_for(config: ServerConfig, listener: socket.socket, hand_port: int) -> Ready:
    """Return what a client needs to come in.

    Args:
        config: With tokens.
        listener: The bound web socket.
        hand_port: The hand link's real port.
    """
    port = listener.getsockname()[1]
    scheme = "https" if config.tls_certificate else "http"
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(config.host, config.host)
    host = f"[{host}]" if ":" in host else host
    operator, viewer = config.operator_token or "", config.viewer_token or ""
    return Ready(f"{scheme}://{host}:{port}/?token={operator}", port, hand_port, operator, viewer)


@contextmanager
def _stop_signals() -> Iterator[asyncio.Event]:
    """Give an event that SIGTERM and SIGINT set, however often they come."""
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()

    def told(_: int, __: FrameType | None) -> None:
        loop.call_soon_threadsafe(stop.set)

    before = {number: signal.signal(number, told) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _leaf(group: BaseExceptionGroup[ConfigError]) -> ConfigError:
    first = group.exceptions[0]
    return _leaf(first) if isinstance(first, BaseExceptionGroup) else first
