"""One task of autonomy on the whole simulated rig, in simulated time, as fast as the processor allows.

The microscope's pictures are drawn and tracked; planner, autopilot, follower and control loop are the
server's own, with its default settings. Only the clock is a number.
"""

import asyncio
import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mrnav_server.app.navigator import Navigator
from mrnav_server.core.areas import CriticalAreas
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.hand import HandControl
from mrnav_server.core.lease import Lease
from mrnav_server.core.modes import Ask, Mode
from mrnav_server.core.records import Frame, Track
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.autopilot import AutopilotConfig, PathOrder
from mrnav_server.loops.control import ControlLoop
from mrnav_server.settings import Settings
from mrnav_server.sim.devices import SimulatedManipulator
from mrnav_server.sim.microscope import Microscope
from mrnav_server.sim.world import SimulatedWorld
from mrnav_server.training.rig_runs import distance_to_path_px
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.tracker import Tracker
from mrnav_server.vision.vessel_model import load_vessel_model

Law = Literal["policy", "geodesic", "direct"]
LAWS: tuple[Law, ...] = ("policy", "geodesic", "direct")
CONDITIONS = ((0.1, 1.04), (0.2, 1.04), (0.3, 1.02))
"""Friction, and the magnet's height over the critical height; tasks take them in turn."""
EPSILON_UM = 100.0
OFFSET_ERROR_UM = 100.0
LATENCY_MS = 25.0
LOOK_S = 0.5
"""The tracker looks for so long before anything moves."""
REST_S = 1.0
"""So long after autonomy has ended the robot's place counts."""
PATIENCE_S = 90.0
PLANNING_S = 0.1
SAMPLE_TICKS = 2
LEFT_BEHIND_UM = 3000.0
_CONSOLE = "bench"


@dataclass(frozen=True, slots=True)
class Task:
    """Where from and where to, under which condition.

    Attributes:
        model: The vessel model.
        number: Of the task, and seed of its world.
        start: Where the robot is put down.
        target: Centre of the critical area.
        friction: Of the robot.
        height_factor: Height over the critical height.
        offset_error_um: How wrong the calibrated offset is; its direction is drawn.
    """

    model: str
    number: int
    start: VesselPoint
    target: VesselPoint
    friction: float
    height_factor: float
    offset_error_um: float = OFFSET_ERROR_UM


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one task came to; all simulated.

    Attributes:
        law: Who drove.
        task: Which task.
        arrived: Whether the robot rests within `EPSILON_UM` of the target, brought there by autonomy.
        touched: Whether it was within `EPSILON_UM` of the target in AUTO, at rest or in passing.
        contacts: Wall contacts from the start of AUTO to rest.
        lost: Whether the robot jumped to the magnet or was left behind.
        reason: Why autonomy ended, if not by arrival.
        least_gap_um: Least gap between rim and wall on the way.
        left_um: Distance to the target at rest.
        arrival_s: When the robot last entered the area, from the start of AUTO.
        geodesic_um: Length of the shortest way to the area.
        cross_track_um: Distance to the path that was in force, every 20 ms while it was followed.
        replans: Paths that were planned on the way.
        source: Who proposed the first route.
    """

    law: Law
    task: Task
    arrived: bool
    touched: bool
    contacts: int
    lost: bool
    reason: str
    least_gap_um: float
    left_um: float
    arrival_s: float
    geodesic_um: float
    cross_track_um: tuple[float, ...]
    replans: int
    source: str


class Bench:
    """One vessel model and one law; what is slow to load is loaded once.

    Args:
        model: The vessel model.
        law: Who drives.
    """

    def __init__(self, model: str, law: Law) -> None:
        self.law = law
        self.vessel = load_vessel_model(find_model(model))
        base = Settings()
        self._settings = base.model_copy(
            update={
                "rig": replace(base.rig, vessel=model),
                "autopilot": _autopilot(base.autopilot, law),
            }
        )
        world = SimulatedWorld(base.sim, self.vessel, base.camera)
        self._navigator = Navigator(self._settings, self.vessel, world.calibration)
        self._loop = asyncio.new_event_loop()
        self._loop.run_until_complete(self._navigator.load())

    def close(self) -> None:
        """End the planner's thread."""
        self._navigator.close()
        self._loop.close()

    def drive(self, task: Task, geodesic_um: float) -> Outcome:
        """Drive a task in a world of its own, with nothing learnt before."""
        settings = self._settings
        sim = replace(
            settings.sim,
            start=task.start,
            seed=task.number,
            friction=task.friction,
            height_factor=task.height_factor,
            offset_error_um=task.offset_error_um,
            camera_latency_ms=LATENCY_MS,
        )
        run = _Run(settings.model_copy(update={"sim": sim}), self.vessel, self._navigator, self._loop)
        return run.drive(self.law, task, geodesic_um)


class _Run:
    """A rig whose clock is a number."""

    def __init__(
        self, settings: Settings, vessel: VesselMap, navigator: Navigator, loop: asyncio.AbstractEventLoop
    ) -> None:
        sim = settings.sim
        self._world = SimulatedWorld(sim, vessel, settings.camera)
        self._vessel, self._navigator, self._loop = vessel, navigator, loop
        self._microscope = Microscope(
            settings.microscope,
            settings.camera,
            sim.magnets,
            vessel,
            self._world.true_calibration,
            sim.seed,
            self._world.optics,
        )
        self._tracker = Tracker(settings.tracker, self._world.calibration)
        self._latency_s = sim.camera_latency_ms * 1e-3
        self._frame_s = 1.0 / settings.camera.fps
        self._tick_s = settings.control.tick_s
        self._frames = 0
        self._in_flight: deque[Track] = deque()
        self._lease = Lease()
        self._lease.take_console(_CONSOLE, _CONSOLE, 0.0)
        navigator.recalibrate(self._world.calibration)
        manipulator = SimulatedManipulator(self._world)
        loop.run_until_complete(manipulator.open())
        self._control = ControlLoop(
            settings.handover,
            settings.guards,
            settings.limits,
            manipulator,
            self._world.calibration,
            vessel,
            self._lease,
            HandControl(settings.hand, settings.limits.speed_um_per_s),
            navigator.autopilot,
            lambda topic, data: None,
            lambda change: None,
        )
        self._order: PathOrder | None = None
        self._due_s = 0.0
        self._path_px = np.zeros((2, 2))
        self._replans = 0

    def drive(self, law: Law, task: Task, geodesic_um: float) -> Outcome:
        """Put the rig into AUTO, let it drive until it hands over or gives up, and wait for rest."""
        world, control = self._world, self._control
        while world.time_s < LOOK_S:
            self._tick()
        robot = control.scene.robot
        if robot is None:
            raise RefusedError("not_tracked", f"the robot is not seen at its start: {task}")
        area = CriticalAreas(self._vessel).add(task.target, EPSILON_UM, "")
        control.choose_area(area)
        path = self._loop.run_until_complete(self._navigator.plan(robot, area.center, area.epsilon_um))
        self._navigator.prepare(path, area)
        self._path_px = path.points_px
        for ask in (Ask.ARM, Ask.AUTO):
            control.submit(ask, world.time_s)
        began_s, before, ticks = world.time_s, world.collisions, 0
        entered_s: float | None = None
        rests_s: float | None = None
        handed_over, touched, reason, gap_um = False, False, "", math.inf
        cross_um: list[float] = []
        while rests_s is None or world.time_s < rests_s:
            self._tick()
            ticks += 1
            left_um = self._left_um(task.target)
            if left_um > EPSILON_UM:
                entered_s = None
            elif entered_s is None:
                entered_s = world.time_s
            touched |= entered_s is not None and rests_s is None
            gap_um = min(gap_um, self._vessel.clearance_um(world.robot))
            if rests_s is None and ticks % SAMPLE_TICKS == 0:
                cross_um.append(self._cross_track_um())
            if rests_s is None and (
                control.machine.mode is not Mode.AUTO or world.time_s - began_s > PATIENCE_S
            ):
                handed_over = self._handed_over
                reason = "" if handed_over else control.machine.reason or "it took too long"
                rests_s = world.time_s + REST_S
        left_um = self._left_um(task.target)
        lead_um = control.scene.lead_um
        return Outcome(
            law,
            task,
            handed_over and left_um <= EPSILON_UM,
            touched,
            world.collisions - before,
            world.lifted or lead_um is None or lead_um > LEFT_BEHIND_UM,
            reason,
            gap_um,
            left_um,
            (entered_s or world.time_s) - began_s,
            geodesic_um,
            tuple(c for c in cross_um if math.isfinite(c)),
            self._replans,
            path.source,
        )

    @property
    def _handed_over(self) -> bool:
        """Whether AUTO ended by arrival: then it passes through MANUAL, and nobody's hand is there."""
        return self._control.facts.arrived

    def _left_um(self, target: VesselPoint) -> float:
        return self._world.robot.distance_px(target) * self._vessel.um_per_px

    def _cross_track_um(self) -> float:
        """Return the distance to the path; nan before its first point and beyond its last."""
        robot = self._world.robot
        at = np.array([[robot.x_px, robot.y_px]])
        away_px = np.hypot(*(self._path_px - at).T)
        if not 0 < int(np.argmin(away_px)) < len(away_px) - 1:
            return math.nan
        return float(distance_to_path_px(self._path_px, at)[0]) * self._vessel.um_per_px

    def _tick(self) -> None:
        self._world.advance(self._tick_s)
        now_s = self._world.time_s
        if now_s >= self._frames * self._frame_s - 1e-9:
            seen = None if self._world.lifted else self._world.robot
            picture = self._microscope.render(seen, self._world.magnet)
            self._in_flight.append(self._tracker.update(Frame(self._frames, now_s, picture)))
            self._frames += 1
        while self._in_flight and self._in_flight[0].taken_s + self._latency_s <= now_s + 1e-9:
            self._control.scene.see(self._in_flight.popleft())
        self._lease.hear(_CONSOLE, now_s)
        self._control.step(now_s)
        self._plan_order(now_s)

    def _plan_order(self, now_s: float) -> None:
        """Plan what the autopilot orders; a path is delivered after the time that planning takes."""
        autopilot = self._navigator.autopilot
        order = autopilot.order
        if order is None:
            return
        if order is not self._order:
            self._order, self._due_s = order, now_s + PLANNING_S
        if now_s < self._due_s:
            return
        try:
            path = self._loop.run_until_complete(self._navigator.plan_order(order))
        except RefusedError as refused:
            autopilot.decline(order, str(refused))
            return
        if path is not None:
            self._path_px = path.points_px
            self._replans += 1
        autopilot.deliver(order, path)


def _autopilot(config: AutopilotConfig, law: Law) -> AutopilotConfig:
    if law == "direct":
        return replace(config, law="direct")
    return replace(config, source=law)
