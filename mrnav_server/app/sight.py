"""Everything that looks through the camera: where the robot is, and whether the bench is still as it was."""

import asyncio
from collections.abc import Callable, Mapping

from mrnav_server.app.bench import Bench
from mrnav_server.app.drift_patrol import DriftPatrol
from mrnav_server.app.tip_patrol import TipPatrol
from mrnav_server.core.frames import Calibration
from mrnav_server.core.records import Frame, Track
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.control import ControlLoop
from mrnav_server.loops.latest import Latest
from mrnav_server.loops.tracking import TrackingLoop
from mrnav_server.settings import Settings
from mrnav_server.vision.drift import Drift
from mrnav_server.vision.frame_watch import FrameWatch
from mrnav_server.vision.tip_agreement import TipSeen
from mrnav_server.vision.tracker import Tracker


class Sight:
    """Tracks the robot, and tells the control loop why pictures or calibration must not be relied on.

    Args:
        settings: Of camera, tracker and patrols.
        vessel: The vessel model.
        bench: Its camera, and the calibration to begin with.
        frames: Gets every picture.
        control: Whose surroundings are told what is seen.
        on_track: Called on the event loop with every picture and where the robot is in it.
        announce: Tells everybody what was noticed.
        clock: Monotonic time in seconds.
        sleep: How a thread waits for a time in seconds, by that clock.
    """

    def __init__(
        self,
        settings: Settings,
        vessel: VesselMap,
        bench: Bench,
        frames: Latest[Frame],
        control: ControlLoop,
        on_track: Callable[[Frame, Track], None],
        announce: Callable[[str, Mapping[str, object]], None],
        clock: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        self._announce = announce
        self._clock = clock
        self.camera_fault = ""
        self.registration_warning = ""
        # Pictures of a film repeat where it was compressed; those of a camera never do.
        film = settings.rig.camera == "file"
        watch = FrameWatch(settings.camera.fps, settings.tracker.darkest_gray, may_repeat=film)
        self._tracker = Tracker(settings.tracker, bench.calibration, live=not film)
        self._tracking = TrackingLoop(
            bench.camera, self._tracker, on_track, self._on_camera, watch, clock, sleep
        )

        def blind() -> str:
            return self.camera_fault or control.errand.busy

        self._drift = DriftPatrol(settings.drift, vessel, bench.calibration, frames, blind, announce)
        self._tip = TipPatrol(
            settings.tip_watch,
            settings.tip,
            vessel,
            bench.calibration,
            frames,
            control.scene,
            blind,
            announce,
        )
        around = control.surroundings
        around.camera_fault = lambda: self.camera_fault or watch.overdue(clock())
        around.drift_warning = lambda: (
            self._drift.warning() or self._tip.warning() or self.registration_warning
        )
        around.drift_fault = self._drift.fault

    @property
    def drift(self) -> Drift:
        """How far the vessel is from where it was."""
        return self._drift.drift

    def tip_seen(self) -> TipSeen:
        """Return where the tip was seen, beside where it should be."""
        return self._tip.seen

    def recalibrate(self, calibration: Calibration) -> None:
        """Look by another calibration from here on."""
        self._tracker.recalibrate(calibration)
        self._drift.recalibrate(calibration)
        self._tip.recalibrate(calibration)
        self.registration_warning = ""

    def start(self, group: asyncio.TaskGroup) -> None:
        """Begin to look, in tasks of a group; the camera is open, and closed by their end."""
        group.create_task(self._tracking.run(), name="tracking")
        group.create_task(self._drift.run(self._clock), name="drift")
        group.create_task(self._tip.run(self._clock), name="tip")

    def _on_camera(self, fault: str) -> None:
        self.camera_fault = fault
        if fault:
            self._announce("fault", {"reason": fault})
        else:
            self._announce("recovered", {"reason": "the camera works again"})
