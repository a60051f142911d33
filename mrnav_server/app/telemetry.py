"""What the rig tells of itself: latencies, rates, counters, and the state that twin clients see."""

import dataclasses
from collections.abc import Callable
from typing import Any

from mrnav_server.core.frames import Calibration
from mrnav_server.core.hand import HandControl
from mrnav_server.core.lease import Lease
from mrnav_server.core.modes import ARMED
from mrnav_server.core.records import Percentiles, RigState, Track
from mrnav_server.loops.autopilot import Autopilot
from mrnav_server.loops.control import ControlLoop
from mrnav_server.loops.timing import Rate, RollingLatency
from mrnav_server.loops.trial_marks import TrialMarks
from mrnav_server.vision.tip_agreement import TipSeen


class Telemetry:
    """Measures the rig and describes it.

    Args:
        control: The control loop.
        autopilot: Its planned path and estimate.
        hand: The operator's hand.
        lease: Who controls the rig.
        marks: Contacts so far.
        calibration: Places the tip in the image.
    """

    def __init__(
        self,
        control: ControlLoop,
        autopilot: Autopilot,
        hand: HandControl,
        lease: Lease,
        marks: TrialMarks,
        calibration: Calibration,
    ) -> None:
        self.camera, self.hand_messages, self.hand_poses = Rate(), Rate(), Rate()
        self._control = control
        self._autopilot = autopilot
        self._hand = hand
        self._lease = lease
        self._marks = marks
        self._calibration = calibration
        self._ticks = Rate()
        self._tick = RollingLatency()
        self._frame_to_twin = RollingLatency()
        self._ticked_s: float | None = None
        self._published_frame = -1
        self._seq = 0
        self.tip_seen: Callable[[], TipSeen] = TipSeen
        """Where the tip was seen in the picture."""

    def recalibrate(self, calibration: Calibration) -> None:
        """Go by another calibration."""
        self._calibration = calibration

    def restart(self) -> None:
        """Forget the latencies: a trial begins."""
        for latency in (self._control.hand_to_command, self._frame_to_twin, self._tick):
            latency.clear()

    def on_tick(self, now_s: float) -> None:
        """Note a beat of the control loop."""
        if self._ticked_s is not None:
            self._tick.add(now_s - self._ticked_s)
        self._ticked_s = now_s
        self._ticks.add(now_s)

    def on_published(self, track: Track | None, now_s: float) -> None:
        """Note that twin clients were given a track."""
        if track is not None and track.frame_number != self._published_frame:
            self._published_frame = track.frame_number
            self._frame_to_twin.add(now_s - track.taken_s)

    def latencies(self) -> dict[str, Percentiles]:
        """Return the latencies by name."""
        return {
            "hand_to_command": self._control.hand_to_command.percentiles(),
            "frame_to_twin": self._frame_to_twin.percentiles(),
            "tick": self._tick.percentiles(),
        }

    def summary(self) -> dict[str, Any]:
        """Return the latencies for JSON."""
        return {name: dataclasses.asdict(value) for name, value in self.latencies().items()}

    def state(
        self, now_s: float, counters: dict[str, int], trial: str | None, trial_refusal: str = ""
    ) -> RigState:
        """Describe the rig at this moment.

        Args:
            now_s: Now.
            counters: Counts by name.
            trial: Id of the running trial.
            trial_refusal: Why that trial leaves no AUTO; "" if it does.
        """
        control, machine, facts = self._control, self._control.machine, self._control.facts
        track, tip, armed = control.scene.track, control.scene.tip, self._control.machine.mode in ARMED
        self._seq += 1
        return RigState(
            seq=self._seq,
            t_s=now_s,
            tip=tip.position if tip else None,
            setpoint=control.setpoint,
            tip_px=self._calibration.tip_in_image(tip.position) if tip else None,
            track=track,
            track_age_ms=1000.0 * (now_s - track.taken_s) if track else 0.0,
            mode=machine.mode,
            severity=machine.severity(facts),
            reason="; ".join(
                filter(
                    None, (control.errand.text or machine.reason, self._hand.trouble(now_s), facts.warning)
                )
            ),
            authority=control.authority(now_s),
            lease=self._lease.state(),
            clutch=self._hand.clutch,
            auto_ready=armed and not trial_refusal and not facts.auto_refusal and not facts.fault,
            auto_refusal=facts.fault or trial_refusal or facts.auto_refusal or ("" if armed else "arm first"),
            time_to_handover_s=self._autopilot.handover_s,
            critical_area=control.scene.area.id if control.scene.area else None,
            distance_um=control.scene.distance_um,
            lead_um=control.scene.lead_um,
            collisions=self._marks.collisions,
            path=self._autopilot.path_px,
            latency_ms=self.latencies(),
            rates_hz={
                "camera": self.camera.hz(now_s),
                "hand": self.hand_messages.hz(now_s),
                "hand_poses": self.hand_poses.hz(now_s),
                "tick": self._ticks.hz(now_s),
            },
            hand={
                "scale": self._hand.scale,
                "gain": self._hand.gain,
                "messages_hz": self.hand_messages.hz(now_s),
                "poses_hz": self.hand_poses.hz(now_s),
            },
            counters=counters,
            trial=trial,
            tip_seen_px=self.tip_seen().image,
            tip_off_um=self.tip_seen().off_um,
            learned=self._autopilot.learned,
        )
