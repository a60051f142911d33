"""The simulated operator: what it sees is late, what it gives is a fingertip pose.

It exercises the software over the real sockets and is no evidence about people. It takes over where the
autonomy arrives and brings the robot to the critical area's centre by small deliberate pushes: push along
the error, wait, look, push again. Anything faster fails, for the robot sticks and then jumps (docs/study.md).
"""

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum

import numpy as np

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.frames import HandPoint
from mrnav_server.core.modes import Mode

POSES_HZ = 30
"""Different poses a second that the headset tracks."""
MESSAGES_HZ = 60
"""Hand messages a second that it sends."""


@dataclass(frozen=True, slots=True)
class OperatorModel:
    """What the simulated operator is like. It says these numbers in its ``hello``.

    Attributes:
        gain: τ that the operator reckons with, tip motion per hand motion.
        visual_delay_s: From the picture to the percept (Saunders & Knill 2005).
        reaction_s: From the hand-over's cue to reaching out.
        grip_s: Closing the clutch.
        tremor_m: RMS of the finger's physiological tremor per axis, 8 to 12 Hz (Growdon 2000).
        sway_m: RMS of posture and tracker drift per axis, 0.05 to 0.4 Hz.
        push_um: First length of a deliberate push, of the tip; it grows while the robot sticks.
        longest_push_um: Bound of that growth; a robot that jumps past the centre lowers it.
        push_s: How long a push takes.
        look_s: Pause after a push, on top of the visual delay.
        content_um: Robot's distance to the centre that the operator is content with.
        content_after_jump_um: The same, once the robot has jumped past the centre.
        content_s: How long it must hold.
        reach_m: Hand's distance from its rest at which the operator grips anew.
        regrip_s: Duration of the way back.
    """

    gain: float = 0.04
    visual_delay_s: float = 0.18
    reaction_s: float = 0.6
    grip_s: float = 0.2
    tremor_m: float = 1e-4
    sway_m: float = 2e-4
    push_um: float = 80.0
    longest_push_um: float = 180.0
    push_s: float = 0.25
    look_s: float = 0.2
    content_um: float = 80.0
    content_after_jump_um: float = 125.0
    content_s: float = 0.5
    reach_m: float = 0.15
    regrip_s: float = 0.8


@dataclass(frozen=True, slots=True)
class Sight:
    """One picture on the operator's display.

    Attributes:
        t_s: When it lit up.
        mode: The mode shown.
        robot_um: Displayed robot, stage x, y in µm; None while it is not tracked.
        target_um: The critical area's centre, stage x, y in µm; None without one.
    """

    t_s: float
    mode: Mode
    robot_um: tuple[float, float] | None
    target_um: tuple[float, float] | None


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
    """Has seen the hand-over, and is closing the clutch."""
    LOOKING = "looking"
    """Clutch closed, hand at rest, waiting for the picture to tell what the last push did."""
    PUSHING = "pushing"
    """One push under way."""
    REGRIPPING = "regripping"
    """Clutch open, hand on its way back to its rest."""
    FINISHED = "finished"
    """Content with the robot's place; clutch open."""


class SimulatedOperator:
    """Decides the fingertip's pose from what the display has shown. Never waits, reads no clock.

    Args:
        model: What the operator is like.
        seed: Seeds tremor and sway; the same sights then give the same poses.
    """

    def __init__(self, model: OperatorModel, seed: int) -> None:
        self._model = model
        rng = np.random.default_rng(seed)
        self._tremor = _Wobble(rng, model.tremor_m, 8.0, 12.0)
        self._sway = _Wobble(rng, model.sway_m, 0.05, 0.4)
        self._shown: deque[Sight] = deque()
        self._seen: Sight | None = None
        self._phase = Phase.WATCHING
        self._phase_s = -math.inf
        self._autonomy_seen = False
        self._pose: HandPose | None = None
        # The deliberate hand, x and y as in the stage, in metres.
        self._hand_m = np.zeros(2)
        self._from_m = np.zeros(2)
        self._to_m = np.zeros(2)
        self._begin()

    @property
    def phase(self) -> Phase:
        """What the operator is doing."""
        return self._phase

    def see(self, sight: Sight) -> None:
        """Take a picture that lights up on the display now; the operator perceives it later."""
        self._shown.append(sight)

    def hand(self, now_s: float) -> HandPose:
        """Return the headset's newest pose; between two poses it repeats itself."""
        number = math.floor(now_s * POSES_HZ)
        if self._pose is None or number > self._pose.number:
            self._perceive(now_s)
            self._decide(now_s)
            x_m, y_m, up_m = self._fingertip_m(now_s)
            self._pose = HandPose(number, HandPoint(x_m, up_m, y_m), self._clutch())
        return self._pose

    def _fingertip_m(self, now_s: float) -> tuple[float, float, float]:
        involuntary = self._tremor(now_s) + self._sway(now_s)
        x_m, y_m = self._hand_m + involuntary[:2]
        return float(x_m), float(y_m), float(involuntary[2])

    def _clutch(self) -> bool:
        return self._phase in (Phase.LOOKING, Phase.PUSHING)

    def _perceive(self, now_s: float) -> None:
        while self._shown and self._shown[0].t_s <= now_s - self._model.visual_delay_s:
            self._seen = self._shown.popleft()

    def _begin(self) -> None:
        """Forget the last task; the hand stays where it is."""
        self._push_um = self._model.push_um
        self._longest_push_um = self._model.longest_push_um
        self._pushed_from_um: FloatArray | None = None
        self._direction = np.zeros(2)
        self._jumped_past = False
        self._near_since_s: float | None = None

    def _enter(self, phase: Phase, now_s: float) -> None:
        self._phase, self._phase_s = phase, now_s

    def _decide(self, now_s: float) -> None:
        if self._seen is None:
            return
        mode = self._seen.mode
        if mode not in (Mode.MANUAL, Mode.HOLD):
            self._autonomy_seen = mode is Mode.AUTO
            self._begin()
            self._enter(Phase.WATCHING, now_s)
            return
        if mode is Mode.HOLD and self._clutch():
            self._enter(Phase.REACHING, now_s)
        since_s = now_s - self._phase_s
        if self._phase is Phase.WATCHING and mode is Mode.MANUAL and self._autonomy_seen:
            self._enter(Phase.REACHING, now_s)
        elif self._phase is Phase.REACHING and since_s >= self._model.reaction_s + self._model.grip_s:
            self._enter(Phase.LOOKING, now_s)
        elif self._phase is Phase.LOOKING:
            self._look(self._seen, now_s)
        elif self._phase is Phase.PUSHING:
            self._move(now_s, self._model.push_s, Phase.LOOKING)
        elif self._phase is Phase.REGRIPPING:
            self._move(now_s, self._model.regrip_s, Phase.LOOKING)

    def _look(self, seen: Sight, now_s: float) -> None:
        """Judge the percept once it shows the end of the last push; then stop, grip anew or push."""
        model = self._model
        if seen.robot_um is None or seen.target_um is None or seen.t_s < self._phase_s + model.look_s:
            return
        robot_um = np.array(seen.robot_um)
        error_um = np.array(seen.target_um) - robot_um
        distance_um = float(np.hypot(*error_um))
        if distance_um <= (model.content_after_jump_um if self._jumped_past else model.content_um):
            self._near_since_s = seen.t_s if self._near_since_s is None else self._near_since_s
            if seen.t_s - self._near_since_s >= model.content_s:
                self._enter(Phase.FINISHED, now_s)
            return
        self._near_since_s = None
        self._learn(robot_um, error_um)
        if np.hypot(*self._hand_m) > model.reach_m:
            self._start(Phase.REGRIPPING, np.zeros(2), now_s)
            return
        self._direction = error_um / distance_um
        self._pushed_from_um = robot_um
        self._start(Phase.PUSHING, self._hand_m + 1e-6 * self._push_um * self._direction / model.gain, now_s)

    def _learn(self, robot_um: FloatArray, error_um: FloatArray) -> None:
        """Push longer while the robot sticks, short again once it has moved."""
        model = self._model
        if self._pushed_from_um is None:
            return
        if np.hypot(*(robot_um - self._pushed_from_um)) < model.push_um / 2:
            self._push_um = min(1.3 * self._push_um, self._longest_push_um)
            return
        self._push_um = model.push_um
        if float(error_um @ self._direction) < 0.0:
            self._jumped_past = True
            self._longest_push_um = max(0.8 * self._longest_push_um, model.push_um)

    def _start(self, phase: Phase, to_m: FloatArray, now_s: float) -> None:
        self._from_m, self._to_m = self._hand_m.copy(), to_m
        self._enter(phase, now_s)

    def _move(self, now_s: float, duration_s: float, then: Phase) -> None:
        share = min((now_s - self._phase_s) / duration_s, 1.0)
        self._hand_m = self._from_m + (self._to_m - self._from_m) * _minimum_jerk(share)
        if share >= 1.0:
            self._enter(then, now_s)


class _Wobble:
    """Involuntary motion: three axes of five sinusoids each, with an exact RMS."""

    def __init__(self, rng: np.random.Generator, rms: float, lowest_hz: float, highest_hz: float) -> None:
        # One frequency in each fifth of the band, so that no two of them beat slowly.
        shares = (np.arange(5) + rng.uniform(0.25, 0.75, (3, 5))) / 5
        self._w = 2 * math.pi * (lowest_hz + shares * (highest_hz - lowest_hz))
        self._phase = rng.uniform(0.0, 2 * math.pi, (3, 5))
        self._size = rms * math.sqrt(2.0 / 5.0)

    def __call__(self, now_s: float) -> FloatArray:
        """Return the displacement of each axis, shape (3,)."""
        swings: FloatArray = self._size * np.sin(self._w * now_s + self._phase).sum(axis=1)
        return swings


def _minimum_jerk(share: float) -> float:
    """Return the travelled share of a minimum-jerk reach after a share of its time (Flash & Hogan 1985)."""
    return share**3 * (10 + share * (6 * share - 15))
