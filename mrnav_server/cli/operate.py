"""``mrnav operate``: the simulated operator as a process of its own, at the hand link like any headset."""

import asyncio
import json
import socket
import time
from dataclasses import dataclass, replace
from http import HTTPStatus
from typing import Annotated, Any

import typer
from rich.console import Console

from mrnav_server.cli.rest import Rest, RestError
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.modes import Mode
from mrnav_server.loops.priority import prefer_this_process
from mrnav_server.sim.operator import MESSAGES_HZ, OperatorModel, Phase, Sight, SimulatedOperator

MODEL_NAME = "deliberate pushes"
_CONNECT_S = 5.0
_PING_S = 1.0
_PENDING_BYTES = 16_384
_LONGEST_TWIN_BYTES = 65_536


@dataclass(frozen=True, slots=True)
class Seat:
    """Where the operator sits down.

    Attributes:
        host, port: The hand link.
        url: The server's web address, asked for the place of the critical areas.
        token: An operator's token.
        client: The name under which others see the operator.
    """

    host: str
    port: int
    url: str
    token: str
    client: str


def operate(
    token: Annotated[str, typer.Option(envvar="MRNAV_SERVER__OPERATOR_TOKEN", help="An operator's token.")],
    host: Annotated[str, typer.Option(help="Address of the hand link.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port of the hand link.")] = 9000,
    url: Annotated[str, typer.Option(help="The server's web address.")] = "http://127.0.0.1:8000",
    seed: Annotated[int, typer.Option(min=0, help="Seed of tremor and sway.")] = 0,
    scripted: Annotated[bool, typer.Option("--scripted", help="A steady hand: no tremor, no sway.")] = False,
) -> None:
    """Sit down at the hand link as a simulated operator; take over where the autonomy arrives."""
    # It stands in for a headset, a device of its own that no load on this machine would slow down.
    prefer_this_process()
    model = OperatorModel()
    if scripted:
        model = replace(model, tremor_m=0.0, sway_m=0.0)
    seat = Seat(host, port, url, token, f"simulated operator {seed}")
    asyncio.run(run_operator(seat, SimulatedOperator(model, seed), seed))


async def run_operator(seat: Seat, operator: SimulatedOperator, seed: int) -> None:
    """Send the hand and look at the twin until the server ends the connection.

    Raises:
        ConfigError: If the server is not there, or refuses the operator.
    """
    try:
        async with asyncio.timeout(_CONNECT_S):
            reader, writer = await asyncio.open_connection(seat.host, seat.port, limit=_LONGEST_TWIN_BYTES)
    except (OSError, TimeoutError) as error:
        raise ConfigError(f"no hand link at {seat.host}:{seat.port} ({error}): start `mrnav serve`") from None
    writer.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    desk = _Desk(seat, operator, seed, reader, writer)
    try:
        await desk.say_hello()
        await desk.work()
    except (_GoneError, OSError):
        Console(stderr=True).print("simulated operator: the server closed the hand link")
    finally:
        writer.close()


class _GoneError(Exception):
    """The server closed the connection."""


class _Desk:
    """The operator's side of one connection."""

    def __init__(
        self,
        seat: Seat,
        operator: SimulatedOperator,
        seed: int,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        self._seat = seat
        self._operator = operator
        self._seed = seed
        self._reader = reader
        self._writer = writer
        self._task: tuple[str | None, Mode] | None = None
        self._target_um: tuple[float, float] | None = None
        self._told = Phase.WATCHING
        self._console = Console(stderr=True)

    async def say_hello(self) -> None:
        """Introduce the operator, as simulated."""
        self._send(
            {
                "type": "hello",
                "v": 1,
                "role": "operator",
                "token": self._seat.token,
                "client": self._seat.client,
                "frame": "webxr",
                "rate_hz": MESSAGES_HZ,
                "simulated": True,
                "model": MODEL_NAME,
                "seed": self._seed,
            }
        )
        async with asyncio.timeout(_CONNECT_S):
            answer = await self._receive()
        if answer["type"] != "welcome":
            raise ConfigError(f"the server refuses the simulated operator: {answer.get('message', answer)}")
        if not answer["lease"]:
            raise ConfigError("another hand controls the rig: it must give the lease back first")

    async def work(self) -> None:
        """Send the hand and look at the display until one of the two ends."""
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._send_hand(), name="hand")
                group.create_task(self._look(), name="display")
        except ExceptionGroup as errors:
            raise errors.exceptions[0] from None

    async def _send_hand(self) -> None:
        """Send the hand on absolute deadlines: sleeping for a period would send too seldom."""
        began_s = time.monotonic()
        pinged_s, seq = began_s, 0
        while True:
            now_s = time.monotonic()
            pose = self._operator.hand(now_s)
            # A server that does not read gets nothing more: later it would be stale.
            if self._writer.transport.get_write_buffer_size() < _PENDING_BYTES:
                point = pose.point
                position = [round(v, 7) for v in (point.x_m, point.y_m, point.z_m)]
                self._send(
                    {
                        "type": "hand",
                        "seq": seq,
                        "t": now_s,
                        "p": position,
                        "clutch": pose.clutch,
                        "valid": True,
                        "pose": pose.number,
                    }
                )
                if now_s - pinged_s > _PING_S:
                    pinged_s = now_s
                    self._send({"type": "ping", "t": now_s})
            self._tell()
            seq = max(seq + 1, int((now_s - began_s) * MESSAGES_HZ) + 1)
            await asyncio.sleep(began_s + seq / MESSAGES_HZ - time.monotonic())

    async def _look(self) -> None:
        """Show the operator every twin message."""
        while True:
            message = await self._receive()
            if message["type"] == "error":
                raise ConfigError(f"the server dropped the simulated operator: {message['message']}")
            if message["type"] == "twin":
                await self._show(message)

    async def _show(self, twin: dict[str, Any]) -> None:
        mode, area = Mode(twin["mode"]), twin["critical_area"]
        if (area, mode) != self._task:
            self._task = (area, mode)
            self._target_um = await asyncio.to_thread(area_center_um, self._seat, area) if area else None
        robot = twin["robot_um"]
        robot_um = None if robot is None else (float(robot[0]), float(robot[1]))
        self._operator.see(Sight(time.monotonic(), mode, robot_um, self._target_um))

    def _tell(self) -> None:
        if (phase := self._operator.phase) in (Phase.REACHING, Phase.FINISHED) and phase is not self._told:
            self._console.print(f"simulated operator: {phase.value}", highlight=False)
        self._told = phase

    def _send(self, message: dict[str, Any]) -> None:
        if self._writer.is_closing():
            raise _GoneError
        self._writer.write(json.dumps(message, separators=(",", ":")).encode() + b"\n")

    async def _receive(self) -> dict[str, Any]:
        line = await self._reader.readline()
        if not line.endswith(b"\n"):
            raise _GoneError
        message: dict[str, Any] = json.loads(line)
        return message


def area_center_um(seat: Seat, area: str) -> tuple[float, float] | None:
    """Return a critical area's centre, stage x, y in µm; None if it is gone.

    Raises:
        ConfigError: If the server's web address does not answer.
    """
    rest = Rest(seat.url, seat.token)
    try:
        (a, b, tx), (c, d, ty) = rest.get("/api/v1/rig")["calibration"]["stage_from_vessel"]
        center = rest.get(f"/api/v1/critical-areas/{area}")["center"]
    except RestError as error:
        if error.status == HTTPStatus.NOT_FOUND:
            return None
        raise ConfigError(f"{error}: name the server's address with --url") from None
    x_px, y_px = center["x_px"], center["y_px"]
    return a * x_px + b * y_px + tx, c * x_px + d * y_px + ty
