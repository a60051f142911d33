"""The calibration as the dashboard leads through it, on the simulated bench in lock-step: simulated time."""

import asyncio
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mrnav_server.app.calibration_bench import SimulatedBench
from mrnav_server.app.calibration_desk import CalibrationDesk
from mrnav_server.app.calibration_run import distorted, simulated_plan
from mrnav_server.autonomy.follower import Follower
from mrnav_server.autonomy.following import FollowerConfig
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import Calibration, HandPoint
from mrnav_server.core.hand import HandConfig, HandControl
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.lease import Lease
from mrnav_server.core.limits import Limits
from mrnav_server.core.modes import Ask, Mode
from mrnav_server.core.records import Frame
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.autopilot import Autopilot, AutopilotConfig
from mrnav_server.loops.control import ControlLoop
from mrnav_server.loops.guards import GuardConfig
from mrnav_server.loops.handover import HandoverConfig
from mrnav_server.loops.latest import Latest
from mrnav_server.settings import CameraConfig, Settings
from mrnav_server.sim.world import SimConfig
from mrnav_server.vision.calibration_file import load_calibration
from mrnav_server.vision.calibration_plan import CalibrationConfig, Prepare
from mrnav_server.vision.charuco import SheetConfig
from mrnav_server.vision.vessel_model import vessel_map

PAGE, OTHER = "page-1", "page-2"
TICK_S = 0.01
# A quarter of the pixels, so that it is over in seconds.
SMALL = distorted(
    Settings(camera=CameraConfig(width_px=800, height_px=600), sim=SimConfig(image_um_per_px=30.0))
)
# Fast, and by the fewest places that a calibration takes.
PLAN = simulated_plan(
    SMALL,
    CalibrationConfig(
        raster_z_um=(14_000.0, 11_500.0),
        travel_z_um=14_500.0,
        speed_um_per_s=4500.0,
        descent_speed_um_per_s=1000.0,
        descent_step_um=200.0,
        approach_run_um=1500.0,
        pictures=1,
        sheet_pictures=2,
        settle_s=0.1,
    ),
)
WATER_UM = PLAN.water_depth_um


@cache
def vessel() -> VesselMap:
    return vessel_map("open", np.full((1800, 1800), 255, np.uint8))


class Page:
    """A desk, the bench below it, and the page before it. Time passes while the desk waits, and only then."""

    def __init__(self, root: Path) -> None:
        self.bench = SimulatedBench(SMALL, 1800, 10.0, PLAN.sheet)
        self.lease = Lease()
        self.hand = HandControl(HandConfig(), 3000.0)
        self.alive = True
        self.put_backs = 0
        self.on_tick: Callable[[], None] = lambda: None
        self.used: list[Calibration] = []
        self.modes: list[str] = []
        self.commands: list[dict[str, Any]] = []
        self.events: list[str] = []
        calibration = self.bench.world.calibration
        autopilot = Autopilot(
            AutopilotConfig(source="geodesic"),
            Follower(FollowerConfig(), vessel(), calibration),
            4500.0,
            10.0,
            "",
        )
        self.control = ControlLoop(
            HandoverConfig(),
            GuardConfig(),
            Limits(),
            self.bench.manipulator,
            calibration,
            vessel(),
            self.lease,
            self.hand,
            autopilot,
            lambda topic, data: self.commands.append(data) if topic == "command" else None,
            lambda change: self.modes.append(change.after.value),
        )
        self.desk = CalibrationDesk(
            PLAN,
            SMALL.camera,
            SMALL.tracker,
            root,
            vessel(),
            lambda: True,
            self.control,
            _Frames(self),
            self._check,
            self._objection,
            lambda: not self.lease.console_heard_within(0.5, self.bench.clock()),
            self,
            self._use,
            lambda event, _: self.events.append(event),
            self.bench.clock,
            self.pass_time,
        )
        asyncio.run(self.bench.manipulator.open())
        self.bench.camera.open()
        self.lease.take_console(PAGE, "page", 0.0)
        self.control.step(0.0)

    async def follow(self, until: str, most: int = 8) -> None:
        """Be the person who does as asked, until the calibration is at a stage, or done."""
        async with asyncio.TaskGroup() as group:
            running = group.create_task(self.desk.run())
            try:
                for _ in range(most):
                    if self.phase in (until, "idle") or self.desk.state()["stage"] == until:
                        return
                    self.desk.next(PAGE)
                    while self.phase in ("moving", "stopping"):  # noqa: ASYNC110 - time passes meanwhile
                        await asyncio.sleep(0)
                    if self.desk.state()["refusal"]:
                        return
            finally:
                running.cancel()
                with suppress(asyncio.CancelledError):
                    await running

    @property
    def phase(self) -> str:
        return str(self.desk.state()["phase"])

    @property
    def mode(self) -> Mode:
        return self.control.machine.mode

    def tick(self) -> None:
        now_s = self.bench.clock()
        if self.alive:
            self.lease.hear(PAGE, now_s)
        self.control.step(now_s)
        self.on_tick()

    async def pass_time(self, span_s: float) -> None:
        for _ in range(math.ceil(span_s / TICK_S - 1e-6)):
            await self.bench.sleep(TICK_S)
            self.tick()
            await asyncio.sleep(0)
        await asyncio.sleep(0)

    def _check(self, session: str) -> None:
        if not self.lease.holds(session):
            raise RefusedError("no_lease", "take the lease first")
        if self.mode is not Mode.DISARMED:
            raise RefusedError("armed", "disarm first")

    def _objection(self, session: str) -> str:
        return "" if self.lease.holds(session) else "the page fell silent"

    async def lay(self, scene: str, sheet: SheetConfig) -> None:
        assert sheet == PLAN.sheet
        assert self.mode is Mode.DISARMED
        # Drawing the sheet is a second's work on a busy machine: not in the loop.
        await asyncio.to_thread(asyncio.run, self.bench.prepare(Prepare("", "", 0.0, scene)))

    def put_back(self) -> None:
        self.put_backs += 1

    def _use(self, calibration: Calibration) -> None:
        self.control.recalibrate(calibration)
        self.used.append(calibration)


class _Frames(Latest[Frame]):
    """Pictures taken when they are looked at."""

    def __init__(self, page: Page) -> None:
        super().__init__()
        self._page = page

    async def newer_than(self, version: int) -> tuple[Frame, int]:
        frame = await asyncio.to_thread(self._page.bench.camera.read, 2.0)
        self._page.tick()
        self.put(frame)
        return frame, self.version


@pytest.fixture
def page(tmp_path: Path) -> Page:
    return Page(tmp_path)


def begun(page: Page) -> Page:
    page.desk.begin(PAGE, {}, WATER_UM)
    return page


def stages_done(state: Mapping[str, Any]) -> list[bool]:
    return [stage["done"] for stage in state["stages"]]


def cancelled(page: Page) -> None:
    page.desk.cancel()


async def to_the_tip(page: Page) -> None:
    """Go on to where the tip is about to move."""
    await begun(page).follow("tip")
    assert page.desk.state()["stage"] == "tip"


async def test_the_whole_calibration_through_the_control_loop(page: Page, tmp_path: Path) -> None:
    await begun(page).follow("done")
    state = page.desk.state()
    assert state["refusal"] == ""
    assert state["phase"] == "done"
    assert all(stages_done(state))
    for figure in (figure for stage in state["stages"] for figure in stage["figures"]):
        assert figure["bound_um"] is None or figure["value_um"] <= figure["bound_um"]
    # Armed in HOLD and nothing else, and at rest whenever a person was at the bench.
    assert set(page.modes) == {"HOLD", "DISARMED"}
    assert page.mode is Mode.DISARMED
    assert page.control.drive.counters["clamped"] == 0
    speeds = [c["speed_um_per_s"] for c in page.commands]
    assert max(speeds) < 1.2 * 4500.0
    used = page.desk.use(PAGE)
    assert used["setting"] == f'rig.calibration = "{tmp_path / "calibration.json"}"'
    kept = load_calibration(tmp_path / "calibration.json", SMALL.camera, vessel(), simulated=True)
    assert page.used == [kept]
    assert page.events == ["calibration"]
    assert page.put_backs == 1
    true = page.bench.world.true_calibration
    assert abs(kept.critical_height_um / true.critical_height_um - 1.0) < 0.02
    assert math.dist(kept.magnet_offset_um, true.magnet_offset_um) < 50.0


@pytest.mark.parametrize("ask", [Ask.STOP, Ask.HOLD, Ask.DISARM])
async def test_any_ask_ends_the_motion(page: Page, ask: Ask) -> None:
    await to_the_tip(page)
    asked_at: list[float] = []

    def press() -> None:
        if len(page.commands) > 100 and not asked_at:
            asked_at.append(page.bench.clock())
            page.control.submit(ask, page.bench.clock())

    page.on_tick = press
    await page.follow("done", 1)
    assert ask.value in page.desk.state()["refusal"].lower()
    assert page.phase == "waiting"
    assert page.mode is (Mode.STOP if ask is Ask.STOP else Mode.DISARMED)
    # A jerk-limited rest takes 0.2 s from 2 mm/s, a STOP nothing.
    late = [c for c in page.commands if c["sent_s"] > asked_at[0] + (0.0 if ask is Ask.STOP else 0.4)]
    assert not late
    assert not page.bench.world.moving


async def test_a_silent_page_ends_the_motion(page: Page) -> None:
    await to_the_tip(page)

    def fall_silent() -> None:
        page.alive = len(page.commands) < 100

    page.on_tick = fall_silent
    await page.follow("done", 1)
    assert "silent" in page.desk.state()["refusal"]
    assert not page.bench.world.moving
    assert page.mode is Mode.DISARMED


async def test_the_tip_rests_while_its_page_is_silent_and_goes_on(page: Page) -> None:
    await to_the_tip(page)
    silent_s: list[float] = []
    moving: dict[int, bool] = {}

    def fall_silent() -> None:
        now_s = page.bench.clock()
        if len(page.commands) > 100 and not silent_s:
            silent_s.append(now_s)
        if not silent_s:
            return
        page.alive = now_s > silent_s[0] + 1.5
        moving[round(10.0 * (now_s - silent_s[0]))] = page.bench.world.moving
        if now_s > silent_s[0] + 3.0:
            page.desk.cancel()

    page.on_tick = fall_silent
    await page.follow("done", 1)
    assert moving[2]
    assert not any(moving[tenth] for tenth in range(10, 15))
    assert any(moving[tenth] for tenth in range(16, 30))
    assert "cancelled" in page.desk.state()["refusal"]


async def test_a_fault_ends_the_motion_and_the_stage_begins_again(page: Page) -> None:
    await to_the_tip(page)
    page.on_tick = lambda: page.control.fail("somebody pulled a cable") if len(page.commands) == 100 else None
    await page.follow("done", 1)
    assert "cable" in page.desk.state()["refusal"]
    assert page.mode is Mode.FAULT
    with pytest.raises(RefusedError, match="disarm"):
        page.desk.next(PAGE)
    page.on_tick = lambda: None
    await page.pass_time(3.0)
    page.control.submit(Ask.RESET, page.bench.clock())
    await page.follow("height", 1)
    assert page.desk.state()["refusal"] == ""
    assert stages_done(page.desk.state())[:2] == [True, True]


async def test_neither_hand_nor_policy_moves_the_tip_meanwhile(page: Page) -> None:
    await to_the_tip(page)
    page.lease.take_hand("hand", "glove", page.bench.clock())
    refused: list[str] = []
    sent = 0

    def interfere() -> None:
        nonlocal sent
        sent += 1
        now_s = page.bench.clock()
        page.lease.hear("hand", now_s)
        point = HandPoint(0.001 * sent, 0.0, 0.0)
        closed = sent > 10
        page.hand.on_sample(HandSample("hand", sent, now_s, now_s, point, closed, True, True))
        if sent % 20 == 0:
            for ask in (Ask.MANUAL, Ask.AUTO, Ask.ARM):
                with pytest.raises(RefusedError) as error:
                    page.control.submit(ask, now_s)
                refused.append(error.value.code)

    page.on_tick = interfere
    await page.follow("height", 1)
    assert page.desk.state()["refusal"] == ""
    assert len(refused) > 30
    assert "MANUAL" not in page.modes
    assert not page.hand.engaged


def test_only_the_holder_leads_and_only_disarmed(page: Page) -> None:
    with pytest.raises(RefusedError, match="lease"):
        page.desk.begin(OTHER, {}, WATER_UM)
    page.control.submit(Ask.ARM, 0.0)
    with pytest.raises(RefusedError, match="disarm"):
        page.desk.begin(PAGE, {}, WATER_UM)
    page.control.submit(Ask.DISARM, 0.0)
    page.control.step(0.01)
    begun(page)
    with pytest.raises(RefusedError, match="lease"):
        page.desk.next(OTHER)
    with pytest.raises(RefusedError) as again:
        page.desk.begin(PAGE, {}, WATER_UM)
    with pytest.raises(RefusedError) as early:
        page.desk.use(PAGE)
    assert (again.value.code, early.value.code) == ("busy", "unfinished")
    # Nobody arms while a person is at the bench.
    with pytest.raises(RefusedError) as arm:
        page.control.submit(Ask.ARM, 0.02)
    assert arm.value.code == "busy"


def test_cancelling_forgets_and_lets_the_hand_in_again(page: Page) -> None:
    begun(page)
    assert page.desk.cancel()["phase"] == "idle"
    page.control.submit(Ask.ARM, 0.02)
    assert page.mode is Mode.HOLD


async def test_cancelling_under_way_brings_the_tip_to_rest(page: Page) -> None:
    await to_the_tip(page)
    page.on_tick = lambda: None if len(page.commands) < 100 else cancelled(page)
    await page.follow("done", 1)
    assert page.phase == "idle"
    assert page.mode is Mode.DISARMED
    assert not page.bench.world.moving
    assert not page.control.errand.reserved


def test_a_sheet_that_cannot_be_is_refused(page: Page) -> None:
    with pytest.raises(RefusedError, match="square_um"):
        page.desk.begin(PAGE, {"square_um": 1.0}, WATER_UM)
    with pytest.raises(RefusedError, match="water_depth_um"):
        page.desk.begin(PAGE, {}, 1e6)
    assert page.phase == "idle"
