"""One hand-over at arrival: policy, control loop and a simulated operator in simulated time.

The robot is placed at random, autonomy drives to a critical area on the way to a target, and the operator
drives on from there. Everything is simulated; the camera is the true place with the tracker's noise.
"""

import asyncio
import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mrnav_server.autonomy.follower import Follower
from mrnav_server.autonomy.path import PathPlanner, PlannedPath
from mrnav_server.core.areas import CriticalAreas
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import HandPoint, StagePoint, VesselPoint
from mrnav_server.core.hand import HandConfig, HandControl
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.handover_metrics import HandoverMetrics, handover_metrics
from mrnav_server.core.lease import Lease
from mrnav_server.core.metrics import trial_motions
from mrnav_server.core.modes import Ask, Mode
from mrnav_server.core.motion import Motion
from mrnav_server.core.motion_metrics import smoothness
from mrnav_server.core.records import Track, TrackState
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.autopilot import Autopilot
from mrnav_server.loops.control import ControlLoop
from mrnav_server.settings import Settings
from mrnav_server.sim.devices import SimulatedManipulator
from mrnav_server.sim.operator import HandPose, Phase, Sight, SimulatedOperator
from mrnav_server.sim.operator_model import OperatorModel, personal
from mrnav_server.sim.operator_route import Route
from mrnav_server.sim.world import SimulatedWorld

Style = Literal["blended", "stop", "paper", "abrupt"]
"""How the server hands over; "abrupt" is no style of its own but the paper's switch without the new zero."""
LEAST_WAY_UM = 10_000.0
PATIENCE_S = 40.0
_TICK_S = 0.01
_DISPLAY_S = 0.035
_NOISE_UM = 4.0
_OPERATORS = 12


@dataclass(frozen=True, slots=True)
class HandedOver:
    """What one hand-over came to.

    Attributes:
        window: The 2.5 s after the switch.
        jump_um: Largest step of the setpoint at the switch beyond what its velocity explains.
        jerk_um_per_s3: Largest jerk of the setpoint in the whole run.
        smoothness_auto: S of the way that autonomy drove.
        smoothness_hand: S of the way that the hand drove after the window.
        contacts: Wall contacts after the switch.
        announced: Whether the operator was told before.
    """

    window: HandoverMetrics
    jump_um: float
    jerk_um_per_s3: float
    smoothness_auto: float
    smoothness_hand: float
    contacts: int
    announced: bool


def handed_over(
    vessel: VesselMap,
    planner: PathPlanner,
    middle: PathPlanner,
    settings: Settings,
    style: Style,
    seed: int,
    epsilon_um: float,
    beyond_um: float,
) -> HandedOver | None:
    """Return how one hand-over went; None if autonomy did not arrive.

    Args:
        vessel: The vessel model.
        planner: Of the autonomy.
        middle: Of the operator, who keeps to the middle.
        settings: The server's.
        style: How control passes.
        seed: Of all that is drawn.
        epsilon_um: Radius of the critical area.
        beyond_um: The target lies so far beyond the area's centre.
    """
    random = np.random.default_rng(seed)
    start, way = _way(vessel, middle, random)
    index = len(way.points_px) - 1 - round(beyond_um / (way.spacing_px * vessel.um_per_px))
    center = VesselPoint(*map(float, way.points_px[index]))
    run = _Run(vessel, planner, settings, style, start, seed)
    return run.hand_over(center, epsilon_um, way)


class _AbruptHand(HandControl):
    """What the hand did while the policy drove counts at the first grip: for comparison only."""

    def __init__(self, config: HandConfig, speed_um_per_s: float) -> None:
        super().__init__(config, speed_um_per_s)
        self.counts_from: HandPoint | None = None
        self.newest: HandPoint | None = None

    def on_sample(self, sample: HandSample) -> None:
        super().on_sample(sample)
        self.newest = sample.point

    def engage(self, base: StagePoint, now_s: float) -> None:
        before, self.counts_from = self.counts_from, None
        if before is not None and self.newest is not None:
            right_um = 1e6 * self.gain * (self.newest.x_m - before.x_m)
            back_um = 1e6 * self.gain * (self.newest.z_m - before.z_m)
            base = StagePoint(base.x_um + right_um, base.y_um + back_um, base.z_um)
        super().engage(base, now_s)


def _way(
    vessel: VesselMap, planner: PathPlanner, random: np.random.Generator
) -> tuple[VesselPoint, PlannedPath]:
    """Draw a start with room around it, and a way that is long enough."""
    rows, columns = np.nonzero(vessel.free)
    while True:
        start, target = (
            VesselPoint(float(columns[k]), float(rows[k])) for k in random.integers(len(rows), size=2)
        )
        if min(vessel.clearance_um(start), vessel.clearance_um(target)) < 100.0:
            continue
        try:
            way = planner.plan(start, target)
        except RefusedError:
            continue
        if (len(way.points_px) - 1) * way.spacing_px * vessel.um_per_px >= LEAST_WAY_UM:
            return start, way


class _Run:
    def __init__(
        self,
        vessel: VesselMap,
        planner: PathPlanner,
        settings: Settings,
        style: Style,
        start: VesselPoint,
        seed: int,
    ) -> None:
        self.vessel, self.planner, self.settings = vessel, planner, settings
        self.handover = replace(settings.handover, style="paper" if style == "abrupt" else style)
        self.world = SimulatedWorld(replace(settings.sim, start=start, seed=seed), vessel, settings.camera)
        manipulator = SimulatedManipulator(self.world)
        asyncio.run(manipulator.open())
        calibration = self.calibration = self.world.calibration
        self.lease = Lease()
        self.lease.take_hand("operator", "simulated", 0.0)
        hand = _AbruptHand if style == "abrupt" else HandControl
        self.hand = hand(settings.hand, settings.limits.speed_um_per_s)
        self.autopilot = Autopilot(
            replace(settings.autopilot, source="geodesic"),
            Follower(settings.follower, vessel, calibration),
            settings.limits.autonomy_speed_um_per_s,
            vessel.um_per_px,
            "",
        )
        self.control = ControlLoop(
            self.handover,
            settings.guards,
            settings.limits,
            manipulator,
            calibration,
            vessel,
            self.lease,
            self.hand,
            self.autopilot,
            lambda topic, data: None,
            lambda change: None,
        )
        self.control.surroundings.announce = self._announce
        model = personal(OperatorModel(), seed % _OPERATORS)
        self.operator = SimulatedOperator(model, seed)
        self.noise = np.random.default_rng([seed, 1])
        self.told_s: float | None = None
        self.countdown_s = 0.0
        self.display: list[Sight] = []
        self.frames = self.messages = 0
        self.tracks: list[tuple[float, float, float]] = []
        self.setpoints: list[tuple[float, float, float, float]] = []
        self.accelerations: list[tuple[float, float, float]] = []
        self.grip_s = math.nan
        self.pose_number = -1

    def hand_over(self, center: VesselPoint, epsilon_um: float, way: PlannedPath) -> HandedOver | None:
        """Drive to the area, hand over, and let the operator drive on to the way's end."""
        vessel, control = self.vessel, self.control
        scale = vessel.um_per_px
        stage = np.array([self.calibration.stage_xy_um(VesselPoint(*map(float, p))) for p in way.points_px])
        room = [vessel.clearance_um(VesselPoint(*map(float, p))) for p in way.points_px]
        self.operator.know(Route(stage[::5], np.array(room)[::5]))
        while self.world.time_s < 1.0:
            self._tick()
        robot = control.scene.robot
        if robot is None:
            return None
        area = CriticalAreas(vessel).add(center, epsilon_um, "")
        control.choose_area(area)
        slow_um = epsilon_um if self.handover.in_motion(epsilon_um) else 0.0
        self.autopilot.prepare(self.planner.plan(robot, center), center, slow_um)
        for ask in (Ask.ARM, Ask.AUTO):
            control.submit(ask, self.world.time_s)
        go_s = self.world.time_s
        if isinstance(self.hand, _AbruptHand):
            self.hand.counts_from = self.hand.newest
        while control.machine.mode is Mode.AUTO:
            self._tick()
            if self.world.time_s - go_s > PATIENCE_S:
                return None
        if control.machine.mode is not Mode.MANUAL:
            return None
        switch_s, before = self.world.time_s, self.world.collisions
        self.grip_s = switch_s if self.hand.engaged else math.nan
        while self.world.time_s - switch_s < PATIENCE_S and self.operator.phase is not Phase.FINISHED:
            self._tick()
        track, sent = np.array(self.tracks), np.array(self.setpoints)
        motions = trial_motions(track[:, 0], track[:, 1:] * scale, go_s, self.world.time_s)
        at = (sent[:, 0] > switch_s - 0.1) & (sent[:, 0] < switch_s + 2.5)
        window = handover_metrics(motions, switch_s, sent[at, 0], sent[at, 1:], self.grip_s)
        jerk = np.linalg.norm(np.diff(np.array(self.accelerations), axis=0), axis=1) / _TICK_S
        smooth = {
            name: _smoothness([motion.between(*span) for motion in motions])
            for name, span in (("auto", (go_s, switch_s)), ("hand", (switch_s + 2.5, self.world.time_s)))
        }
        return HandedOver(
            window,
            _jump_um(sent, switch_s, self.settings.limits.acceleration_um_per_s2),
            float(jerk.max()),
            smooth["auto"],
            smooth["hand"],
            self.world.collisions - before,
            self.told_s is not None,
        )

    def _announce(self, left_s: float) -> None:
        self.told_s, self.countdown_s = self.world.time_s, left_s

    def _tick(self) -> None:
        self.world.advance(_TICK_S)
        now_s = self.world.time_s
        if now_s >= self.frames / 30.0:
            self._see(now_s)
        while self.display and self.display[0].t_s <= now_s:
            self.operator.see(self.display.pop(0))
        if now_s >= self.messages / 60.0:
            self._hand(now_s)
        self.control.step(now_s)
        self._plan()
        if math.isnan(self.grip_s) and self.control.machine.mode is Mode.MANUAL and self.hand.engaged:
            self.grip_s = now_s
        shaper = self.control.drive.shaper
        at = shaper.position
        self.setpoints.append((now_s, at.x_um, at.y_um, at.z_um))
        if self.control.setpoint is not None:
            self.accelerations.append(shaper.acceleration_um_per_s2)

    def _see(self, now_s: float) -> None:
        robot = self.world.robot
        noise = self.noise.normal(0.0, _NOISE_UM / self.vessel.um_per_px, 2)
        seen = VesselPoint(robot.x_px + noise[0], robot.y_px + noise[1])
        good = min(self.frames, 99)
        state = TrackState.TRACKING if good >= 10 else TrackState.ACQUIRING
        image = self.calibration.image_point(seen)
        self.control.scene.see(Track(now_s, self.frames, state, image, seen, 1.0, _NOISE_UM, good))
        self.tracks.append((now_s, seen.x_px, seen.y_px))
        self.frames += 1
        left_s = None if self.told_s is None else max(self.countdown_s - (now_s - self.told_s), 0.0)
        mode, authority = self.control.machine.mode, self.control.authority(now_s)
        place = self.calibration.stage_xy_um(seen)
        self.display.append(Sight(now_s + _DISPLAY_S, mode, place, authority, left_s))

    def _hand(self, now_s: float) -> None:
        self.messages += 1
        pose: HandPose = self.operator.hand(now_s)
        fresh, self.pose_number = pose.number != self.pose_number, pose.number
        self.lease.hear("operator", now_s)
        self.hand.on_sample(
            HandSample("operator", self.messages, now_s, now_s, pose.point, pose.clutch, True, fresh)
        )
        self.control.on_hand(now_s, now_s)

    def _plan(self) -> None:
        order = self.autopilot.order
        if order is not None:
            plan = self.planner.plan_back_off if order.back_off else self.planner.plan
            self.autopilot.deliver(order, plan(order.start, order.target))


def _smoothness(motions: list[Motion]) -> float:
    return smoothness([motion for motion in motions if motion.t_s.size > 1]).value


def _jump_um(sent: np.ndarray, switch_s: float, most_um_per_s2: float) -> float:
    """Return how far the setpoint left, within 50 ms of the switch, what its acceleration allows."""
    near = np.abs(sent[:, 0] - switch_s) < 0.05
    bend_um = np.linalg.norm(np.diff(sent[near, 1:], n=2, axis=0), axis=1)
    return max(float(bend_um.max()) - most_um_per_s2 * _TICK_S**2, 0.0)
