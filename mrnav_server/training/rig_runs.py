"""Drives tasks on the whole simulated rig in lock-step: simulated time, as fast as the processor allows.

The microscope's pictures are drawn and tracked, the policy's path is planned and followed, and the control
loop moves the manipulator, all by the code and the settings of the server.
"""

import asyncio
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from mrnav_server.autonomy.follower import Follower
from mrnav_server.autonomy.path import PathPlanner, PlannedPath
from mrnav_server.autonomy.policy import Policy
from mrnav_server.core.areas import CriticalAreas
from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.hand import HandControl
from mrnav_server.core.lease import Lease
from mrnav_server.core.modes import Ask, Mode
from mrnav_server.core.records import Frame, Track
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.autopilot import Autopilot, PathOrder
from mrnav_server.loops.control import ControlLoop
from mrnav_server.settings import Settings
from mrnav_server.sim.devices import SimulatedManipulator
from mrnav_server.sim.microscope import Microscope
from mrnav_server.sim.world import SimulatedWorld
from mrnav_server.training.batch import free_points
from mrnav_server.vision.tracker import Tracker

EPSILON_UM = 150.0
"""Radius of the critical area at the target: autonomy ends when the robot is inside."""
START_CLEARANCE_UM = 50.0
LEAST_TASK_PX = 300.0
"""Start and target are at least this far apart, as the crow flies."""
LOOK_S = 0.5
"""The tracker looks for so long before anything moves."""
PATIENCE_S = 60.0
PLANNING_S = 0.1
_CONSOLE = "figure"


@dataclass(frozen=True, slots=True)
class RigRun:
    """One task driven on the simulated rig.

    Attributes:
        start: Where the robot was put down.
        target: Centre of the critical area.
        arrived: Whether the robot came within `EPSILON_UM` of the target.
        reason: Why autonomy ended otherwise, or "".
        planned_px: The first path, shape (n, 2), in grid pixels.
        driven_px: Where the robot was at every tick of autonomy, shape (m, 2).
        deviation_um: Its distance to the path that was in force, shape (m,).
        time_s: Duration of autonomy, in simulated time.
        contacts: Wall contacts.
        replans: Paths that were planned on the way.
        source: Who proposed the route: ``"policy"`` or ``"geodesic"``.
    """

    start: VesselPoint
    target: VesselPoint
    arrived: bool
    reason: str
    planned_px: FloatArray
    driven_px: FloatArray
    deviation_um: FloatArray
    time_s: float
    contacts: int
    replans: int
    source: str


def random_tasks(vessel: VesselMap, count: int, seed: int) -> list[tuple[VesselPoint, VesselPoint]]:
    """Draw starts with room around them, and targets at least 300 px away."""
    random = np.random.default_rng(seed)
    points = free_points(vessel)
    tasks: list[tuple[VesselPoint, VesselPoint]] = []
    while len(tasks) < count:
        start, target = (
            VesselPoint(*map(float, point)) for point in points[random.integers(len(points), size=2)]
        )
        roomy = vessel.clearance_um(start) >= START_CLEARANCE_UM
        if roomy and start.distance_px(target) >= min(LEAST_TASK_PX, vessel.size_px / 4):
            tasks.append((start, target))
    return tasks


def distance_to_path_px(path_px: FloatArray, points_px: FloatArray) -> FloatArray:
    """Return the distance of points, shape (m, 2), to a polyline, shape (n, 2), n >= 2; shape (m,)."""
    tail, along = path_px[:-1], np.diff(path_px, axis=0)
    square = np.maximum((along**2).sum(axis=1), 1e-12)
    away = points_px[:, None] - tail
    share = ((away * along).sum(axis=2) / square).clip(0.0, 1.0)
    off = away - share[..., None] * along
    nearest: FloatArray = np.hypot(off[..., 0], off[..., 1]).min(axis=1)
    return nearest


class LockStepRig:
    """A rig whose clock is a number.

    Args:
        vessel: The vessel model.
        planner: On that vessel.
        policy: Who proposes the routes.
        start: Where the robot is put down.
        settings: As for the server; ``sim.start`` is replaced.
        seed: Of the physics, the pictures and the error of the magnet's offset.
    """

    def __init__(
        self,
        vessel: VesselMap,
        planner: PathPlanner,
        policy: Policy,
        start: VesselPoint,
        settings: Settings,
        seed: int,
    ) -> None:
        sim = replace(settings.sim, start=start, seed=seed)
        self.world = SimulatedWorld(sim, vessel, settings.camera)
        self._vessel, self._planner, self._policy = vessel, planner, policy
        self._microscope = Microscope(
            settings.microscope,
            settings.camera,
            sim.magnets,
            vessel,
            self.world.true_calibration,
            seed,
            self.world.optics,
        )
        self._tracker = Tracker(settings.tracker, self.world.calibration)
        self._latency_s = sim.camera_latency_ms * 1e-3
        self._frame_s = 1.0 / settings.camera.fps
        self._tick_s = settings.control.tick_s
        self._frames = 0
        self._in_flight: deque[Track] = deque()
        self._lease = Lease()
        self._lease.take_console(_CONSOLE, _CONSOLE, 0.0)
        self._autopilot = Autopilot(
            settings.autopilot,
            Follower(settings.follower, vessel, self.world.calibration),
            settings.limits.autonomy_speed_um_per_s,
            vessel.um_per_px,
            "",
        )
        manipulator = SimulatedManipulator(self.world)
        asyncio.run(manipulator.open())
        self._control = ControlLoop(
            settings.handover,
            settings.guards,
            settings.limits,
            manipulator,
            self.world.calibration,
            vessel,
            self._lease,
            HandControl(settings.hand, settings.limits.speed_um_per_s),
            self._autopilot,
            lambda topic, data: None,
            lambda change: None,
        )
        self._announced = settings.handover.announced
        self._order: PathOrder | None = None
        self._planned_at_s = 0.0
        self._path: PlannedPath | None = None
        self.replans = 0

    def drive(self, target: VesselPoint) -> RigRun:
        """Put the rig into AUTO and let it drive until it hands over or gives up."""
        start = self.world.robot
        while self.world.time_s < LOOK_S:
            self._tick()
        robot = self._control.scene.robot
        if robot is None:
            raise RefusedError("not_tracked", "the simulated robot is not seen at its start")
        self._control.choose_area(CriticalAreas(self._vessel).add(target, EPSILON_UM, ""))
        first = self._path = self._planner.plan(robot, target, self._policy)
        self._autopilot.prepare(first, target, EPSILON_UM if self._announced else 0.0)
        for ask in (Ask.ARM, Ask.AUTO):
            self._control.submit(ask, self.world.time_s)
        began_s = self.world.time_s
        driven: list[tuple[float, float]] = []
        deviation: list[FloatArray] = []
        while self._control.machine.mode is Mode.AUTO and self.world.time_s - began_s < PATIENCE_S:
            self._tick()
            driven.append((self.world.robot.x_px, self.world.robot.y_px))
            deviation.append(distance_to_path_px(self._path.points_px, np.array(driven[-1:])))
        left_um = self.world.robot.distance_px(target) * self._vessel.um_per_px
        arrived = left_um <= EPSILON_UM * 1.1
        return RigRun(
            start=start,
            target=target,
            arrived=arrived,
            reason="" if arrived else self._control.machine.reason or "it took too long",
            planned_px=first.points_px,
            driven_px=np.array(driven),
            deviation_um=np.concatenate(deviation) * self._vessel.um_per_px,
            time_s=self.world.time_s - began_s,
            contacts=self.world.collisions,
            replans=self.replans,
            source=first.source,
        )

    def _tick(self) -> None:
        self.world.advance(self._tick_s)
        now_s = self.world.time_s
        if now_s >= self._frames * self._frame_s - 1e-9:
            picture = self._microscope.render(self.world.robot, self.world.magnet)
            self._in_flight.append(self._tracker.update(Frame(self._frames, now_s, picture)))
            self._frames += 1
        while self._in_flight and self._in_flight[0].taken_s + self._latency_s <= now_s:
            self._control.scene.see(self._in_flight.popleft())
        self._lease.hear(_CONSOLE, now_s)
        self._control.step(now_s)
        self._plan_orders(now_s)

    def _plan_orders(self, now_s: float) -> None:
        """Plan what the autopilot orders; a path is delivered after the time that planning takes."""
        order = self._autopilot.order
        if order is None:
            return
        if order is not self._order:
            self._order, self._planned_at_s = order, now_s + PLANNING_S
        if now_s < self._planned_at_s:
            return
        path = (
            self._planner.plan_back_off(order.start, order.target)
            if order.back_off
            else self._planner.plan(order.start, order.target, self._policy)
        )
        if path is not None:
            self._path = path
            self.replans += 1
        self._autopilot.deliver(order, path)
