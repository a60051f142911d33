"""Leads a person through the calibration of a running server; the tip moves through the control loop."""

import asyncio
import datetime
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from mrnav_server.app.calibration_report import draft_figures
from mrnav_server.core.errors import ConfigError, DeviceTimeoutError, MrnavError, RefusedError
from mrnav_server.core.frames import Calibration, StagePoint
from mrnav_server.core.modes import ARMED, LATCHED, Ask
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Frame
from mrnav_server.core.vessel import VesselMap
from mrnav_server.core.wire_twin import calibration_fields
from mrnav_server.loops.calibration_host import ARRIVED_UM
from mrnav_server.loops.control import ControlLoop
from mrnav_server.loops.latest import Latest
from mrnav_server.vision.calibration_file import (
    CalibrationFile,
    calibration_of,
    finished,
    save_calibration,
)
from mrnav_server.vision.calibration_plan import (
    Answer,
    CalibrationConfig,
    MoveTip,
    Pictures,
    Prepare,
    Step,
    TakePictures,
)
from mrnav_server.vision.calibration_procedure import Procedure
from mrnav_server.vision.charuco import SheetConfig
from mrnav_server.vision.tracker import TrackerConfig

FILE = "calibration.json"
_POLL_S = 0.02
_SPARE_S = 5.0
"""Time that a move may take longer than its speed says."""
_REST_S = 5.0
_FRAME_S = 2.0
_OLD_FRAMES = 2
"""Frames dropped before pictures count: they may have been taken before the bench came to rest."""


class Scene(Protocol):
    """A bench that prepares itself."""

    async def lay(self, scene: str, sheet: SheetConfig) -> None:
        """Lay down what a step asks for."""

    def put_back(self) -> None:
        """Lay the vessel back."""


class CalibrationDesk:
    """Hosts the procedure for one page at a time.

    Nothing is armed while a person is at the bench: the rig is armed when the person says that the bench is
    prepared, and disarmed before the next preparation.

    Args:
        config: What the procedure does.
        picture: The camera's pictures.
        tracker: How the robot is recognised.
        root: Folder that takes the file.
        vessel: The vessel model.
        simulated: Whether any device is simulated; known once the rig runs.
        control: Moves the tip.
        frames: The live picture.
        check: Raises RefusedError while a session must not calibrate.
        objection: Why a session's calibration must not move the tip any more, or "".
        hesitates: Whether the tip is to rest for the moment, since nobody is heard who watches it.
        scene: Prepares itself, on the simulated rig; None where a person does.
        use: Makes the rig go by a calibration.
        announce: Tells everybody what happened, and records it.
        clock: Monotonic time in seconds.
        sleep: Lets a time in seconds pass.
    """

    def __init__(
        self,
        config: CalibrationConfig,
        picture: PictureFormat,
        tracker: TrackerConfig,
        root: Path,
        vessel: VesselMap,
        simulated: Callable[[], bool],
        control: ControlLoop,
        frames: Latest[Frame],
        check: Callable[[str], None],
        objection: Callable[[str], str],
        hesitates: Callable[[], bool],
        scene: Scene | None,
        use: Callable[[Calibration], None],
        announce: Callable[[str, Mapping[str, object]], None],
        clock: Callable[[], float],
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self._config = config
        self._picture = picture
        self._tracker = tracker
        self._path = (root / FILE).absolute()
        self._vessel = vessel
        self._simulated = simulated
        self._control = control
        self._frames = frames
        self._check = check
        self._objection = objection
        self._hesitates = hesitates
        self._scene = scene
        self._use = use
        self._announce = announce
        self._clock = clock
        self._sleep = sleep
        self._procedure: Procedure | None = None
        self._session = ""
        self._moving = False
        self._cancelled = False
        self._refusal = ""
        self._used = ""
        self._wake = asyncio.Event()

    def state(self) -> dict[str, Any]:
        """Describe where the calibration stands, for JSON."""
        procedure = self._procedure
        step = procedure.step if procedure is not None else None
        return {
            "phase": self._phase(),
            "stage": step.stage if step is not None else None,
            "text": step.text if step is not None else "",
            "share": round(step.share, 3) if step is not None else 0.0,
            "scene": step.scene if isinstance(step, Prepare) else None,
            "refusal": self._refusal,
            "simulated": self._simulated(),
            "plan": {
                "square_um": self._config.sheet.square_um,
                "columns": self._config.sheet.columns,
                "rows": self._config.sheet.rows,
                "water_depth_um": self._config.water_depth_um,
            },
            "stages": draft_figures(procedure.draft if procedure is not None else None),
            "file": self._used or None,
            "setting": f'rig.calibration = "{self._used}"' if self._used else None,
        }

    def begin(
        self, session: str, changes: Mapping[str, float | int], water_depth_um: float
    ) -> dict[str, Any]:
        """Begin afresh, with a sheet and a depth of water.

        Args:
            session: Who asks.
            changes: Of the sheet: square_um, columns, rows.
            water_depth_um: Water over the robot's centre in µm.

        Raises:
            RefusedError: While the session must not, or for a sheet or depth that cannot be.
        """
        self._require(session)
        if self._procedure is not None and self._phase() != "done":
            raise RefusedError("busy", "a calibration is under way: cancel it first")
        try:
            sheet = replace(self._config.sheet, **changes)  # type: ignore[arg-type]
            config = replace(self._config, sheet=sheet, water_depth_um=water_depth_um)
        except ConfigError as error:
            raise RefusedError("bad_plan", str(error)) from None
        self._config = config
        self._procedure = Procedure(config, self._picture, self._tracker)
        self._session, self._refusal, self._used = session, "", ""
        self._control.errand.reserve()
        return self.state()

    def next(self, session: str) -> dict[str, Any]:
        """Go on: the person has prepared the bench as asked, or a stage that was refused begins again.

        Raises:
            RefusedError: While the session must not, or there is nothing to wait for.
        """
        self._require(session)
        if self._phase() != "waiting":
            raise RefusedError("not_waiting", "the calibration does not wait for you")
        self._session, self._refusal, self._cancelled, self._moving = session, "", False, True
        self._control.errand.reserve()
        self._wake.set()
        return self.state()

    def cancel(self) -> dict[str, Any]:
        """Bring the tip to rest and forget what was measured; anybody may."""
        self._cancelled = True
        self._control.errand.end("it was cancelled")
        if not self._moving:
            self._forget()
        return self.state()

    def use(self, session: str) -> dict[str, Any]:
        """Write what was measured into a file, and go by it from here on.

        Raises:
            RefusedError: While the session must not, or the calibration is not finished or not good enough.
        """
        self._require(session)
        if self._procedure is None or self._phase() != "done":
            raise RefusedError("unfinished", "the calibration is not finished")
        try:
            file = finished(
                self._procedure.draft,
                made_by="dashboard",
                made_at=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
                simulated=self._simulated(),
            )
            calibration = self._keep(file)
        except ConfigError as error:
            raise RefusedError("not_good_enough", str(error)) from None
        self._put_back()
        self._use(calibration)
        self._used = str(self._path)
        self._announce("calibration", {"file": self._used, "calibration": calibration_fields(calibration)})
        return self.state()

    async def run(self) -> None:
        """Perform what is asked for until cancelled."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            try:
                await self._perform_until_a_person_is_needed()
            except MrnavError as error:
                self._refusal = str(error)
                assert self._procedure is not None
                self._procedure.restart()
            finally:
                await self._disarm()
                self._moving = False
            if self._cancelled:
                self._forget()

    async def _perform_until_a_person_is_needed(self) -> None:
        procedure = self._procedure
        assert procedure is not None
        if isinstance(procedure.step, Prepare):
            if self._scene is not None:
                await self._scene.lay(procedure.step.scene, self._config.sheet)
            procedure.told(None)
        while procedure.step is not None and not isinstance(procedure.step, Prepare):
            if self._cancelled:
                raise RefusedError("cancelled", "it was cancelled")
            answer = await self._answer(procedure.step)
            # A fit takes a while, and the control loop must not wait for it.
            await asyncio.to_thread(procedure.told, answer)

    async def _answer(self, step: Step) -> Answer:
        match step:
            case MoveTip():
                self._arm()
                here = self._tip()
                if step.target.z_um > here.z_um:
                    # Up before across: nothing is known of what stands between the two.
                    await self._move(replace(here, z_um=step.target.z_um), step.speed_um_per_s)
                await self._move(step.target, step.speed_um_per_s)
                return None
            case TakePictures():
                await self._rest(step.settle_s)
                return Pictures(await self._take(step.count), self._tip())
            case _:
                raise TypeError(f"no such step: {step}")

    def _arm(self) -> None:
        """Arm the rig for the errand, unless it is.

        Raises:
            RefusedError: If it must not be armed, or somebody has stopped it.
        """
        errand = self._control.errand
        if errand.under_way:
            return
        if self._control.machine.mode in ARMED:
            raise RefusedError("ended", errand.ended or "the rig is armed: disarm it first")
        session = self._session
        errand.begin(lambda: self._objection(session), self._hesitates)
        try:
            self._control.submit(Ask.ARM, self._clock())
        except RefusedError:
            errand.pause()
            raise

    async def _move(self, target: StagePoint, speed_um_per_s: float) -> None:
        errand = self._control.errand
        away_um = _distance_um(self._tip(), target)
        errand.go(target, speed_um_per_s)
        deadline_s = self._clock() + 1.5 * away_um / speed_um_per_s + _SPARE_S
        while True:
            await self._rest(_POLL_S)
            if errand.waiting:
                deadline_s += _POLL_S
            tip = self._control.scene.tip
            if tip is not None and not tip.moving and _distance_um(tip.position, target) <= ARRIVED_UM:
                return
            if self._clock() > deadline_s:
                left_um = _distance_um(self._tip(), target)
                raise DeviceTimeoutError(f"the tip did not arrive: it is {left_um:.0f} µm from its target")

    async def _rest(self, span_s: float) -> None:
        """Let time pass, unless somebody has ended the motion.

        Raises:
            RefusedError: If so, with who and why.
        """
        await self._sleep(span_s)
        if self._control.errand.ended and not self._control.errand.under_way:
            raise RefusedError("ended", f"stopped: {self._control.errand.ended}")
        if self._cancelled:
            raise RefusedError("cancelled", "it was cancelled")

    async def _take(self, count: int) -> tuple[Frame, ...]:
        version, frames = self._frames.version, list[Frame]()
        while len(frames) < count + _OLD_FRAMES:
            try:
                async with asyncio.timeout(_FRAME_S):
                    frame, version = await self._frames.newer_than(version)
            except TimeoutError:
                raise RefusedError("no_frame", "the camera gives no pictures: see to it first") from None
            frames.append(frame)
        await self._rest(0.0)
        return tuple(frames[_OLD_FRAMES:])

    async def _disarm(self) -> None:
        """Bring the tip to rest, and the rig into DISARMED unless somebody stopped it."""
        control = self._control
        control.errand.pause()
        if control.machine.mode in ARMED:
            control.submit(Ask.DISARM, self._clock())
            deadline_s = self._clock() + _REST_S
            while control.machine.mode in ARMED and self._clock() < deadline_s:
                await self._sleep(_POLL_S)
        if self._procedure is not None and self._procedure.step is None:
            control.errand.release()

    def _keep(self, file: CalibrationFile) -> Calibration:
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            save_calibration(file, self._path)
        except OSError as error:
            raise ConfigError(f"{self._path} cannot be written ({error.strerror}): free the disk") from None
        return calibration_of(file, self._vessel)

    def _require(self, session: str) -> None:
        if self._moving:
            raise RefusedError("busy", "the tip is being moved: wait, or cancel")
        self._check(session)

    def _forget(self) -> None:
        self._procedure, self._cancelled = None, False
        self._put_back()
        self._control.errand.release()

    def _put_back(self) -> None:
        if self._scene is not None:
            self._scene.put_back()

    def _phase(self) -> str:
        if self._procedure is None:
            return "idle"
        if self._moving:
            return "stopping" if self._cancelled else "moving"
        return "done" if self._procedure.step is None else "waiting"

    def _tip(self) -> StagePoint:
        tip = self._control.scene.tip
        if tip is None or self._control.machine.mode in LATCHED:
            raise RefusedError("ended", self._control.machine.reason or "the manipulator gives no position")
        return tip.position


def _distance_um(a: StagePoint, b: StagePoint) -> float:
    return float(((a.array() - b.array()) ** 2).sum() ** 0.5)
