"""The simulated operator: what it sees is late, what it gives is a fingertip pose.

It steers along the middle of the vessel to the target as the literature says that people steer
(docs/operator.md). It exercises the software over the real sockets and is no evidence about people.
"""

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import Literal

import numpy as np

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.frames import HandPoint
from mrnav_server.core.modes import Mode
from mrnav_server.sim.operator_body import Body
from mrnav_server.sim.operator_model import POSES_HZ, OperatorModel
from mrnav_server.sim.operator_route import Route

Condition = Literal["with_autonomy", "without_autonomy"]
MODEL_NAME = "local steering law, intermittent"
_STEP_S = 1.0 / 120.0
_HOMING_UM = 400.0
"""So near, the operator aims at the target itself and no longer along the middle."""
_PURSUIT_S = 0.1
"""The eye needs so long to pursue a change of the robot's velocity."""
_FAR_UM = 140.0
"""Let go further off than this, the operator takes hold again."""
_LOOK_S = 0.3
"""Having gripped or let go, the operator looks for so long at what comes of it."""


@dataclass(frozen=True, slots=True)
class Sight:
    """One picture on the operator's display.

    Attributes:
        t_s: When it lit up.
        mode: The mode shown.
        robot_um: Displayed robot, stage x, y in µm; None while it is not tracked.
        authority: The hand's share of the motion that is shown, 0 to 1.
        handover_in_s: The countdown, once a hand-over was announced; else None.
    """

    t_s: float
    mode: Mode
    robot_um: tuple[float, float] | None
    authority: float = 1.0
    handover_in_s: float | None = None


@dataclass(frozen=True, slots=True)
class HandPose:
    """What the headset tracks.

    Attributes:
        number: Counts the tracker's poses; a repeated number is no motion.
        point: Cumulative fingertip position.
        clutch: Whether the clutch is closed.
    """

    number: int
    point: HandPoint
    clutch: bool


class Phase(Enum):
    """What the operator is doing."""

    WATCHING = "watching"
    """The autonomy drives, or nobody does."""
    REACHING = "reaching"
    """Has perceived the cue, and is about to close the clutch."""
    STEERING = "steering"
    """Clutch closed."""
    REGRIPPING = "regripping"
    """Clutch open, hand on its way back."""
    FINISHED = "finished"
    """Content with the robot's place; clutch open."""


HOLDING = (Phase.STEERING, Phase.REGRIPPING)
"""What a rig that holds interrupts."""


class SimulatedOperator:
    """Decides the fingertip's pose from what the display has shown. Never waits, reads no clock.

    Args:
        model: What the operator is like.
        seed: Seeds all noise; the same sights then give the same poses.
        condition: With autonomy it waits for a hand-over; without, it begins as soon as it may.
    """

    def __init__(self, model: OperatorModel, seed: int, condition: Condition = "with_autonomy") -> None:
        self._model = model
        self._rng = np.random.default_rng([seed, 1])
        self._body = Body(model, np.random.default_rng([seed, 2]))
        self._condition = condition
        self._shown: deque[Sight] = deque()
        self._seen: Sight | None = None
        self._route: Route | None = None
        self._phase = Phase.WATCHING
        self._due_s = math.inf
        self._cued = self._autonomy_seen = False
        self._pose: HandPose | None = None
        self._advanced_s: float | None = None
        # The deliberate hand, x and y as in the stage.
        self._hand_m = np.zeros(2)
        self._gripped_m = np.zeros(2)
        self._moved_um: deque[tuple[float, FloatArray]] = deque()
        self._pursued_um_per_s = np.zeros(2)
        self.regrips = 0
        """How often it gripped anew."""
        self._begin_movement(-math.inf)

    @property
    def phase(self) -> Phase:
        """What the operator is doing."""
        return self._phase

    def know(self, route: Route | None) -> None:
        """Take the way to the target into view; None while there is no target."""
        self._route = route
        self._along_um: float | None = None

    def see(self, sight: Sight) -> None:
        """Take a picture that lights up on the display now; the operator perceives it later."""
        self._shown.append(sight)

    def hand(self, now_s: float) -> HandPose:
        """Return the headset's newest pose; between two poses it repeats itself."""
        if self._advanced_s is None:
            self._advanced_s = now_s
        while self._advanced_s + _STEP_S <= now_s:
            self._advanced_s += _STEP_S
            self._advance(self._advanced_s)
        number = math.floor(now_s * POSES_HZ)
        if self._pose is None or number > self._pose.number:
            elapsed = 1 if self._pose is None else number - self._pose.number
            x_m, y_m, up_m = self._body.displacement_m(now_s, elapsed / POSES_HZ)
            point = HandPoint(float(self._hand_m[0] + x_m), float(up_m), float(self._hand_m[1] + y_m))
            self._pose = HandPose(number, point, self._phase is Phase.STEERING)
        return self._pose

    def _advance(self, now_s: float) -> None:
        while self._shown and self._shown[0].t_s <= now_s - self._model.visual_delay_s:
            self._watch(self._shown.popleft())
        if self._seen is None:
            return
        self._heed(self._seen, now_s)
        # The hand's share is announced and practised: its course needs no look.
        share = self._shown[-1].authority if self._shown else self._seen.authority
        self._expect(1.0 - share, now_s)
        if self._phase is Phase.STEERING:
            self._steer(self._seen, share, now_s)
        elif self._phase is Phase.REGRIPPING:
            self._go_back(now_s)
        else:
            self._hand_m = self._body.idle_m(self._hand_m, _STEP_S)
            if self._phase is Phase.REACHING and self._may_grip(self._seen, now_s):
                self._grip(now_s)
            elif self._phase is Phase.FINISHED and self._has_slipped(self._seen):
                self._cue(now_s + self._model.grip_s)

    def _watch(self, seen: Sight) -> None:
        """Perceive a picture, and how fast the robot goes by itself."""
        before, self._seen = self._seen, seen
        if before is None or before.robot_um is None or seen.robot_um is None or seen.t_s <= before.t_s:
            return
        passed_s = seen.t_s - before.t_s
        velocity = (np.array(seen.robot_um) - np.array(before.robot_um)) / passed_s
        share = 1.0 - math.exp(-passed_s / _PURSUIT_S)
        self._pursued_um_per_s = self._pursued_um_per_s + share * (velocity - self._pursued_um_per_s)

    def _expect(self, share: float, now_s: float) -> None:
        """Expect of the autonomy, as far as it drives, that the robot goes on as it is seen to go."""
        if share > 0.0:
            self._moved_um.append((now_s, share * self._pursued_um_per_s * _STEP_S))

    def _heed(self, seen: Sight, now_s: float) -> None:
        """Follow the cues: the hand-over announced, the hand-over, the go, and a rig that stands still."""
        model, armed = self._model, seen.mode is Mode.MANUAL
        if seen.mode is Mode.AUTO:
            self._autonomy_seen = True
            if seen.handover_in_s is None:
                self._phase, self._cued = Phase.WATCHING, False
            elif not self._cued:
                self._cue(now_s + model.reaction_s + model.grip_s)
        elif armed and not self._cued and self._phase is Phase.WATCHING:
            if self._autonomy_seen:
                self._cue(now_s + model.reaction_s + model.grip_s)
            elif self._condition == "without_autonomy":
                self._cue(now_s + model.start_s)
        elif seen.mode is Mode.HOLD and self._phase in HOLDING and seen.t_s > self._gripped_s + _LOOK_S:
            self._cue(now_s + model.reaction_s + model.grip_s)
        elif not armed and seen.mode is not Mode.HOLD:
            self._phase = Phase.WATCHING
            self._cued = self._autonomy_seen = False

    def _cue(self, due_s: float) -> None:
        self._phase, self._due_s, self._cued = Phase.REACHING, due_s, True

    def _may_grip(self, seen: Sight, now_s: float) -> bool:
        model = self._model
        if now_s < self._due_s or self._route is None:
            return False
        if seen.mode is Mode.AUTO:
            # Ready early: control should have come by now.
            late_s = now_s - seen.t_s - model.patience_s
            return seen.handover_in_s is not None and seen.handover_in_s <= late_s
        return True

    def _grip(self, now_s: float) -> None:
        self._phase, self._gripped_s = Phase.STEERING, now_s
        self._gripped_m = self._hand_m.copy()
        self._content_since_s: float | None = None
        self._begin_movement(now_s)

    def _begin_movement(self, now_s: float) -> None:
        self._from_m_per_s = self._to_m_per_s = np.zeros(2)
        self._course: tuple[float, float, float] | None = None
        self._course_um = 0.0
        self._planned_s, self._next_s = now_s, now_s

    def _steer(self, seen: Sight, share: float, now_s: float) -> None:
        model, route = self._model, self._route
        if route is None:
            return
        if self._is_content(seen, route):
            self._phase, self._let_go_s = Phase.FINISHED, now_s
            return
        if now_s >= self._next_s:
            self._plan(seen, route, now_s)
        velocity = self._velocity_m_per_s(now_s)
        step_um = 1e6 * model.gain * velocity * _STEP_S
        self._course_um += float(np.hypot(*step_um))
        self._hand_m = self._hand_m + velocity * _STEP_S
        self._moved_um.append((now_s, share * step_um))
        stretched_m = float(np.hypot(*(self._hand_m - self._gripped_m)))
        soon_m = float(np.hypot(*(self._hand_m + 0.25 * velocity - self._gripped_m)))
        if soon_m > model.reach_m and stretched_m > 0.8 * model.reach_m:
            self.regrips += 1
            self._phase, self._due_s = Phase.REGRIPPING, now_s + model.grip_s / 2
            self._back_from_m = self._hand_m.copy()
            ahead_um = self._along_um + 1500.0 if self._along_um is not None else route.length_um
            self._back_to_m = self._gripped_m - 0.75 * model.reach_m * route.tangent(ahead_um)

    def _go_back(self, now_s: float) -> None:
        share = min(max((now_s - self._due_s) / self._model.regrip_s, 0.0), 1.0)
        self._hand_m = self._back_from_m + (self._back_to_m - self._back_from_m) * _minimum_jerk(share)
        if now_s >= self._due_s + self._model.regrip_s + self._model.grip_s / 2:
            gripped_m = self._gripped_m
            self._grip(now_s)
            self._gripped_m = gripped_m

    def _velocity_m_per_s(self, now_s: float) -> FloatArray:
        share = min(max((now_s - self._planned_s) / self._model.blend_s, 0.0), 1.0)
        wanted = self._wanted_m_per_s()
        velocity: FloatArray = self._from_m_per_s + (wanted - self._from_m_per_s) * _minimum_jerk(share)
        return velocity

    def _wanted_m_per_s(self) -> FloatArray:
        """Return the movement under way; on the route it bends with it as far as the operator means to go."""
        if self._course is None or self._route is None:
            return self._to_m_per_s
        forward, sideways, turn = self._course
        tx, ty = self._route.tangent(self._course_um + 100.0)
        x, y = forward * tx - sideways * ty, forward * ty + sideways * tx
        c, s = math.cos(turn), math.sin(turn)
        return np.array([c * x - s * y, s * x + c * y]) * 1e-6 / self._model.gain

    def _plan(self, seen: Sight, route: Route, now_s: float) -> None:
        """Intend a new movement from the percept and what the hand did since."""
        model, rng = self._model, self._rng
        self._from_m_per_s = self._velocity_m_per_s(now_s)
        self._planned_s = now_s
        self._next_s = now_s + model.interval_s * max(0.5, 1.0 + model.interval_spread * rng.normal())
        loudness = max(0.2, 1.0 + model.speed_noise * rng.normal())
        turn = model.direction_noise_rad * rng.normal()
        blur_um = model.vision_um * rng.normal(size=2)
        if seen.robot_um is None:
            self._course, self._to_m_per_s = None, np.zeros(2)
            return
        robot_um = np.array(seen.robot_um) + blur_um + model.prediction * self._underway_um(now_s)
        self._along_um = along_um = route.project(robot_um, self._along_um)
        left_um = route.length_um - along_um
        to_target_um = route.target_um - robot_um
        distance_um = float(np.hypot(*to_target_um))
        room_um = route.clearance_um(along_um, along_um)
        offset_um = route.offset_um(robot_um, along_um)
        speed = max(
            2.0 * route.clearance_um(along_um, along_um + model.preview_um) / model.steering_s,
            model.slowest_um_per_s,
        )
        speed = min(speed, 1e6 * model.fastest_hand_m_per_s * model.gain)
        if left_um < model.careful_um:
            speed *= model.careful_share
        if left_um < 2000.0:
            speed = min(speed, distance_um / model.homing_s + 100.0)
        if abs(offset_um) > 0.6 * room_um:
            speed *= model.cautious_share
        if left_um < _HOMING_UM:
            speed = min(speed, model.crossover_per_s * distance_um)
            if distance_um <= model.content_um:
                speed = 0.0
            towards = to_target_um / max(distance_um, 1e-9)
            self._course, self._to_m_per_s = None, towards * speed * loudness * 1e-6 / model.gain
            return
        speed = max(speed, model.slowest_um_per_s) * loudness
        dead_um = model.dead_zone * room_um
        excess_um = offset_um - min(max(offset_um, -dead_um), dead_um)
        sideways = min(max(-model.crossover_per_s * excess_um, -0.7 * speed), 0.7 * speed)
        self._course, self._course_um = (speed, sideways, turn), along_um

    def _underway_um(self, now_s: float) -> FloatArray:
        """Return what hand and autonomy have asked of the robot that the percept cannot show yet."""
        since_s = now_s - self._model.visual_delay_s - self._model.system_delay_s
        while self._moved_um and self._moved_um[0][0] < since_s:
            self._moved_um.popleft()
        return sum((step_um for _, step_um in self._moved_um), np.zeros(2))

    def _is_content(self, seen: Sight, route: Route) -> bool:
        if _distance_um(seen, route) > self._model.content_um:
            self._content_since_s = None
            return False
        self._content_since_s = seen.t_s if self._content_since_s is None else self._content_since_s
        return seen.t_s - self._content_since_s >= self._model.content_s

    def _has_slipped(self, seen: Sight) -> bool:
        looked = seen.t_s > self._let_go_s + _LOOK_S and seen.robot_um is not None
        return looked and self._route is not None and _distance_um(seen, self._route) > _FAR_UM


def _distance_um(seen: Sight, route: Route) -> float:
    """Return how far the displayed robot is from the target; infinite while it is not seen."""
    if seen.robot_um is None:
        return math.inf
    return math.dist(seen.robot_um, route.target_um)


def _minimum_jerk(share: float) -> float:
    """Return the travelled share of a minimum-jerk reach after a share of its time (Flash & Hogan 1985)."""
    return share**3 * (10 + share * (6 * share - 15))
