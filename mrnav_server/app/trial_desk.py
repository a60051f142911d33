"""Trials as clients begin, end and list them."""

import asyncio
import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from mrnav_server.app.bench import Bench
from mrnav_server.app.navigator import Navigator
from mrnav_server.app.reporting import Report, ReportError, trial_report
from mrnav_server.app.telemetry import Telemetry
from mrnav_server.app.trial_video import TrialVideo
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.metrics import trial_metrics
from mrnav_server.core.vessel import VesselMap
from mrnav_server.core.wire_twin import calibration_fields
from mrnav_server.loops.control import ControlLoop
from mrnav_server.loops.live_trial import LiveTrial
from mrnav_server.loops.recorder import Recorder
from mrnav_server.loops.software import software_version
from mrnav_server.loops.state_image import state_image
from mrnav_server.loops.trial_log import Condition, OperatorKind, TrialHeader, list_trials
from mrnav_server.loops.trial_marks import TrialMarks
from mrnav_server.settings import Settings


class TrialDesk:
    """Begins and ends trials.

    Args:
        settings: Their digest goes into every record.
        root: Folder of all trials.
        recorder: Writes the log.
        vessel: The vessel model.
        bench: Calibration, and the simulated world if there is one.
        control: Where the robot is and where it shall go.
        navigator: Which policy is in use.
        marks: Contacts and whether the target was reached.
        telemetry: Latencies and counters.
        film: Records the trial's video.
        announce: Tells everybody what happened, and records it.
        report: Makes a finished trial's report.
    """

    def __init__(
        self,
        settings: Settings,
        root: Path,
        recorder: Recorder,
        vessel: VesselMap,
        bench: Bench,
        control: ControlLoop,
        navigator: Navigator,
        marks: TrialMarks,
        telemetry: Telemetry,
        film: TrialVideo,
        announce: Callable[[str, Mapping[str, object]], None],
        report: Report = trial_report,
    ) -> None:
        self._report = report
        self.live = LiveTrial(vessel.um_per_px, vessel.clearance_um)
        self._settings = settings
        self._root = root
        self._recorder = recorder
        self._vessel = vessel
        self._bench = bench
        self._control = control
        self._navigator = navigator
        self._marks = marks
        self._telemetry = telemetry
        self._film = film
        self._announce = announce
        self._software = software_version()
        self._ending = asyncio.Lock()
        self._condition: Condition | None = None

    @property
    def auto_refusal(self) -> str:
        """Why the running trial's condition leaves no AUTO, in plain words; "" if it does, or none runs."""
        if self._recorder.trial is None or self._condition != "without_autonomy":
            return ""
        return f"trial {self._recorder.trial} runs without autonomy: steer by hand"

    def list(self) -> list[dict[str, Any]]:
        """Describe the trials on disk, oldest first."""
        return [
            {"id": info.id, "status": info.status, **dataclasses.asdict(info.header)}
            for info in list_trials(self._root)
        ]

    async def live_metrics(self, trial_id: str) -> dict[str, Any] | None:
        """Return the running trial's metrics up to now; None if it does not run, or has no track."""
        trial = self.live.trial(self._marks.go_s, self._marks.reached_s)
        if trial is None or trial_id != self._recorder.trial:
            return None
        metrics = await asyncio.to_thread(trial_metrics, trial)
        return {
            "id": trial_id,
            "reached": trial.reached,
            "elapsed_s": trial.end_s - trial.go_s,
            "metrics": dataclasses.asdict(metrics),
        }

    def start(
        self, participant: str, condition: Condition, operator_kind: OperatorKind, notes: str
    ) -> dict[str, Any]:
        """Begin a trial: its log, its marks and its latencies start now.

        Raises:
            RefusedError: While another runs, or if it cannot be recorded.
        """
        area, robot = self._control.scene.area, self._control.scene.robot
        header = TrialHeader(
            participant=participant,
            condition=condition,
            operator_kind=operator_kind,
            simulated_rig=self._bench.simulated,
            software_version=self._software,
            configuration_sha256=self._settings.digest(),
            vessel=self._vessel.name,
            vessel_sha256=self._vessel.digest,
            um_per_px=self._vessel.um_per_px,
            calibration=calibration_fields(self._bench.calibration),
            start_px=(robot.x_px, robot.y_px) if robot else None,
            area_id=area.id if area else None,
            area_px=(area.center.x_px, area.center.y_px) if area else None,
            area_epsilon_um=area.epsilon_um if area else None,
            policy_sha256=self._navigator.policy_sha256,
            seeds={"sim": self._settings.sim.seed, "policy": self._settings.autopilot.seed},
            notes=notes,
        )
        beginning = {"settings": self._settings.public(), "state": self._state()}
        trial_id = self._recorder.start_trial(header, beginning)
        self._condition = condition
        self._film.begin(self._root / trial_id)
        self._marks.restart()
        self.live.begin()
        self._telemetry.restart()
        self._announce("trial", {"mark": "start", "id": trial_id})
        return {"id": trial_id, "folder": str(self._root / trial_id)}

    def _state(self) -> dict[str, object]:
        """Return what the next decisions depend on; a trial is not refused because it cannot be replayed."""
        try:
            return {
                "calibration": state_image(self._bench.calibration),
                "control": state_image(self._control),
            }
        except TypeError as error:
            return {"missing": str(error)}

    async def end(self, trial_id: str) -> dict[str, Any]:
        """End the running trial; return its marks, latencies and metrics. Its log is safe on disk.

        Raises:
            RefusedError: If this trial is not the running one.
        """
        # A second request must not find the trial still running while its film is being closed.
        async with self._ending:
            if trial_id != self._recorder.trial:
                raise RefusedError("no_such_trial", f"trial {trial_id!r} is not running")
            summary = self._marks.summary() | {
                "id": trial_id,
                "final_distance_um": self._control.scene.distance_um,
                "latency_ms": self._telemetry.summary(),
                "simulated": self._bench.simulated,
            }
            filmed = await self._film.end()
            if filmed is not None:
                summary["video"] = dataclasses.asdict(filmed)
            if self._bench.world is not None and self._settings.rig.camera == "simulated":
                truth = self._bench.world
                summary["simulated_truth"] = {"collisions": truth.collisions, "lifted": truth.lifted}
            self._announce("trial", {"mark": "end", **summary})
            folder = await self._recorder.end_trial()
            self.live.end()
        if folder is None:
            return summary
        try:
            report: dict[str, Any] = await self._report(folder)
        except ReportError as error:
            report = {"report_error": str(error)}
        return report | summary | {"folder": str(folder)}
