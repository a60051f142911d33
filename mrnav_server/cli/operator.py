"""``mrnav operator``: the simulated operator as a process of its own, at the hand link like any headset."""

import json
import signal
import threading
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from types import FrameType
from typing import Annotated, Any

import typer
from rich.console import Console

from mrnav_server.cli.operator_chart import Chart
from mrnav_server.client.errors import ConnectionEndedError
from mrnav_server.client.hand import HandLink
from mrnav_server.client.rest import Rest
from mrnav_server.client.twin import Twin
from mrnav_server.client.waiting import REAL, Waiting
from mrnav_server.core.modes import Mode
from mrnav_server.loops.priority import compute_in_calling_threads, make_ordinary, prefer_this_process
from mrnav_server.sim.operator import MODEL_NAME, Condition, Phase, Sight, SimulatedOperator
from mrnav_server.sim.operator_model import MESSAGES_HZ, OperatorModel, personal, practised, steady
from mrnav_server.sim.operator_route import Route

_PING_S = 1.0
_LEAVE_S = 1.0
"""Content for so long, an operator who came for one task leaves."""
_LISTEN_S = 0.05


@dataclass(frozen=True, slots=True)
class Seat:
    """Where the operator sits down.

    Attributes:
        host, port: The hand link.
        url: The server's web address.
        token: An operator's token.
        area: The critical area to go to; "" takes the one that is active.
    """

    host: str
    port: int
    url: str
    token: str
    area: str = ""


def operator(
    token: Annotated[str, typer.Option(envvar="MRNAV_SERVER__OPERATOR_TOKEN", help="An operator's token.")],
    host: Annotated[str, typer.Option(help="Address of the hand link.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port of the hand link.")] = 9000,
    url: Annotated[str, typer.Option(help="The server's web address.")] = "http://127.0.0.1:8000",
    seed: Annotated[int, typer.Option(min=0, help="Which operator it is.")] = 0,
    trial: Annotated[int, typer.Option(min=0, help="Trials that it has done before: practice, noise.")] = 0,
    condition: Annotated[
        Condition, typer.Option(help="Wait for a hand-over, or steer all the way.")
    ] = "with_autonomy",
    area: Annotated[str, typer.Option(help="Critical area to go to; the active one if left out.")] = "",
    tau: Annotated[
        float, typer.Option(min=0.001, max=1.0, help="Gain that the operator reckons with.")
    ] = 0.04,
    scripted: Annotated[
        bool, typer.Option("--scripted", help="The average operator, without noise.")
    ] = False,
    once: Annotated[bool, typer.Option("--once", help="Leave when the robot is where it should be.")] = False,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object as the last line.")
    ] = False,
) -> None:
    """Sit down at the hand link as a simulated operator; steer to the critical area."""
    # It stands in for a headset, a device of its own that no load on this machine would slow down.
    prefer_this_process()
    compute_in_calling_threads()
    model = OperatorModel(gain=tau)
    model = steady(model) if scripted else practised(personal(model, seed), trial)
    someone = SimulatedOperator(model, 1000 * seed + trial, condition)
    signal.signal(signal.SIGTERM, _end)
    say = Console(stderr=True, highlight=False)
    with ThreadPoolExecutor(1, "chart", _ordinary) as planner:
        desk = Desk(Seat(host, port, url, token, area), someone, planner)
        try:
            desk.work(seed, condition, once=once)
        except ConnectionEndedError as error:
            if not desk.seated:
                raise
            say.print(f"simulated operator: {error}", markup=False)
        except KeyboardInterrupt:
            pass
    if json_output:
        typer.echo(json.dumps(desk.result(seed, condition)))


class Desk:
    """The operator's side of its connections.

    Args:
        seat: Where the server is.
        operator: Who sits there.
        planner: Looks for ways beside the hand, which goes on.
        waiting: How it waits.

    Attributes:
        seated: Whether the server took the hand.
    """

    def __init__(
        self, seat: Seat, operator: SimulatedOperator, planner: Executor, waiting: Waiting = REAL
    ) -> None:
        self.seated = False
        self._leaving = False
        self._planner = planner
        self._planned: Future[Route | None] | None = None
        self._waiting = waiting
        self._seat = seat
        self._operator = operator
        self._mode: Mode | None = None
        self._task: tuple[str, Mode] | None = None
        self._areas: dict[str, dict[str, Any]] = {}
        self._countdown_ends_s: float | None = None
        self._handed_over_s: float | None = None
        self._gripped_s: float | None = None
        self._let_go_s: float | None = None

    def work(self, seed: int, condition: Condition, *, once: bool) -> None:
        """Send the hand and look at the display until the server ends the connection, or the task is done.

        Raises:
            ConnectionEndedError: If the server is not there, refuses the operator, or ends the connection.
            RestError: If it does not show its vessel.
        """
        seat, waiting = self._seat, self._waiting
        rest = Rest(seat.url, seat.token, waiting=waiting)
        with Twin(seat.url, seat.token, rate_hz=1.0, waiting=waiting) as events:
            self._note_areas(events.snapshot["critical_areas"])
            chart = self._planner.submit(Chart, rest, events.snapshot)
            while not chart.done():
                self._listen(events, _LISTEN_S)
            with HandLink(
                seat.host,
                seat.port,
                seat.token,
                client=f"simulated operator {seed}",
                simulated_by=MODEL_NAME,
                seed=seed,
                waiting=waiting,
            ) as link:
                self.seated = True
                self._loop(link, events, chart.result(), once=once)

    def leave(self) -> None:
        """Have ``work`` end at the next message."""
        self._leaving = True

    def result(self, seed: int, condition: Condition) -> dict[str, Any]:
        """Return what the operator did, for JSON."""
        take_over_s = None
        if self._handed_over_s is not None and self._gripped_s is not None:
            take_over_s = round(max(self._gripped_s - self._handed_over_s, 0.0), 3)
        return {
            "simulated": True,
            "model": MODEL_NAME,
            "seed": seed,
            "condition": condition,
            "phase": self._operator.phase.value,
            "take_over_s": take_over_s,
            "regrips": self._operator.regrips,
        }

    def _loop(self, link: HandLink, events: Twin, chart: Chart, *, once: bool) -> None:
        """Send on absolute deadlines: sleeping for a period would send too seldom."""
        began_s = pinged_s = self._waiting.now_s()
        beat = 0
        while not self._leaving:
            now_s = self._waiting.now_s()
            pose = self._operator.hand(now_s)
            point = pose.point
            link.send((point.x_m, point.y_m, point.z_m), clutch=pose.clutch, pose=pose.number)
            if now_s - pinged_s > _PING_S:
                pinged_s = now_s
                link.ping()
            if self._note_phase(now_s) and once:
                return
            beat = max(beat + 1, int((now_s - began_s) * MESSAGES_HZ) + 1)
            self._listen(events, 0.0)
            for twin in link.twins(began_s + beat / MESSAGES_HZ - self._waiting.now_s()):
                self._look(twin, chart)

    def _listen(self, events: Twin, for_s: float) -> None:
        while (message := events.take(for_s)) is not None:
            if message["type"] == "event":
                self._hear(message)

    def _hear(self, event: dict[str, Any]) -> None:
        if event["event"] == "handover_announced":
            self._countdown_ends_s = self._waiting.now_s() + event["in_s"]
            self._task = None
        elif event["event"] == "handover":
            self._handed_over_s = self._waiting.now_s()
        elif event["event"] == "areas":
            self._note_areas(event["critical_areas"])

    def _look(self, twin: dict[str, Any], chart: Chart) -> None:
        """Show the operator one picture; when it shows a new task, look for the way."""
        now_s, mode = self._waiting.now_s(), Mode(twin["mode"])
        if mode is not Mode.AUTO:
            self._countdown_ends_s = None
        area = self._seat.area or twin["critical_area"]
        # Until a hand-over is due, the autonomy looks for the way.
        due = mode is not Mode.AUTO or self._countdown_ends_s is not None
        new = area in self._areas and (area, mode) != self._task
        if due and new and twin["robot_vessel_px"] is not None:
            self._task = (area, mode)
            self._planned = self._planner.submit(chart.route, twin["robot_vessel_px"], self._areas[area])
        if self._planned is not None and self._planned.done():
            self._operator.know(self._planned.result())
            self._planned = None
        robot = twin["robot_um"]
        in_s = None
        if self._countdown_ends_s is not None:
            told_s = twin["time_to_handover_s"]
            in_s = self._countdown_ends_s - now_s if told_s is None else told_s
        self._operator.see(
            Sight(
                t_s=now_s,
                mode=mode,
                robot_um=None if robot is None else (float(robot[0]), float(robot[1])),
                authority=twin["authority"],
                handover_in_s=in_s,
            )
        )

    def _note_areas(self, areas: list[dict[str, Any]]) -> None:
        self._areas = {area["id"]: area["center"] for area in areas}

    def _note_phase(self, now_s: float) -> bool:
        """Note when the operator takes hold and lets go; tell whether it has been content for long."""
        phase = self._operator.phase
        if phase is Phase.STEERING and self._gripped_s is None:
            self._gripped_s = now_s
        if phase is not Phase.FINISHED:
            self._let_go_s = None
        elif self._let_go_s is None:
            self._let_go_s = now_s
        return self._let_go_s is not None and now_s - self._let_go_s > _LEAVE_S


def _ordinary() -> None:
    """Plan as any program does: it is no part of the headset that this process stands in for."""
    make_ordinary(threading.get_native_id())


def _end(number: int, _: FrameType | None) -> None:
    raise KeyboardInterrupt(number)
