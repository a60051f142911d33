"""The control loop on the simulated world in lock-step: simulated time, no sockets, no threads."""

import asyncio
from typing import Any

import numpy as np
import pytest

from mrnav_server.autonomy.follower import Follower
from mrnav_server.autonomy.following import FollowerConfig
from mrnav_server.autonomy.path import PathPlanner
from mrnav_server.core.areas import CriticalAreas
from mrnav_server.core.frames import HandPoint, VesselPoint
from mrnav_server.core.hand import HandConfig, HandControl
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.lease import Lease
from mrnav_server.core.limits import Limits
from mrnav_server.core.modes import Ask, Mode
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Track, TrackState
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.autopilot import Autopilot, AutopilotConfig
from mrnav_server.loops.control import ControlLoop
from mrnav_server.loops.guards import GuardConfig
from mrnav_server.loops.handover import HandoverConfig
from mrnav_server.sim.devices import SimulatedManipulator
from mrnav_server.sim.world import SimConfig, SimulatedWorld
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model

TICK_S = 0.01
FRAME_S = 1 / 30


class LockStep:
    """A rig whose clock is a number: ``advance`` is the only thing that moves it."""

    def __init__(
        self,
        vessel: VesselMap,
        planner: PathPlanner,
        seed: int = 1,
        limits: Limits | None = None,
        handover: HandoverConfig | None = None,
    ) -> None:
        self.now_s = 100.0
        self.vessel = vessel
        self.planner = planner
        self.world = SimulatedWorld(SimConfig(), vessel, PictureFormat(), seed)
        self.world.set_time(self.now_s)
        self.manipulator = SimulatedManipulator(self.world)
        asyncio.run(self.manipulator.open())
        self.calibration = self.world.calibration
        self.limits = limits or Limits()
        self.lease = Lease()
        self.lease.take_hand("hand", "test", self.now_s)
        self.hand = HandControl(HandConfig(), self.limits.speed_um_per_s)
        self.areas = CriticalAreas(vessel)
        self.autopilot = Autopilot(
            AutopilotConfig(source="geodesic"),
            Follower(FollowerConfig(), vessel, self.calibration),
            self.limits.autonomy_speed_um_per_s,
            vessel.um_per_px,
            "",
        )
        self.changes: list[str] = []
        self.lines: list[tuple[float, str, dict[str, Any]]] = []
        self.control = ControlLoop(
            handover or HandoverConfig(),
            GuardConfig(),
            self.limits,
            self.manipulator,
            self.calibration,
            vessel,
            self.lease,
            self.hand,
            self.autopilot,
            lambda topic, data: self.lines.append((self.now_s, topic, data)),
            lambda change: self.changes.append(change.after.value),
        )
        self.hand_alive = True
        self.camera_alive = True
        self.hand_x_m = 0.0
        self.hand_z_m = 0.0
        self.clutch = False
        self._rng = np.random.default_rng(seed)
        self._frames = 0
        self._next_frame_s = self._next_hand_s = self.now_s
        self._hands = 0

    def is_in(self, mode: Mode) -> bool:
        return self.control.machine.mode is mode

    def commands(self) -> list[dict[str, Any]]:
        return [data for _, topic, data in self.lines if topic == "command"]

    def ask(self, ask: Ask) -> None:
        self.control.submit(ask, self.now_s)

    def mark(self, index: int = 0, epsilon_um: float = 500.0) -> None:
        self.control.choose_area(self.areas.add(self.vessel.suggested_areas[index], epsilon_um, ""))

    def start_auto(self) -> None:
        area, robot = self.control.scene.area, self.control.scene.robot
        assert area is not None
        assert robot is not None
        self.autopilot.prepare(self.planner.plan(robot, area.center), area.center, area.epsilon_um)
        self.ask(Ask.AUTO)

    def advance(self, span_s: float) -> None:
        for _ in range(round(span_s / TICK_S)):
            self.tick()

    def advance_until(self, mode: Mode, span_s: float) -> float:
        """Advance until a mode is in force; return how long it took."""
        began_s = self.now_s
        while not self.is_in(mode):
            assert self.now_s - began_s < span_s, f"still {self.control.machine.mode} after {span_s} s"
            self.tick()
        return self.now_s - began_s

    def tick(self) -> None:
        self.now_s += TICK_S
        self.world.advance(self.now_s - self.world.time_s)
        if self.camera_alive and self.now_s >= self._next_frame_s:
            self._next_frame_s += FRAME_S
            self._see()
        while self.hand_alive and self.now_s >= self._next_hand_s:
            self._next_hand_s += 1 / 60
            self.send_hand()
        self.control.step(self.now_s)
        order = self.autopilot.order
        if order is not None:
            plan = self.planner.plan_back_off if order.back_off else self.planner.plan
            self.autopilot.deliver(order, plan(order.start, order.target))

    def send_hand(self) -> None:
        self._hands += 1
        self.lease.hear("hand", self.now_s)
        point = HandPoint(self.hand_x_m, 0.0, self.hand_z_m)
        self.hand.on_sample(
            HandSample("hand", self._hands, self.now_s, self.now_s, point, self.clutch, True, True)
        )
        self.control.on_hand(self.now_s, self.now_s)

    def _see(self) -> None:
        noise = self._rng.normal(0.0, 0.3, 2)
        robot = VesselPoint(self.world.robot.x_px + noise[0], self.world.robot.y_px + noise[1])
        good = min(self._frames, 99)
        state = TrackState.TRACKING if good >= 10 else TrackState.ACQUIRING
        image = self.calibration.image_point(robot)
        self.control.scene.see(Track(self.world.time_s, self._frames, state, image, robot, 1.0, 3.0, good))
        self._frames += 1


@pytest.fixture(scope="session")
def bifurcation() -> VesselMap:
    return load_vessel_model(find_model("bifurcation"))


@pytest.fixture(scope="session")
def planner(bifurcation: VesselMap) -> PathPlanner:
    return PathPlanner(bifurcation)


@pytest.fixture
def rig(bifurcation: VesselMap, planner: PathPlanner) -> LockStep:
    rig = LockStep(bifurcation, planner)
    rig.advance(0.5)
    return rig


@pytest.fixture
def driving(rig: LockStep) -> LockStep:
    """A rig in AUTO, under way at speed."""
    rig.mark()
    rig.ask(Ask.ARM)
    rig.start_auto()
    rig.advance(0.8)
    assert rig.is_in(Mode.AUTO)
    assert rig.control.drive.shaper.speed_um_per_s > 1000.0
    return rig
