"""The lock-step rig of tests/loops, recorded as the server records: simulated time, a real log."""

import asyncio
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mrnav_server.app.herald import Herald
from mrnav_server.autonomy.path import PathPlanner
from mrnav_server.core.frames import HandPoint
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.modes import Ask, Mode, Transition
from mrnav_server.core.records import Track, TrackState
from mrnav_server.core.vessel import VesselMap
from mrnav_server.core.wire_twin import calibration_fields
from mrnav_server.loops.autopilot import AutopilotConfig
from mrnav_server.loops.events import EventBus
from mrnav_server.loops.recorder import Recorder, RecorderConfig
from mrnav_server.loops.software import software_version
from mrnav_server.loops.state_image import state_image
from mrnav_server.loops.trial_fields import hand_fields, track_fields
from mrnav_server.loops.trial_log import TrialHeader
from mrnav_server.loops.trial_marks import TrialConfig, TrialMarks
from mrnav_server.settings import Settings
from tests.loops.conftest import LockStep

SETTINGS = Settings(autopilot=AutopilotConfig(source="geodesic"))


class RecordedRig(LockStep):
    """A rig whose trial is recorded.

    Args:
        root: Folder of all trials.
        vessel: The vessel model.
        planner: Plans on it.
        seed: Of the camera's noise and of the world.
    """

    def __init__(self, root: Path, vessel: VesselMap, planner: PathPlanner, seed: int = 1) -> None:
        self.root = root
        self.camera_fault = ""
        super().__init__(vessel, planner, seed)
        self.recorder = Recorder(root, lambda: self.now_s, RecorderConfig(min_free_mb=0.0))
        self.herald = Herald(EventBus(), self.recorder, lambda: self.now_s)
        self.marks = TrialMarks(TrialConfig(), vessel, self.herald.announce)
        self.control._log = self.control.drive._log = self._on_control
        self.control._tell_change = self._on_change
        self.control.surroundings.camera_fault = lambda: self.camera_fault
        self.autopilot.log = self.herald.record

    def begin(self, settings: Settings = SETTINGS) -> None:
        area = self.control.scene.area
        robot = self.control.scene.robot
        header = TrialHeader(
            participant="P01",
            condition="with_autonomy",
            operator_kind="simulated",
            simulated_rig=True,
            software_version=software_version(),
            configuration_sha256=settings.digest(),
            vessel=self.vessel.name,
            vessel_sha256=self.vessel.digest,
            um_per_px=self.vessel.um_per_px,
            calibration=calibration_fields(self.calibration),
            start_px=(robot.x_px, robot.y_px) if robot else None,
            area_id=area.id if area else None,
            area_px=(area.center.x_px, area.center.y_px) if area else None,
            area_epsilon_um=area.epsilon_um if area else None,
        )
        state = {"calibration": state_image(self.calibration), "control": state_image(self.control)}
        self.recorder.start_trial(header, {"settings": settings.public(), "state": state})
        self.marks.restart()
        self.herald.announce("trial", {"mark": "start"})

    def end(self) -> Path:
        self.herald.announce("trial", {"mark": "end"})
        folder = asyncio.run(self.recorder.end_trial())
        assert folder is not None
        return folder

    def send_hand(self) -> None:
        self._hands += 1
        self.lease.hear("hand", self.now_s)
        point = HandPoint(self.hand_x_m, 0.0, self.hand_z_m)
        sample = HandSample("hand", self._hands, self.now_s, self.now_s, point, self.clutch, True, True)
        self.hand.on_sample(sample)
        self.herald.record("hand", hand_fields(sample))
        self.control.on_hand(self.now_s, self.now_s)

    def _see(self) -> None:
        super()._see()
        track = self.control.scene.track
        assert track is not None
        self._tell_track(track)

    def lose_robot(self) -> None:
        """One picture in which the robot is not found."""
        track = Track(self.world.time_s, self._frames, TrackState.SEARCHING, None, None, 0.0, math.nan, 0)
        self._frames += 1
        self.control.scene.see(track)
        self._tell_track(track)

    def _tell_track(self, track: Track) -> None:
        self.herald.record("track", track_fields(track))
        self.marks.on_track(track, self.control.machine.mode, self.control.scene.distance_um)

    def _on_control(self, topic: str, data: Mapping[str, Any]) -> None:
        self.herald.record(topic, data)
        if topic == "command":
            self.marks.on_motion(data["sent_s"])

    def _on_change(self, change: Transition) -> None:
        fields = {"before": change.before.value, "mode": change.after.value, "reason": change.reason}
        self.herald.announce("mode", fields)
        self.changes.append(change.after.value)
        if change.before is Mode.AUTO and change.after is not Mode.AUTO:
            # As the server does: the next area is chosen within the step that ended the task.
            self.control.choose_area(self.areas.list()[0])


def drive(rig: RecordedRig) -> None:
    """Arm, drive to the area, and go on by hand."""
    rig.mark()
    rig.begin()
    rig.ask(Ask.ARM)
    rig.start_auto()
    rig.advance(0.8)
