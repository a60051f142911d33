"""The rig: owns the devices and the loops, and answers the server.

``Rig(settings)`` computes and reads files; only ``run`` acquires devices, and it opens last what must stop
first.
"""

import asyncio
import dataclasses
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from mrnav_server.app.auth import Role, Tokens, session_name
from mrnav_server.app.bench import build_bench
from mrnav_server.app.calibration_desk import CalibrationDesk
from mrnav_server.app.console_desk import ConsoleDesk
from mrnav_server.app.hand_seat import HandSeat
from mrnav_server.app.herald import Herald
from mrnav_server.app.navigator import Navigator
from mrnav_server.app.registration_desk import RegistrationDesk
from mrnav_server.app.reporting import Report, trial_report
from mrnav_server.app.sight import Sight
from mrnav_server.app.supervision import come_to_rest, supervised, tell_earlier_stops
from mrnav_server.app.telemetry import Telemetry
from mrnav_server.app.trial_desk import TrialDesk
from mrnav_server.app.trial_video import TrialVideo
from mrnav_server.app.video import VideoEncoder
from mrnav_server.core import wire_twin
from mrnav_server.core.areas import CriticalAreas
from mrnav_server.core.errors import ConfigError, DeviceError, RefusedError
from mrnav_server.core.frames import Calibration, ImagePoint, VesselPoint
from mrnav_server.core.hand import HandControl
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.lease import Lease
from mrnav_server.core.modes import ARMED, Ask, Mode, Transition
from mrnav_server.core.records import Frame, RigState, Track
from mrnav_server.loops.control import ControlLoop
from mrnav_server.loops.events import EventBus
from mrnav_server.loops.hand_link import HandLinkServer
from mrnav_server.loops.latest import Latest
from mrnav_server.loops.priority import compute_in_calling_threads
from mrnav_server.loops.recorder import Recorder
from mrnav_server.loops.ticks import ticks
from mrnav_server.loops.trial_fields import track_fields
from mrnav_server.loops.trial_marks import TrialMarks
from mrnav_server.settings import Settings
from mrnav_server.sim.clock import WorldClock
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model

_PUBLISH_S = 1 / 60
_WORLD_STEP_S = 0.002
_CLOSE_S = 2.0


class Rig:
    """One manipulator, one camera, one operator, one vessel.

    Args:
        settings: With tokens (``Settings.with_tokens``).
        clock: Monotonic time in seconds.
        sleep: How a thread waits for a time in seconds, by that clock.
        report: Makes a finished trial's report.

    Raises:
        ConfigError: If the vessel model cannot be used.
    """

    def __init__(
        self,
        settings: Settings,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
        report: Report = trial_report,
    ) -> None:
        self.settings = settings
        self._clock, self._sleep = clock, sleep
        self._root = Path(settings.recording.root).absolute()
        self._recorder = Recorder(self._root, clock, settings.recording)
        self.events = EventBus()
        self.herald = Herald(self.events, self._recorder, clock)
        self.vessel = load_vessel_model(find_model(settings.rig.vessel))
        self.bench = build_bench(settings, self.vessel, clock, sleep)
        self.states: Latest[RigState] = Latest()
        self.frames: Latest[Frame] = Latest()
        self.areas = CriticalAreas(self.vessel, self._on_areas)
        self.lease = Lease()
        self.hand = HandControl(settings.hand, settings.limits.speed_um_per_s)
        self.navigator = Navigator(settings, self.vessel, self.calibration)
        self.control = ControlLoop(
            settings.handover,
            settings.guards,
            settings.limits,
            self.bench.manipulator,
            self.calibration,
            self.vessel,
            self.lease,
            self.hand,
            self.navigator.autopilot,
            self._on_control,
            self._on_change,
        )
        self.navigator.autopilot.log = self.herald.record
        self.marks = TrialMarks(settings.trial, self.vessel, self.herald.announce)
        self.telemetry = Telemetry(
            self.control, self.navigator.autopilot, self.hand, self.lease, self.marks, self.calibration
        )
        self.encoder = VideoEncoder(self.frames)
        self.film = TrialVideo(settings.video, self.encoder)
        self.trials = TrialDesk(
            settings,
            self._root,
            self._recorder,
            self.vessel,
            self.bench,
            self.control,
            self.navigator,
            self.marks,
            self.telemetry,
            self.film,
            self.herald.announce,
            report,
        )
        self.registration = RegistrationDesk(
            settings.registration,
            self._root,
            self.vessel,
            self.calibration,
            (self.bench.name, self._simulated_place()),
            self.frames,
            self.require_idle,
            self._recalibrate,
            self.herald.announce,
        )
        self.calibrating = CalibrationDesk(
            settings.calibration,
            settings.camera,
            settings.tracker,
            self._root,
            self.vessel,
            lambda: self.simulated,
            self.control,
            self.frames,
            self.require_idle,
            self._calibration_objection,
            self._page_is_silent,
            self.bench.scene,
            self._use_calibration,
            self.herald.announce,
            clock,
        )
        self.console = ConsoleDesk(
            self.control,
            self.lease,
            self.hand,
            self.areas,
            self.navigator,
            self.bench.manipulator,
            self.herald,
            step=lambda: self._step(self._clock()),
            publish=self._publish,
            trial_refusal=lambda: self.trials.auto_refusal,
            clock=clock,
        )
        self.hand_seat = seat = HandSeat(
            self.lease,
            self.hand,
            step=lambda received_s: self._step(self._clock(), received_s),
            hold=self._hold,
            on_message=self._on_message,
            announce=self.herald.announce,
            record=self.herald.record,
            clock=clock,
            transform={
                "gain": settings.hand.gain,
                "fine_gain": settings.hand.fine_gain,
                "vertical_gain": settings.hand.vertical_gain,
            },
        )
        self.sight = Sight(
            settings,
            self.vessel,
            self.bench,
            self.frames,
            self.control,
            self._on_track,
            self.herald.announce,
            clock,
            sleep,
        )
        self.telemetry.tip_seen = self.sight.tip_seen
        around = self.control.surroundings
        around.recorder_fault = lambda: self._recorder.fault or ""
        around.device_warnings = self.bench.manipulator.warnings
        around.announce = lambda left_s: self.herald.announce(
            "handover_announced", {"in_s": round(left_s, 2), "distance_um": self.control.scene.distance_um}
        )
        self._tokens = Tokens(settings.server)
        self._hand_link = HandLinkServer(
            dataclasses.replace(
                settings.hand_link, host=settings.server.host, port=settings.server.hand_port
            ),
            authorize=self._authorize,
            session_name=lambda secret, role: session_name(secret, Role[role.upper()]),
            acquire=seat.acquire,
            on_sample=seat.take,
            on_closed=seat.leave,
            twin_source=self._twin_state,
            clock=clock,
            on_bad_numbers=seat.on_bad_numbers,
            limits={"speed_um_per_s": settings.limits.speed_um_per_s},
            transform=seat.transform,
            choose_scale=seat.choose_scale,
        )
        self.sight.registration_warning = self.registration.restore()
        self._running = False
        self._fresh_track = asyncio.Event()

    # -- what the server reads -------------------------------------------------------------------------

    @property
    def calibration(self) -> Calibration:
        """How camera, vessel model and manipulator see each other."""
        return self.bench.calibration

    @property
    def hand_port(self) -> int:
        """The hand link's port; the real one once it runs."""
        return self._hand_link.port

    @property
    def simulated(self) -> bool:
        """Whether the simulator, or an emulated controller, stands in for a device."""
        return self.bench.simulated

    def snapshot(self, session: str, role: str) -> dict[str, Any]:
        """Return the first message of a twin client."""
        card = wire_twin.RigCard(
            name=self.bench.name,
            simulated=self.simulated,
            vessel=self.vessel,
            calibration=self.calibration,
            limits={
                name: value
                for name, value in dataclasses.asdict(self.settings.limits).items()
                if isinstance(value, float)
            },
            picture=self.settings.camera,
            camera_format=self.bench.camera_format,
        )
        cards = self.navigator.policy_cards()
        return wire_twin.snapshot(session, role, card, cards, self.areas.list(), self.states.value)

    def policies(self) -> list[dict[str, Any]]:
        """Describe the policies and whether they were verified."""
        return [dataclasses.asdict(card) for card in self.navigator.policy_cards()]

    async def use_policy(self, folder: Path) -> None:
        """Verify a policy of this vessel model and go by it from here on.

        Raises:
            RefusedError: If it cannot be used; the policy in use stays.
        """
        await self.navigator.use(folder)

    def readiness(self) -> list[str]:
        """Return why the rig is not ready; empty when it is."""
        reasons = [] if self._running else ["the rig is starting or has stopped"]
        if self.sight.camera_fault:
            reasons.append(self.sight.camera_fault)
        if self.control.facts.fault:
            reasons.append(self.control.facts.fault)
        return reasons

    def require_idle(self, session: str) -> None:
        """Refuse what would change where the robot may go under somebody's hand.

        Raises:
            RefusedError: Without the lease, while the rig is armed, or during a trial.
        """
        self.console.heartbeat(session)
        self.console.require_lease(session)
        if self.control.machine.mode is not Mode.DISARMED:
            raise RefusedError("armed", "the rig is armed: disarm it first")
        if self._recorder.trial is not None:
            raise RefusedError(
                "trial_running", "a trial keeps the vessel and the registration it began with: end it first"
            )

    def to_vessel(self, frame: str, x: float, y: float) -> VesselPoint:
        """Map a point of the vessel, image or stage frame into the vessel's grid."""
        if frame == "image":
            return self.calibration.vessel_point(ImagePoint(x, y))
        if frame == "stage":
            return VesselPoint(*self.calibration.stage_from_vessel.inverse()(x, y))
        return VesselPoint(x, y)

    # -- running ---------------------------------------------------------------------------------------

    async def run(self, started: asyncio.Event) -> None:
        """Own the devices until cancelled; sets ``started`` once they are open.

        Raises:
            ConfigError: If a device cannot be opened or a port is taken.
        """
        # An import or a first inference during control would stall it for up to seconds.
        await self.navigator.load()
        await asyncio.to_thread(self.trials.live.prepare)
        # Once all that computes is loaded: a limit does not hold for what is loaded after it.
        compute_in_calling_threads()
        self._recorder.recover()
        tell_earlier_stops(self._root)
        manipulator, camera = self.bench.manipulator, self.bench.camera
        try:
            await asyncio.to_thread(camera.open)
            await manipulator.open()
        except DeviceError as error:
            camera.close()
            raise ConfigError(f"cannot start the rig: {error}") from None
        try:
            async with supervised(
                self.settings, self.bench, self.control, self.herald, self._root, self._clock
            ):
                try:
                    await self._run_loops(started)
                finally:
                    self._running = False
                    manipulator.stop()
                    self.herald.announce("rig_stopped", {"mode": self.control.machine.mode.value})
                    await come_to_rest(
                        self.bench,
                        self.settings.guards.tip_age_s,
                        self.control.surroundings.beat,
                        self._clock,
                    )
        finally:
            async with asyncio.timeout(_CLOSE_S):
                await asyncio.shield(manipulator.close())
                await asyncio.shield(self._recorder.end_trial())
                await asyncio.shield(self.film.end())
            self.navigator.close()

    async def _run_loops(self, started: asyncio.Event) -> None:
        """Run every loop until cancelled, or until one fails."""
        try:
            async with asyncio.TaskGroup() as group:
                if self.bench.world_clock is not None:
                    self.bench.world_clock.catch_up()
                    group.create_task(self._run_world(self.bench.world_clock), name="simulated world")
                self.sight.start(group)
                group.create_task(self._run_control(), name="control")
                group.create_task(self._run_twin(), name="twin")
                group.create_task(self.navigator.run(self._clock), name="planner")
                group.create_task(self.film.run(), name="film")
                group.create_task(self.calibrating.run(), name="calibration")
                listening = asyncio.Event()
                group.create_task(self._hand_link.run(listening), name="hand link")
                await listening.wait()
                self._running = True
                started.set()
        except* ConfigError as errors:
            raise errors.exceptions[0] from None

    async def _run_world(self, clock: WorldClock) -> None:
        async for _ in ticks(_WORLD_STEP_S, self._clock):
            clock.catch_up()

    async def _run_control(self) -> None:
        async for now_s in ticks(self.settings.control.tick_s, self._clock):
            self.telemetry.on_tick(now_s)
            self._step(now_s)

    async def _run_twin(self) -> None:
        """Publish at every fresh track, and at 60 Hz in between."""
        while True:
            try:
                async with asyncio.timeout(_PUBLISH_S):
                    await self._fresh_track.wait()
            except TimeoutError:
                pass
            self._fresh_track.clear()
            self._publish()

    def _step(self, now_s: float, received_s: float | None = None) -> None:
        """Step the control loop, at a beat or for a hand sample that was received just now."""
        if self.bench.world_clock is not None:
            # After a stall of the process the simulated readings would look stale; real ones would be fresh.
            self.bench.world_clock.catch_up()
        if received_s is None:
            self.control.step(now_s)
        else:
            self.control.on_hand(received_s, now_s)

    def _hold(self) -> None:
        if self.control.machine.mode in ARMED:
            self.control.submit(Ask.HOLD, self._clock())

    def _calibration_objection(self, session: str) -> str:
        """Return why a session's calibration must not move the tip any more, or ""."""
        if not self.lease.holds(session):
            return "the page that leads it fell silent, or gave the lease back"
        return "a trial was begun" if self._recorder.trial is not None else ""

    def _page_is_silent(self) -> bool:
        return not self.lease.console_heard_within(self.settings.guards.console_s, self._clock())

    def _use_calibration(self, calibration: Calibration) -> None:
        """Go by a calibration that was just made; the vessel's registration was made for another."""
        self._recalibrate(calibration)
        self.registration.rebase(calibration)

    def _recalibrate(self, calibration: Calibration) -> None:
        """Go by another calibration from here on: the only place where one is changed."""
        self.control.recalibrate(calibration)
        self.bench.calibration = calibration
        self.navigator.recalibrate(calibration)
        self.telemetry.recalibrate(calibration)
        self.sight.recalibrate(calibration)

    def _simulated_place(self) -> object:
        """Return where a simulated vessel really lies: a registration holds for that place alone."""
        sim = self.settings.sim
        return (sim.vessel_shift_um, sim.vessel_turn_deg) if self.bench.world is not None else None

    # -- callbacks of the loops ------------------------------------------------------------------------

    def _on_control(self, topic: str, data: Mapping[str, Any]) -> None:
        self.herald.record(topic, data)
        if topic == "command":
            self.marks.on_motion(data["sent_s"])

    def _on_change(self, change: Transition) -> None:
        """Announce a change of mode, and what it means."""
        before, after = change.before, change.after
        fields = {"before": before.value, "mode": after.value, "reason": change.reason}
        self.herald.announce("mode", fields)
        if before not in ARMED and after in ARMED and self._recorder.trial is None:
            self.marks.restart()
        if before is Mode.AUTO and after is Mode.MANUAL:
            facts = self.control.facts
            by = "arrival" if facts.arrived and not facts.clutch_closing else "takeover"
            self.herald.announce("handover", {"by": by, "distance_um": self.control.scene.distance_um})
            if by == "arrival" and self.control.scene.area is not None:
                self.areas.visit(self.control.scene.area.id)
        if before is Mode.AUTO:
            self.herald.record("learned", self.navigator.autopilot.learned)
        if after is Mode.FAULT:
            self.herald.announce("fault", {"reason": change.reason})
        if before is Mode.AUTO and self.control.scene.area not in self.areas.list():
            # The goal was removed or changed under way.
            self._on_areas()

    def _on_message(self, sample: HandSample) -> None:
        self.telemetry.hand_messages.add(sample.received_s)
        if sample.new_pose:
            self.telemetry.hand_poses.add(sample.received_s)

    def _on_track(self, frame: Frame, track: Track) -> None:
        self.frames.put(frame)
        self.control.scene.see(track)
        self.telemetry.camera.add(self._clock())
        self.herald.record("track", track_fields(track))
        self.marks.on_track(track, self.control.machine.mode, self.control.scene.distance_um)
        self.trials.live.on_track(track)
        self._fresh_track.set()

    def _on_areas(self) -> None:
        """Keep an area active that is marked; a task that is under way keeps its goal."""
        areas = {area.id: area for area in self.areas.list()}
        active = self.control.scene.area
        if self.control.machine.mode is not Mode.AUTO:
            kept = areas.get(active.id) if active else None
            self.control.choose_area(kept or next(iter(areas.values()), None))
        active = self.control.scene.area
        active_id, visited = active.id if active else None, self.areas.visited
        upcoming = self.areas.following(active_id) if active_id in visited else None
        self.herald.announce(
            "areas",
            {
                "critical_areas": [
                    wire_twin.area_fields(area, active_id, visited) for area in areas.values()
                ],
                "next": upcoming.id if upcoming else active_id,
            },
        )

    def _authorize(self, token: str) -> str | None:
        role = self._tokens.role(token)
        return None if role is None else role.name.lower()

    # -- helpers ---------------------------------------------------------------------------------------

    def _counters(self) -> dict[str, int]:
        counters = Counter(self.control.drive.counters)
        counters.update(self._hand_link.counters)
        counters.update(self.hand_seat.counters)
        counters.update(self.hand.counters)
        return dict(counters)

    def _twin_state(self) -> Mapping[str, object] | None:
        state = self.states.value
        return None if state is None else wire_twin.twin_state(state, self.calibration)

    def _publish(self) -> None:
        counters = self._counters()
        state = self.telemetry.state(self._clock(), counters, self._recorder.trial, self.trials.auto_refusal)
        self.states.put(state)
        self.telemetry.on_published(state.track, self._clock())
