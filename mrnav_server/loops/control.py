"""The control loop: facts → settle the mode → wish (hand, policy or both) → limit → shape → the manipulator.

``step`` is plain and is told the time; it runs at every tick, and at once for a hand sample or an ask.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from mrnav_server.core.errors import DeviceError, RefusedError
from mrnav_server.core.frames import Calibration, StagePoint
from mrnav_server.core.hand import HandControl
from mrnav_server.core.lease import Lease
from mrnav_server.core.limits import Limits
from mrnav_server.core.modes import ARMED, LATCHED, Ask, Facts, Mode, ModeMachine, Transition
from mrnav_server.core.records import CriticalArea
from mrnav_server.core.shaping import Reference
from mrnav_server.core.vessel import VesselMap
from mrnav_server.devices.base import Manipulator
from mrnav_server.loops.autopilot import Autopilot
from mrnav_server.loops.coast import steps
from mrnav_server.loops.descent import Descent
from mrnav_server.loops.drive import Drive, Log
from mrnav_server.loops.errand import Errand
from mrnav_server.loops.guards import (
    GuardConfig,
    arm_refusal,
    coupling_refusal,
    tip_fault,
    track_refusal,
)
from mrnav_server.loops.handover import Blend, HandoverConfig
from mrnav_server.loops.scene import Scene
from mrnav_server.loops.sharing import Sharing
from mrnav_server.loops.stopping import Stopping
from mrnav_server.loops.surroundings import Outlook, Surroundings
from mrnav_server.loops.timing import RollingLatency


@dataclass(frozen=True, slots=True)
class ControlConfig:
    """The control loop.

    Attributes:
        tick_s: Period of the loop, at most 10 ms.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    tick_s: float = 0.01

    def __post_init__(self) -> None:
        if not 0.002 <= self.tick_s <= 0.01:
            raise ValueError("tick_s must lie between 0.002 and 0.01 s")


class ControlLoop:
    """Decides every motion of the rig.

    Args:
        handover: How the operator gets control back.
        guards: Deadlines and bounds.
        limits: Bounds on motion.
        manipulator: Open before the first step.
        calibration: Frames and heights.
        vessel: The vessel model.
        lease: Who controls the rig.
        hand: The operator's hand.
        autopilot: Drives in AUTO.
        log: Called with a topic and a payload for everything that a replay needs: what the loop is fed with,
            and what it decides (docs/recording.md).
        on_change: Called with every change of mode.
    """

    def __init__(
        self,
        handover: HandoverConfig,
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
        self.scene = Scene(calibration, vessel)
        self.drive = Drive(limits, guards, manipulator, calibration, vessel, log)
        self.surroundings = Surroundings()
        self.errand = Errand(limits)
        self.hand_to_command = RollingLatency()
        self.generation = 0
        """Rises with every ask that is granted, closed clutch, change of mode and change of the goal."""
        self._handover = handover
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
        self._descent = Descent(autopilot.height, calibration)
        self._stopping = Stopping(guards.tip_age_s)
        self._asks: list[Ask] = []
        self._outlook = Outlook()
        self._stepping = False
        self._tip_fault = ""
        self._told_fault = ""
        self._supervised_by_hand = False
        self._announced = False
        self._blend: Blend | None = None
        self._sharing: Sharing | None = None
        self._stepped_s: float | None = None
        self._sample_s: float | None = None
        self._facts = Facts(leased=False, hand_fresh=False, clutch_closing=False, at_rest=True, arrived=False)

    @property
    def facts(self) -> Facts:
        """What was true at the last step."""
        return self._facts

    @property
    def outlook(self) -> Outlook:
        """What everybody outside said at the last step."""
        return self._outlook

    @property
    def setpoint(self) -> StagePoint | None:
        """What the tip is asked to be; None while nothing may move."""
        return self.drive.shaper.position if self.machine.mode in ARMED else None

    def authority(self, now_s: float) -> float:
        """Return the hand's share of control: 0 while the policy drives alone, 1 for the hand alone."""
        if self.machine.mode is Mode.AUTO:
            return self._sharing.authority if self._sharing is not None else 0.0
        return self._blend.authority(now_s) if self._blend is not None else 1.0

    def recalibrate(self, calibration: Calibration) -> None:
        """Go by another calibration; where the robot was seen under the old one is forgotten.

        Raises:
            RefusedError: Unless the rig is disarmed.
        """
        if self.machine.mode is not Mode.DISARMED:
            raise RefusedError("armed", "the rig is armed: disarm it first")
        self._calibration = calibration
        self.scene.recalibrate(calibration)
        self.drive.recalibrate(calibration)
        self._descent.recalibrate(calibration)
        self.generation += 1

    def choose_area(self, area: CriticalArea | None) -> None:
        """Make an area the active one.

        Raises:
            RefusedError: While the policy drives to another one.
        """
        if self.machine.mode is Mode.AUTO:
            raise RefusedError("busy", "the policy is driving: hold first")
        self.generation += area != self.scene.area
        self.scene.area = area
        self._log("area", {"within_step": self._stepping, **_area_fields(area)})

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
        self._check(ask, now_s, submitted=False)

    def submit(self, ask: Ask, now_s: float) -> None:
        """Grant an ask in a step of its own.

        Raises:
            RefusedError: If it is not granted, with the reason.
        """
        self._check(ask, now_s, submitted=True)
        self.generation += 1
        self._asks.append(ask)
        self.step(now_s)

    def fail(self, reason: str) -> None:
        """Enter FAULT at the next step, until reset: somebody else stopped the manipulator.

        Args:
            reason: Who and why, for the operator.
        """
        self._told_fault = reason
        self._log("fail", {"reason": reason})

    def step(self, now_s: float) -> None:
        """Read, settle the mode, and move or not.

        Args:
            now_s: Now, monotonic.
        """
        # Before anything else: the answer may be that this step comes too late to move anything.
        self._beat()
        self._stepping = True
        try:
            self._decide(now_s)
        finally:
            self._stepping = False

    def _decide(self, now_s: float) -> None:
        dt_s = 0.0 if self._stepped_s is None else now_s - self._stepped_s
        self._stepped_s = now_s
        # A hand that comes into view closed takes over from the policy, but wakes nothing that rests.
        closing = (
            self._hand.take_closing(anew=self.machine.mode is not Mode.AUTO) and not self.errand.reserved
        )
        self.errand.look()
        self.drive.elsewhere = self.errand.kept if self.errand.reserved else None
        if self.machine.mode is Mode.AUTO and self._handover.sharing.enabled:
            closing = self._share(closing=closing, now_s=now_s)
        facts = self._gather(now_s, closing=closing)
        by = "ask" if self._asks else "tick" if self._sample_s is None else "hand"
        self._log("step", {"now_s": now_s, "by": by, **self._tip_fields()})
        self._facts = facts
        self.generation += closing
        asks, self._asks = self._asks, []
        for change in self.machine.settle(asks, facts):
            self._on_change(change, now_s)
        mode, tip = self.machine.mode, self.scene.tip
        if mode not in ARMED or tip is None:
            # FAULT has latched what failed; the next arming tries again.
            self.drive.fault = self._told_fault = ""
            self._repeat_stop(now_s)
            return
        if mode is not Mode.AUTO:
            self._autopilot.watch(self.scene.seen, tip)
        if mode is Mode.MANUAL and facts.clutch_closing and not self._hand.engaged:
            # Where the magnet comes to rest, so that the hand does not call it back.
            self._hand.engage(self.drive.shaper.rest_point, now_s)
        wish = self._wish(mode, now_s)
        reference = self.drive.limited(wish) if wish is not None else None
        sent = self.drive.follow(dt_s, reference, tip, now_s, mode)
        if sent is not None and self._sample_s is not None:
            self.hand_to_command.add(sent.sent_s - self._sample_s)

    def _share(self, *, closing: bool, now_s: float) -> bool:
        """Let a hand whose clutch closes deflect the policy; return whether it has taken over."""
        if closing and self._sharing is None:
            self._hand.engage(self.drive.shaper.rest_point, now_s)
            zero = self._hand.reference(now_s)
            self._sharing = Sharing(self._handover.sharing, zero, now_s) if zero is not None else None
        elif self._sharing is not None and not self._hand.engaged:
            self._sharing = None
        elif self._sharing is not None and self._sharing.taken_over:
            self._hand.release()
            return True
        return False

    def _check(self, ask: Ask, now_s: float, *, submitted: bool) -> None:
        self._facts = self._gather(now_s)
        refused = ""
        try:
            self.machine.check(ask, self._facts)
            self.errand.told(ask)
        except RefusedError as error:
            refused = str(error)
            raise
        finally:
            fields = {"now_s": now_s, "ask": ask.value, "submitted": submitted, "refused": refused}
            self._log("ask", fields | self._tip_fields())

    def _gather(self, now_s: float, *, closing: bool = False) -> Facts:
        self._read_tip()
        around = self.surroundings.look(self._lease, self._guards.console_s, now_s)
        if around != self._outlook:
            self._outlook = around
            self._log("around", asdict(around))
        if not around.hand_seated:
            self._hand.lose()
        fresh = self._hand.fresh(now_s) and not self.errand.reserved
        scene = self.scene
        return Facts(
            leased=around.leased,
            hand_fresh=fresh,
            clutch_closing=closing,
            at_rest=self._at_rest(now_s),
            arrived=self._arrived(),
            hand_drives=self.machine.mode is Mode.MANUAL and self._hand.engaged,
            fault=self._fault(now_s),
            arm_refusal=(
                "the manipulator is being stopped: wait until it rests" if self._stopping.pending else ""
            )
            or self._arm_refusal()
            or around.recorder_fault
            or around.supervisor_fault,
            auto_refusal=self._auto_refusal(fresh, now_s) or around.recorder_fault or around.supervisor_fault,
            warning=around.recorder_fault
            or around.supervisor_fault
            or around.device_warnings
            or around.camera_fault
            or around.drift_warning
            or track_refusal(scene.track, scene.seen, self._guards, now_s),
        )

    def _arm_refusal(self) -> str:
        """Return why the tip must not be set in motion from where it is, or ""."""
        if self.errand.reserved:
            return self.errand.arm_refusal(self.scene.tip)
        return arm_refusal(self.scene.tip, self._limits, self._calibration, self._vessel)

    def _at_rest(self, now_s: float) -> bool:
        """Tell whether setpoint and tip stand still."""
        return self.machine.mode not in ARMED or self.drive.at_rest(self.scene.tip, now_s)

    def _fault(self, now_s: float) -> str:
        """Return why the tip must not move at all, or ""."""
        tip = self.scene.tip
        told = self._told_fault or self._tip_fault or self.drive.fault
        if told or tip is None:
            return told
        fault = tip_fault(tip, self._guards, now_s)
        if not fault and self.machine.mode in ARMED:
            fault = self.drive.disobedience(tip)
        return fault

    def _auto_refusal(self, hand_fresh: bool, now_s: float) -> str:
        """Return the first guard of AUTO that is not satisfied, or ""."""
        if self._supervised_by_hand and not hand_fresh:
            return "nobody supervises: the hand is silent"
        around = self._outlook
        supervised = hand_fresh or around.console_heard
        return (
            ("" if around.leased else "nobody controls the rig: take the lease first")
            or ("" if supervised else "nobody supervises: neither hand nor console is heard")
            or around.camera_fault
            or around.drift_fault
            or track_refusal(self.scene.track, self.scene.seen, self._guards, now_s)
            or coupling_refusal(self.scene.lead_um, self._guards)
            or ("" if self.scene.area else "no critical area is chosen: mark one first")
            or self._autopilot.refusal
            or (self._gave_up(now_s) if self.machine.mode is Mode.AUTO else "")
        )

    def _gave_up(self, now_s: float) -> str:
        """Return why the policy cannot go on, or ""."""
        away_um = self.scene.distance_um
        if self._autopilot.at_target and away_um is not None and not self._arrived():
            return f"the robot rests {away_um:.0f} µm from the centre, outside the area: go on by hand"
        return self._autopilot.stuck(now_s)

    def _arrived(self) -> bool:
        """Tell whether |P_s − P_critical| ≤ ε holds, on the tip and (by setting) on the robot."""
        area, tip_um, robot_um = self.scene.area, self.scene.tip_distance_um, self.scene.distance_um
        if area is None or tip_um is None or self.machine.mode is not Mode.AUTO:
            return False
        robot_there = robot_um is not None and robot_um <= area.epsilon_um
        small = self._handover.announced and not self._handover.in_motion(area.epsilon_um)
        if self._autopilot.at_target or self._handover.style == "stop" or small:
            # At rest the friction lead may keep the tip outside a small area for ever.
            return robot_there and self._autopilot.at_target
        return tip_um <= area.epsilon_um and (robot_there or not self._handover.require_robot)

    def _on_change(self, change: Transition, now_s: float) -> None:
        self.generation += 1
        if change.after is not Mode.HOLD:
            self.errand.end(change.reason or "the rig was disarmed")
        self._blend = self._blend_of(change, now_s)
        if change.before is Mode.AUTO:
            self._autopilot.end()
        if change.after in (Mode.STOP, Mode.FAULT):
            self._manipulator.stop()
            self._stopping.begin(now_s)
        seen, tip = self.scene.seen, self.scene.tip
        if change.before not in ARMED and change.after in ARMED and tip is not None:
            self.drive.begin(tip)
            self._stopping.end()
            self._beat()
        self._sharing = None
        if change.after is not Mode.MANUAL:
            self._hand.release()
        elif self._hand.engaged:
            # It drove together with the policy; from here on alone.
            self._hand.engage(self.drive.shaper.rest_point, now_s)
        # Whoever began AUTO must stay: a console does not stand in for a hand that was lost on the way.
        self._supervised_by_hand = change.after is Mode.AUTO and self._facts.hand_fresh
        self._announced = False
        if change.after is Mode.AUTO and seen is not None and tip is not None:
            self._descent.begin()
            self._autopilot.begin(seen, tip, now_s)
        self._tell_change(change)

    def _blend_of(self, change: Transition, now_s: float) -> Blend | None:
        """Return how authority passes; None if at once, as whenever nobody was told that it would."""
        if (change.before, change.after) != (Mode.AUTO, Mode.MANUAL) or not self._announced:
            return None
        shaper, area = self.drive.shaper, self.scene.area
        epsilon_um = area.epsilon_um if area is not None else 0.0
        held = self._calibration.held_point(shaper.position)
        way_um = steps([self._calibration.stage_xy_um(point) for point in self._autopilot.ahead(held)])
        return Blend(shaper.position, shaper.velocity_um_per_s, self._handover, epsilon_um, now_s, way_um)

    def _wish(self, mode: Mode, now_s: float) -> Reference | None:
        """Return where the mode wants the tip; None to come to rest."""
        scene = self.scene
        if mode is Mode.AUTO and scene.tip is not None:
            setpoint = self.drive.shaper.position
            down = self._descent.reference(scene.robot, scene.tip.position, setpoint)
            if down is not None:
                self._autopilot.wait(scene.seen, scene.tip, now_s)
                return down
            z_um = setpoint.z_um
            wish = self._autopilot.reference(scene.seen, scene.tip, z_um, now_s)
            self._announce()
            return self._with_hand(wish, now_s)
        if mode is not Mode.MANUAL:
            return self.errand.reference
        hand = self._hand.reference(now_s)
        if self._blend is None:
            return hand
        wish = self._blend.reference(hand, now_s, self._limits.speed_um_per_s)
        if wish is None:
            self._blend = None
        return wish

    def _with_hand(self, wish: Reference | None, now_s: float) -> Reference | None:
        """Return the policy's wish, deflected by a hand that drives together with it."""
        hand, robot, area = self._hand.reference(now_s), self.scene.robot, self.scene.area
        if self._sharing is None or wish is None or hand is None or area is None:
            return wish
        clearance_um = self._vessel.clearance_um(robot) if robot is not None else None
        distance_um = self.scene.distance_um
        return self._sharing.reference(wish, hand, distance_um, clearance_um, area.epsilon_um, now_s)

    def _announce(self) -> None:
        """Tell the operator, once a task, that control will soon be his."""
        left_s = self._autopilot.handover_s
        if self._announced or left_s is None or not self._handover.announced:
            return
        if left_s <= self._handover.announce_s:
            self._announced = True
            self.surroundings.announce(left_s)

    def _repeat_stop(self, now_s: float) -> None:
        """Stop again while the tip moves, or nobody knows whether it does."""
        tip = None if self._tip_fault else self.scene.tip
        if self._stopping.due(tip, now_s, latched=self.machine.mode in LATCHED):
            self._manipulator.stop()

    def _beat(self) -> None:
        self.surroundings.beat(self.machine.mode in ARMED or self._stopping.pending)

    def _tip_fields(self) -> dict[str, object]:
        """Return the reading that this step goes by, for the log."""
        tip = self.scene.tip
        if tip is None or self._tip_fault:
            return {"tip_fault": self._tip_fault}
        at = tip.position
        return {"tip_taken_s": tip.taken_s, "tip_um": (at.x_um, at.y_um, at.z_um), "tip_moving": tip.moving}

    def _read_tip(self) -> None:
        try:
            self.scene.tip = self._manipulator.tip()
            self._tip_fault = ""
        except DeviceError as error:
            self._tip_fault = f"manipulator: {error}"


def _area_fields(area: CriticalArea | None) -> dict[str, Any]:
    if area is None:
        return {"id": None}
    return {
        "id": area.id,
        "center_px": (area.center.x_px, area.center.y_px),
        "epsilon_um": area.epsilon_um,
        "label": area.label,
    }
