"""A trial in virtual time in which something is made to happen: a fault, or somebody who intervenes."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mrnav_server.app.virtual_run as virtual_run
from mrnav_server.app.auth import Role, session_name
from mrnav_server.app.ready import Ready
from mrnav_server.app.rig import Rig
from mrnav_server.cli.console import TwinConsole
from mrnav_server.cli.trial_steps import ARMED_S, SEATED_S, ask_auto, insist, wait_tracking
from mrnav_server.cli.virtual_trial import report_here
from mrnav_server.client.hand import HandLink
from mrnav_server.client.rest import Rest, RestError
from mrnav_server.client.waiting import Waiting
from mrnav_server.core.areas import CriticalAreas
from mrnav_server.core.frames import StagePoint, VesselPoint
from mrnav_server.core.modes import ARMED, LATCHED
from mrnav_server.core.records import MotionCommand
from mrnav_server.settings import load_settings
from mrnav_server.sim.operator import Condition
from mrnav_server.sim.virtual_time import VirtualTimeLoop

_MESSAGE_S = 1 / 60
_SPEED_M_PER_S = 0.03
_AFTER_S, _FAULT_S, _MENDED_S = 0.7, 0.8, 0.6
SMALL = {
    "MRNAV_CAMERA__WIDTH_PX": "800",
    "MRNAV_CAMERA__HEIGHT_PX": "600",
    "MRNAV_SIM__IMAGE_UM_PER_PX": "30",
}
"""Pictures that are drawn quickly."""


class Hand:
    """A hand at the hand link, which does what it is told.

    Args:
        ready: Where the server listens.
        waiting: How it waits.

    Attributes:
        clutch, valid: As it sends them.
        velocity_m_per_s: Along the stage's x.
        at_m: Where it is along x.
        silent: Whether it sends nothing.
        away: Whether it is connected at all.
    """

    def __init__(self, ready: Ready, waiting: Waiting) -> None:
        self._ready = ready
        self._waiting = waiting
        self._left = False
        self.clutch = self.silent = self.away = False
        self.valid = True
        self.velocity_m_per_s = self.at_m = 0.0

    def work(self) -> None:
        """Send until it has left."""
        while not self._left:
            if self.away:
                self._waiting.sleep(_MESSAGE_S)
                continue
            with HandLink(
                "127.0.0.1",
                self._ready.hand_port,
                self._ready.operator_token,
                client="hand",
                frame="stage",
                simulated_by="script",
                waiting=self._waiting,
            ) as link:
                while self._sits():
                    self.at_m += self.velocity_m_per_s * _MESSAGE_S
                    if not self.silent:
                        link.send((self.at_m, 0.0, 0.0), clutch=self.clutch, valid=self.valid)
                    for _ in link.twins(for_s=_MESSAGE_S):
                        pass

    def _sits(self) -> bool:
        return not (self._left or self.away)

    def leave(self) -> None:
        """End ``work``."""
        self._left = True


@dataclass
class Stage:
    """What a script may touch: everything. The loop stands still while it does."""

    rig: Rig
    hand: Hand
    rest: Rest
    twin: TwinConsole
    area: str

    @property
    def session(self) -> str:
        """Who the console is to the rig."""
        return session_name(self.twin.snapshot["session"], Role.OPERATOR)


def _nothing(_: Stage) -> None:
    pass


@dataclass(frozen=True)
class Script:
    """What happens in the middle of a trial.

    Attributes:
        name: For people.
        happens: Makes it happen.
        mended: Undoes it, before the trial goes on.
    """

    name: str
    happens: Callable[[Stage], None] = _nothing
    mended: Callable[[Stage], None] = _nothing


@dataclass(frozen=True)
class ScriptedTrial:
    """A trial.

    Attributes:
        model: Vessel model.
        condition: With or without autonomy.
        script: What happens.
        variables: Further settings, as ``MRNAV_`` variables.
    """

    model: str
    condition: Condition
    script: Script
    variables: Mapping[str, str] = field(default_factory=dict)

    def run(self, root: Path, seed: int) -> Path:
        """Run it; return the trial's folder."""
        variables = {
            "MRNAV_SERVER__PORT": "0",
            "MRNAV_SERVER__HAND_PORT": "0",
            "MRNAV_RIG__VESSEL": self.model,
            "MRNAV_RECORDING__ROOT": str(root),
            "MRNAV_SIM__SEED": str(seed),
            **SMALL,
            **self.variables,
        }
        rigs: list[Rig] = []

        class SeenRig(Rig):
            def __init__(self, *args: Any) -> None:  # noqa: ANN401 - as the rig's own
                super().__init__(*args)
                rigs.append(self)

        def play(ready: Ready, loop: VirtualTimeLoop) -> Path:
            return _play(self, rigs[0], ready, loop)

        vars(virtual_run)["Rig"] = SeenRig
        try:
            return virtual_run.run_in_virtual_time(load_settings(None, variables), report_here, play)
        finally:
            vars(virtual_run)["Rig"] = Rig


def _play(trial: ScriptedTrial, rig: Rig, ready: Ready, loop: VirtualTimeLoop) -> Path:
    url, waiting = f"http://127.0.0.1:{ready.port}", loop.waiting
    wait_tracking(Rest(url, ready.operator_token, waiting=waiting))
    hand = Hand(ready, waiting)
    working = loop.run_in_executor(None, hand.work)
    try:
        with TwinConsole(url, ready.operator_token, lambda: None, waiting) as twin:
            rest = Rest(url, ready.operator_token, twin.snapshot["session"], 150.0, waiting=waiting)
            rest.post("/api/v1/lease", {"client": "script"})
            twin.until(lambda s: bool(s["lease"]["hand"]), SEATED_S, "the hand")
            area = _mark(rest, twin)
            begun = rest.post(
                "/api/v1/trials",
                {"participant": "SIM00", "condition": trial.condition, "operator_kind": "simulated"},
            )
            _drive(trial, Stage(rig, hand, rest, twin, area))
            rest.post(f"/api/v1/trials/{begun['id']}/end", {})
            return Path(begun["folder"])
    finally:
        hand.leave()
        while not working.done():
            waiting.sleep(_MESSAGE_S)
        working.result()


def _mark(rest: Rest, twin: TwinConsole) -> str:
    """Mark the suggested area that lies farthest away."""
    robot = twin.state["robot_vessel_px"]
    sites = [(site["x_px"], site["y_px"]) for site in twin.snapshot["vessel"]["suggested_areas"]]
    x, y = max(sites, key=lambda site: math.dist(site, robot))
    body = {"center": {"frame": "vessel", "x": x, "y": y}, "epsilon_um": 500.0}
    return str(rest.post("/api/v1/critical-areas", body)["id"])


def _drive(trial: ScriptedTrial, stage: Stage) -> None:
    rest, twin, hand = stage.rest, stage.twin, stage.hand
    insist(rest, twin, "arm")
    twin.until(lambda s: s["mode"] in ("MANUAL", "HOLD"), ARMED_S, "arming")
    if trial.condition == "with_autonomy":
        ask_auto(rest, twin, stage.area)
    else:
        hand.clutch, hand.velocity_m_per_s = True, _SPEED_M_PER_S
    twin.wait(_AFTER_S)
    trial.script.happens(stage)
    twin.wait(_FAULT_S)
    trial.script.mended(stage)
    twin.wait(_MENDED_S)
    if stage.rig.control.machine.mode in LATCHED:
        insist(rest, twin, "reset")
    if stage.rig.control.machine.mode not in ARMED:
        _try(rest, "arm")
    hand.clutch = False
    twin.wait(0.1)
    hand.clutch, hand.velocity_m_per_s = True, -_SPEED_M_PER_S
    twin.wait(_FAULT_S)


def _try(rest: Rest, ask: str, **fields: str) -> None:
    """Ask for a mode; a refusal is part of the trial."""
    try:
        rest.post("/api/v1/mode", {"ask": ask, **fields})
    except RestError as error:
        if error.status == 0:
            raise


# -- scripts -----------------------------------------------------------------------------------------------


def _camera(what: str, *arguments: float) -> Script:
    def happens(stage: Stage) -> None:
        getattr(stage.rig.bench.camera, what)(*arguments)

    def mended(stage: Stage) -> None:
        stage.rig.bench.camera.recover()  # type: ignore[attr-defined]

    return Script(f"camera: {what}", happens, mended)


def _manipulator(what: str) -> Script:
    def happens(stage: Stage) -> None:
        getattr(stage.rig.bench.manipulator, what)()

    def mended(stage: Stage) -> None:
        stage.rig.bench.manipulator.recover()  # type: ignore[attr-defined]

    return Script(f"manipulator: {what}", happens, mended)


def _stalls(stage: Stage) -> None:
    def accepted(target: StagePoint, speed_um_per_s: float, now_s: float) -> MotionCommand:
        return MotionCommand(now_s, target, speed_um_per_s)

    vars(stage.rig.bench.manipulator)["move_to"] = accepted


def _goes_on(stage: Stage) -> None:
    del vars(stage.rig.bench.manipulator)["move_to"]


def _hand(name: str, **changes: object) -> Script:
    """A hand that changes, and changes back."""
    before: dict[str, object] = {}

    def happens(stage: Stage) -> None:
        for attribute, value in changes.items():
            before[attribute] = getattr(stage.hand, attribute)
            setattr(stage.hand, attribute, value)

    def mended(stage: Stage) -> None:
        for attribute, value in before.items():
            setattr(stage.hand, attribute, value)

    return Script(f"hand: {name}", happens, mended)


def _ask(*asks: str) -> Script:
    def happens(stage: Stage) -> None:
        for ask in asks:
            _try(stage.rest, ask)

    def mended(stage: Stage) -> None:
        _try(stage.rest, "auto", area=stage.area)

    return Script(f"console: {', '.join(asks)}", happens, mended)


def _takes_over(stage: Stage) -> None:
    stage.hand.clutch = False
    stage.twin.wait(0.05)
    stage.hand.clutch, stage.hand.velocity_m_per_s = True, _SPEED_M_PER_S


def _is_lost(stage: Stage) -> None:
    assert stage.rig.bench.world is not None
    stage.rig.bench.world.drop_robot()


def _is_found(stage: Stage) -> None:
    world = stage.rig.bench.world
    assert world is not None
    world.place_robot(world.robot)


def _bump(stage: Stage) -> None:
    assert stage.rig.bench.world is not None
    stage.rig.bench.world.bump_needle(150.0, -80.0)


def _area_moves(stage: Stage) -> None:
    areas: CriticalAreas = stage.rig.areas
    areas.remove(stage.area)
    x, y = stage.twin.state["robot_vessel_px"]
    areas.add(VesselPoint(x, y), 300.0, "elsewhere")


def _lease_goes(stage: Stage) -> None:
    stage.rig.console.give_lease(stage.session)


def _lease_comes(stage: Stage) -> None:
    stage.rest.post("/api/v1/lease", {"client": "script"})


def _fails(stage: Stage) -> None:
    stage.rig.control.fail("the supervisor stopped the manipulator")


def _scale(stage: Stage) -> None:
    stage.hand.clutch = False
    stage.twin.wait(0.1)
    stage.rig.console.choose_scale(stage.session, "fine")
    stage.hand.clutch = True


FAULTS = (
    _camera("freeze"),
    _camera("black_out"),
    _camera("slow_down", 0.3),
    _manipulator("fail"),
    _manipulator("mute"),
    Script("manipulator: stalls", _stalls, _goes_on),
    _hand("silent", silent=True),
    _hand("teleports", at_m=0.4),
    _hand("not a number", at_m=math.nan),
    _hand("not seen", valid=False),
    _hand("leaves", away=True),
    Script("robot: lost", _is_lost, _is_found),
    Script("needle: bumped", _bump),
    _ask("stop"),
    _ask("hold"),
    _ask("disarm", "auto"),
    Script("hand: takes over", _takes_over),
    Script("area: another one", _area_moves),
    Script("lease: given back", _lease_goes, _lease_comes),
    Script("supervisor: stops", _fails),
    Script("hand: fine scale", _scale),
)
"""Everything that is made to happen."""
PLAIN = Script("nothing")
