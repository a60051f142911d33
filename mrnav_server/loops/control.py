"""The control loop: facts → settle the mode → wish (hand or policy) → limit → shape → the manipulator.

The only caller of ``move_to`` and ``stop``. ``step`` is plain and is told the time; it runs at every tick,
and at once when a hand sample or an ask arrives.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mrnav_server.core.errors import DeviceError, RefusedError
from mrnav_server.core.frames import Calibration, StagePoint, VesselPoint
from mrnav_server.core.hand import HandControl
from mrnav_server.core.lease import Lease
from mrnav_server.core.limits import Limits, allowed_target
from mrnav_server.core.modes import ARMED, LATCHED, Ask, Facts, Mode, ModeMachine, Transition
from mrnav_server.core.records import CriticalArea, TipReading, Track, TrackState
from mrnav_server.core.shaping import Reference, Shaper
from mrnav_server.core.vessel import VesselMap
from mrnav_server.devices.base import Manipulator
from mrnav_server.loops.autopilot import Autopilot
from mrnav_server.loops.guards import (
    GuardConfig,
    arm_refusal,
    coupling_refusal,
    tip_fault,
    track_refusal,
)
from mrnav_server.loops.stopping import Stopping
from mrnav_server.loops.timing import RollingLatency
from mrnav_server.loops.tip_watch import TipWatch

Log = Callable[[str, dict[str, Any]], None]

_SETTLE_S = 0.5
"""A tip that has not come to rest this long after its setpoint counts as noise, or is driven by hand."""
_EDGE_UM = 10.0
"""The setpoint may come to rest this far outside; what is sent stays inside."""


@dataclass(frozen=True, slots=True)
class ControlConfig:
    """The control loop and the hand-over.

    Attributes:
        tick_s: Period of the loop, at most 10 ms.
        require_robot: Arrival needs the tracked robot inside the area too; False leaves the paper's formula,
            which looks at the end-effector alone.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    tick_s: float = 0.01
    require_robot: bool = True

    def __post_init__(self) -> None:
        if not 0.002 <= self.tick_s <= 0.01:
            raise ValueError("tick_s must lie between 0.002 and 0.01 s")


class ControlLoop:
    """Decides every motion of the rig.

    Args:
        config: Loop and hand-over.
        guards: Deadlines and bounds.
        limits: Bounds on motion.
        manipulator: Open before the first step.
        calibration: Frames and heights.
        vessel: The vessel model.
        lease: Who controls the rig.
        hand: The operator's hand.
        autopilot: Drives in AUTO.
        log: Called with a topic and a payload for every command.
        on_change: Called with every change of mode.
    """

    def __init__(
        self,
        config: ControlConfig,
        guards: GuardConfig,
        limits: Limits,
        manipulator: Manipulator,
        calibration: Calibration,
        vessel: VesselMap,
        lease: Lease,
        hand: HandControl,
        autopilot: Autopilot,
        log: Log,
        on_change: Callable[[Transition], None],
    ) -> None:
        self.machine = ModeMachine()
        self.shaper = Shaper(limits)
        self.hand_to_command = RollingLatency()
        self.generation = 0
        """Rises with every ask that is granted, closed clutch, change of mode and change of the goal."""
        self.counters = {"commands": 0, "clamped": 0, "non_finite": 0, "held_back": 0}
        self.recorder_fault: Callable[[], str] = lambda: ""
        self.supervisor_fault: Callable[[], str] = lambda: ""
        """Why nobody would stop the manipulator if this process died, or ""."""
        self.camera_fault: Callable[[], str] = lambda: ""
        """Why the camera's pictures must not be relied on, or ""."""
        self.drift_warning: Callable[[], str] = lambda: ""
        """That the vessel or the camera has moved, or ""."""
        self.drift_fault: Callable[[], str] = lambda: ""
        """The same, when it is too far for AUTO."""
        self.device_warnings: Callable[[], list[str]] = lambda: []
        """What the manipulator's driver has to say to the operator."""
        self.beat: Callable[[bool], None] = lambda moves: None
        """Called at every step, with whether the tip may be in motion."""
        self._config = config
        self._guards = guards
        self._limits = limits
        self._manipulator = manipulator
        self._calibration = calibration
        self._vessel = vessel
        self._lease = lease
        self._hand = hand
        self._autopilot = autopilot
        self._log = log
        self._tell_change = on_change
        self._watch = TipWatch(guards)
        self._stopping = Stopping(guards.tip_age_s)
        self._asks: list[Ask] = []
        self._track: Track | None = None
        self._seen: Track | None = None
        self._tip: TipReading | None = None
        self._area: CriticalArea | None = None
        self._tip_fault = ""
        self._move_fault = ""
        self._told_fault = ""
        self._supervised_by_hand = False
        self._stepped_s: float | None = None
        self._sample_s: float | None = None
        self._moved_s = -math.inf
        self._facts = Facts(leased=False, hand_fresh=False, clutch_closing=False, at_rest=True, arrived=False)

    @property
    def facts(self) -> Facts:
        """What was true at the last step."""
        return self._facts

    @property
    def tip(self) -> TipReading | None:
        """The newest tip reading."""
        return self._tip

    @property
    def track(self) -> Track | None:
        """The newest track, with or without a position."""
        return self._track

    @property
    def robot(self) -> VesselPoint | None:
        """Where the robot was last seen; None while it is lost."""
        if self._track is None or self._seen is None or self._track.state is TrackState.SEARCHING:
            return None
        return self._seen.vessel

    @property
    def area(self) -> CriticalArea | None:
        """The active critical area."""
        return self._area

    @property
    def setpoint(self) -> StagePoint | None:
        """What the tip is asked to be; None while nothing may move."""
        return self.shaper.position if self.machine.mode in ARMED else None

    @property
    def lead_um(self) -> float | None:
        """How far the magnet's hold point is from the robot."""
        robot, tip = self.robot, self._tip
        if robot is None or tip is None:
            return None
        return self._calibration.held_point(tip.position).distance_px(robot) * self._vessel.um_per_px

    @property
    def distance_um(self) -> float | None:
        """How far the robot is from the centre of the active area."""
        robot = self.robot
        if robot is None or self._area is None:
            return None
        return robot.distance_px(self._area.center) * self._vessel.um_per_px

    def on_track(self, track: Track) -> None:
        """Take a track; the next step uses it."""
        self._track = track
        if track.vessel is not None:
            self._seen = track

    def recalibrate(self, calibration: Calibration) -> None:
        """Go by another calibration; where the robot was seen under the old one is forgotten.

        Raises:
            RefusedError: Unless the rig is disarmed.
        """
        if self.machine.mode is not Mode.DISARMED:
            raise RefusedError("armed", "the rig is armed: disarm it first")
        self._calibration = calibration
        self._track = self._seen = None
        self.generation += 1

    def choose_area(self, area: CriticalArea | None) -> None:
        """Make an area the active one.

        Raises:
            RefusedError: While the policy drives to another one.
        """
        if self.machine.mode is Mode.AUTO:
            raise RefusedError("busy", "the policy is driving: hold first")
        self.generation += area != self._area
        self._area = area

    def on_hand(self, received_s: float, now_s: float) -> None:
        """Step at once for a fresh hand sample, and time it from the arrival of its line."""
        self._sample_s = received_s
        self.step(now_s)
        self._sample_s = None

    def check(self, ask: Ask, now_s: float) -> None:
        """Check an ask against the facts of this moment.

        Raises:
            RefusedError: If it would not be granted.
        """
        self._facts = self._gather(now_s)
        self.machine.check(ask, self._facts)

    def submit(self, ask: Ask, now_s: float) -> None:
        """Grant an ask in a step of its own.

        Raises:
            RefusedError: If it is not granted, with the reason.
        """
        self.check(ask, now_s)
        self.generation += 1
        self._asks.append(ask)
        self.step(now_s)

    def fail(self, reason: str) -> None:
        """Enter FAULT at the next step, until reset: somebody else stopped the manipulator.

        Args:
            reason: Who and why, for the operator.
        """
        self._told_fault = reason

    def step(self, now_s: float) -> None:
        """Read, settle the mode, and move or not.

        Args:
            now_s: Now, monotonic.
        """
        # Before anything else: the answer may be that this step comes too late to move anything.
        self._beat()
        dt_s = 0.0 if self._stepped_s is None else now_s - self._stepped_s
        self._stepped_s = now_s
        # A hand that comes into view closed takes over from the policy, but wakes nothing that rests.
        closing = self._hand.take_closing(anew=self.machine.mode is not Mode.AUTO)
        facts = self._gather(now_s, closing=closing)
        self._facts = facts
        self.generation += closing
        asks, self._asks = self._asks, []
        for change in self.machine.settle(asks, facts):
            self._on_change(change, now_s)
        mode = self.machine.mode
        if mode not in ARMED or self._tip is None:
            # FAULT has latched what failed; the next arming tries again.
            self._move_fault = self._told_fault = ""
            self._repeat_stop(now_s)
            return
        if mode is not Mode.AUTO:
            self._autopilot.watch(self._seen, self._tip)
        if mode is Mode.MANUAL and facts.clutch_closing and not self._hand.engaged:
            # Where the magnet comes to rest, so that the hand does not call it back.
            self._hand.engage(self.shaper.rest_point, now_s)
        self._move(dt_s, self._wish(mode, now_s), self._tip, now_s)

    def _gather(self, now_s: float, *, closing: bool = False) -> Facts:
        self._read_tip()
        self._lease.expire(now_s)
        lease = self._lease.state()
        if not lease.hand:
            self._hand.lose()
        fresh = self._hand.fresh(now_s)
        recorder_fault, supervisor_fault = self.recorder_fault(), self.supervisor_fault()
        return Facts(
            leased=self._lease.held,
            hand_fresh=fresh,
            clutch_closing=closing,
            at_rest=self._at_rest(now_s),
            arrived=self._arrived(),
            fault=self._fault(now_s),
            arm_refusal=(
                "the manipulator is being stopped: wait until it rests" if self._stopping.pending else ""
            )
            or arm_refusal(self._tip, self._limits, self._calibration, self._vessel)
            or recorder_fault
            or supervisor_fault,
            auto_refusal=self._auto_refusal(fresh, now_s) or recorder_fault or supervisor_fault,
            warning=recorder_fault
            or supervisor_fault
            or "; ".join(self.device_warnings())
            or self.camera_fault()
            or self.drift_warning()
            or track_refusal(self._track, self._seen, self._guards, now_s),
        )

    def _at_rest(self, now_s: float) -> bool:
        """Tell whether setpoint and tip stand still."""
        if self.machine.mode not in ARMED:
            return True
        if not self.shaper.at_rest:
            self._moved_s = now_s
            return False
        return self._tip is None or not self._tip.moving or now_s - self._moved_s > _SETTLE_S

    def _fault(self, now_s: float) -> str:
        """Return why the tip must not move at all, or ""."""
        told = self._told_fault or self._tip_fault or self._move_fault
        if told or self._tip is None:
            return told
        fault = tip_fault(self._tip, self._guards, now_s)
        if not fault and self.machine.mode in ARMED:
            fault = self._watch.fault(self._tip)
        return fault

    def _auto_refusal(self, hand_fresh: bool, now_s: float) -> str:
        """Return the first guard of AUTO that is not satisfied, or ""."""
        if self._supervised_by_hand and not hand_fresh:
            return "nobody supervises: the hand is silent"
        supervised = hand_fresh or self._lease.console_heard_within(self._guards.console_s, now_s)
        return (
            ("" if self._lease.held else "nobody controls the rig: take the lease first")
            or ("" if supervised else "nobody supervises: neither hand nor console is heard")
            or self.camera_fault()
            or self.drift_fault()
            or track_refusal(self._track, self._seen, self._guards, now_s)
            or coupling_refusal(self.lead_um, self._guards)
            or ("" if self._area else "no critical area is chosen: mark one first")
            or self._autopilot.refusal
            or (self._gave_up(now_s) if self.machine.mode is Mode.AUTO else "")
        )

    def _gave_up(self, now_s: float) -> str:
        """Return why the policy cannot go on, or ""."""
        away_um = self.distance_um
        if self._autopilot.at_target and away_um is not None and not self._arrived():
            return f"the robot rests {away_um:.0f} µm from the centre, outside the area: go on by hand"
        return self._autopilot.stuck(now_s)

    def _arrived(self) -> bool:
        """Tell whether |P_s − P_critical| ≤ ε holds, on the tip and (by setting) on the robot."""
        if self._area is None or self._tip is None or self.machine.mode is not Mode.AUTO:
            return False
        held = self._calibration.held_point(self._tip.position)
        tip_um = held.distance_px(self._area.center) * self._vessel.um_per_px
        robot_um = self.distance_um
        robot_there = robot_um is not None and robot_um <= self._area.epsilon_um
        if self._autopilot.at_target:
            # At rest the friction lead may keep the tip outside a small area for ever.
            return robot_there
        return tip_um <= self._area.epsilon_um and (robot_there or not self._config.require_robot)

    def _on_change(self, change: Transition, now_s: float) -> None:
        self.generation += 1
        if change.before is Mode.AUTO:
            self._autopilot.end()
        if change.after in (Mode.STOP, Mode.FAULT):
            self._manipulator.stop()
            self._stopping.begin(now_s)
        if change.before not in ARMED and change.after in ARMED and self._tip is not None:
            self.shaper.reset(self._tip.position)
            self._watch.begin(self._tip)
            self._stopping.end()
            self._beat()
        if change.after is not Mode.MANUAL:
            self._hand.release()
        # Whoever began AUTO must stay: a console does not stand in for a hand that was lost on the way.
        self._supervised_by_hand = change.after is Mode.AUTO and self._facts.hand_fresh
        if change.after is Mode.AUTO and self._seen is not None and self._tip is not None:
            self._autopilot.begin(self._seen, self._tip, now_s)
        self._tell_change(change)

    def _wish(self, mode: Mode, now_s: float) -> Reference | None:
        """Return where the mode wants the tip, limited; None to come to rest."""
        wish = None
        if mode is Mode.MANUAL:
            wish = self._hand.reference(now_s)
        elif mode is Mode.AUTO and self._tip is not None:
            wish = self._autopilot.reference(self._seen, self._tip, self.shaper.position.z_um, now_s)
        if wish is None:
            return None
        if not wish.finite:
            self.counters["non_finite"] += 1
            return None
        rest = self.shaper.rest_point
        kept = self._allowed(rest)
        if _distance_um(kept, rest) > _EDGE_UM:
            # Whoever waits until the setpoint is at the edge can no longer stop there: aim back inside.
            target = _mirrored(rest, kept)
        else:
            target = self._allowed(wish.position)
        if target == wish.position:
            return wish
        self.counters["clamped"] += 1
        return Reference(target, (0.0, 0.0, 0.0), wish.speed_um_per_s)

    def _move(self, dt_s: float, reference: Reference | None, tip: TipReading, now_s: float) -> None:
        before = self.shaper.position
        top_um_per_s = max(self._limits.speed_um_per_s, self._limits.autonomy_speed_um_per_s)
        ahead_um = top_um_per_s * self._limits.ahead_s
        if self._gap_um() > ahead_um and reference is not None:
            self.counters["held_back"] += 1
            reference = None
        wished = self.shaper.step(dt_s, reference)
        if wished == before:
            return
        target = self._allowed(_towards(wished, tip.position, ahead_um))
        gap_um = _distance_um(target, tip.position)
        # Fast enough to close the gap in half the time that the setpoint may be ahead.
        speed_um_per_s = min(
            max(self.shaper.speed_um_per_s + 2.0 * gap_um / self._limits.ahead_s, 50.0), 1.2 * top_um_per_s
        )
        try:
            sent = self._manipulator.move_to(target, speed_um_per_s, now_s)
        except DeviceError as error:
            self._move_fault = f"manipulator: {error}"
            return
        self._watch.sent(sent)
        self.counters["commands"] += 1
        if self._sample_s is not None:
            self.hand_to_command.add(sent.sent_s - self._sample_s)
        self._log(
            "command",
            {
                "sent_s": sent.sent_s,
                "target_um": [round(v, 3) for v in (sent.target.x_um, sent.target.y_um, sent.target.z_um)],
                "tip_um": [round(v, 3) for v in (tip.position.x_um, tip.position.y_um, tip.position.z_um)],
                "speed_um_per_s": round(sent.speed_um_per_s, 1),
                "ahead_ms": round(1000.0 * gap_um / sent.speed_um_per_s, 2),
                "mode": self.machine.mode.value,
            },
        )

    def _allowed(self, point: StagePoint) -> StagePoint:
        return allowed_target(point, self._limits, self._calibration, self._vessel)

    def _repeat_stop(self, now_s: float) -> None:
        """Stop again while the tip moves, or nobody knows whether it does."""
        tip = None if self._tip_fault else self._tip
        if self._stopping.due(tip, now_s, latched=self.machine.mode in LATCHED):
            self._manipulator.stop()

    def _beat(self) -> None:
        self.beat(self.machine.mode in ARMED or self._stopping.pending)

    def _read_tip(self) -> None:
        try:
            self._tip = self._manipulator.tip()
            self._tip_fault = ""
        except DeviceError as error:
            self._tip_fault = f"manipulator: {error}"

    def _gap_um(self) -> float:
        return _distance_um(self.shaper.position, self._tip.position) if self._tip is not None else 0.0


def _distance_um(a: StagePoint, b: StagePoint) -> float:
    return math.hypot(a.x_um - b.x_um, a.y_um - b.y_um, a.z_um - b.z_um)


def _mirrored(point: StagePoint, at: StagePoint) -> StagePoint:
    return StagePoint(2 * at.x_um - point.x_um, 2 * at.y_um - point.y_um, 2 * at.z_um - point.z_um)


def _towards(target: StagePoint, tip: StagePoint, most_um: float) -> StagePoint:
    """Return the target, or the place on the way there that is ``most_um`` from the tip."""
    gap_um = _distance_um(target, tip)
    if gap_um <= most_um:
        return target
    share = most_um / gap_um
    return StagePoint(
        tip.x_um + share * (target.x_um - tip.x_um),
        tip.y_um + share * (target.y_um - tip.y_um),
        tip.z_um + share * (target.z_um - tip.z_um),
    )
