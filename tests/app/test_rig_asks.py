"""What the rig does with asks while a path is being planned: whoever acts meanwhile wins."""

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

from mrnav_server.app.rig import Rig
from mrnav_server.autonomy.path import PathPlanner, PlannedPath
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import HandPoint, VesselPoint
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.modes import Ask, Mode
from mrnav_server.core.records import Track, TrackState
from mrnav_server.core.vessel import VesselMap
from mrnav_server.core.wire_hand import ClientFrame, Hello
from mrnav_server.loops.autopilot import PathOrder
from mrnav_server.settings import CameraConfig, RecordingConfig, Settings
from mrnav_server.sim.world import SimConfig
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model

HELLO = Hello(role="operator", token="", client="test", frame=ClientFrame.STAGE, rate_hz=60.0, simulated=True)


class Desk:
    """A rig that does not run: its clock is a number, its planner thinks until it is told to answer."""

    def __init__(self, folder: Path, planner: PathPlanner) -> None:
        self.now_s = 100.0
        settings = Settings(
            camera=CameraConfig(width_px=320, height_px=240),
            sim=SimConfig(image_um_per_px=75.0),
            recording=RecordingConfig(root=str(folder)),
        )
        self.rig = Rig(settings.with_tokens(), lambda: self.now_s)
        self.answer = asyncio.Event()
        self.planning = asyncio.Semaphore(0)
        self.told: list[tuple[bool, str, str]] = []
        """What the hand was told about its seat."""
        self._planner = planner
        self._seq = 0
        for index in (0, 1):
            self.rig.areas.add(self.rig.vessel.suggested_areas[index], 500.0, "")

    async def open(self) -> None:
        await self.rig.bench.manipulator.open()
        self.rig.navigator.autopilot.refusal = ""
        self.rig.navigator.plan = self._plan  # type: ignore[method-assign]
        self.rig.console.take_lease("page", "Dashboard")
        self.rig._hand_link.acquire("hand", HELLO, lambda *news: self.told.append(news))
        self.tick()
        await self.rig.console.ask("arm", "page", None)

    async def _plan(
        self, start: VesselPoint, target: VesselPoint, epsilon_um: float = math.inf
    ) -> PlannedPath:
        self.planning.release()
        await self.answer.wait()
        return self._planner.plan(start, target)

    def tick(self, *, clutch: bool = False) -> None:
        self.see()
        point = HandPoint(0.0, 0.0, 0.0)
        self.rig._hand_link.on_sample(
            HandSample("hand", self._seq, self.now_s, self.now_s, point, clutch, valid=True, new_pose=True)
        )

    def see(self) -> None:
        """A frame comes."""
        self.now_s += 0.01
        world = self.rig.bench.world
        assert world is not None
        robot = world.robot
        image = self.rig.calibration.image_point(robot)
        self.rig.control.scene.see(
            Track(self.now_s, self._seq, TrackState.TRACKING, image, robot, 1.0, 3.0, 99)
        )
        self._seq += 1

    @property
    def mode(self) -> Mode:
        return self.rig.control.machine.mode


@pytest.fixture(scope="module")
def vessel() -> VesselMap:
    return load_vessel_model(find_model("bifurcation"))


@pytest.fixture(scope="module")
def planner(vessel: VesselMap) -> PathPlanner:
    return PathPlanner(vessel)


@pytest.fixture
def desk(tmp_path: Path, vessel: VesselMap, planner: PathPlanner, monkeypatch: pytest.MonkeyPatch) -> Desk:
    monkeypatch.setattr("mrnav_server.app.rig.load_vessel_model", lambda _: vessel)
    return Desk(tmp_path, planner)


async def refusal_of_auto(desk: Desk, meanwhile: Callable[[], object], area: str | None = None) -> str:
    """Ask for AUTO, do something while the path is planned, and return why AUTO was refused; "" if not."""

    async def ask() -> str:
        try:
            await desk.rig.console.ask("auto", "page", area)
        except RefusedError as refused:
            return refused.code
        return ""

    async with asyncio.TaskGroup() as group:
        asking = group.create_task(ask())
        await desk.planning.acquire()
        meanwhile()
        desk.answer.set()
    return asking.result()


async def test_undisturbed_planning_ends_in_auto(desk: Desk) -> None:
    await desk.open()
    assert await refusal_of_auto(desk, desk.tick) == ""
    assert desk.mode is Mode.AUTO


async def test_a_hand_that_takes_hold_while_the_path_is_planned_keeps_hold(desk: Desk) -> None:
    await desk.open()
    assert await refusal_of_auto(desk, lambda: desk.tick(clutch=True)) == "overtaken"
    assert desk.mode is Mode.MANUAL
    assert desk.rig.hand.engaged
    assert desk.rig.navigator.autopilot.path_px == ()


@pytest.mark.parametrize(("ask", "mode"), [(Ask.HOLD, Mode.HOLD), (Ask.STOP, Mode.STOP)])
async def test_hold_and_stop_while_the_path_is_planned_last(desk: Desk, ask: Ask, mode: Mode) -> None:
    await desk.open()
    assert await refusal_of_auto(desk, lambda: desk.rig.control.submit(ask, desk.now_s)) == "overtaken"
    assert desk.mode is mode


async def test_hold_asked_in_hold_lasts_too(desk: Desk) -> None:
    await desk.open()
    await desk.rig.console.ask("hold", "page", None)
    hold = refusal_of_auto(desk, lambda: desk.rig.control.submit(Ask.HOLD, desk.now_s))
    assert await hold == "overtaken"
    assert desk.mode is Mode.HOLD


async def test_a_goal_that_is_removed_while_its_path_is_planned_is_not_driven_to(desk: Desk) -> None:
    await desk.open()
    goal = desk.rig.control.scene.area
    assert goal is not None
    assert await refusal_of_auto(desk, lambda: desk.rig.areas.remove(goal.id)) == "overtaken"


async def test_control_that_changes_hands_while_the_path_is_planned_starts_nothing(desk: Desk) -> None:
    await desk.open()

    def change() -> None:
        desk.rig.console.give_lease("page")
        desk.rig.console.take_lease("page-2", "Other")

    assert await refusal_of_auto(desk, change) == "no_lease"
    assert desk.mode is Mode.MANUAL


async def test_the_rig_holds_before_another_console_can_take_over(desk: Desk) -> None:
    await desk.open()
    desk.rig._hand_link.on_closed("hand")
    assert desk.mode is Mode.HOLD
    assert await refusal_of_auto(desk, desk.see) == ""
    desk.rig.console.give_lease("page")
    desk.rig.console.take_lease("page-2", "Other")
    assert desk.mode is Mode.HOLD


async def test_of_two_asks_for_auto_one_is_granted_with_its_own_goal(desk: Desk) -> None:
    await desk.open()
    codes: list[str] = []

    async def ask(area: str) -> None:
        try:
            await desk.rig.console.ask("auto", "page", area)
        except RefusedError as refused:
            codes.append(refused.code)
        else:
            codes.append("ok")

    async with asyncio.TaskGroup() as group:
        group.create_task(ask("area-1"))
        await desk.planning.acquire()
        group.create_task(ask("area-2"))
        await desk.planning.acquire()
        desk.answer.set()
    assert sorted(codes) == ["ok", "overtaken"]
    area = desk.rig.control.scene.area
    assert area is not None
    assert area.id == "area-2"
    assert desk.rig.navigator.autopilot._target == area.center


async def test_a_goal_that_was_removed_under_way_is_dropped_at_the_end(desk: Desk) -> None:
    await desk.open()
    await refusal_of_auto(desk, desk.tick)
    goal = desk.rig.control.scene.area
    assert goal is not None
    desk.rig.areas.remove(goal.id)
    assert desk.rig.control.scene.area == goal
    await desk.rig.console.ask("hold", "page", None)
    assert desk.rig.control.scene.area == desk.rig.areas.list()[0]


async def test_a_console_that_ends_autonomy_is_not_recorded_as_an_arrival(desk: Desk) -> None:
    await desk.open()
    await refusal_of_auto(desk, desk.tick)
    with desk.rig.events.subscribe() as events:
        await desk.rig.console.ask("manual", "page", None)
        told: list[dict[str, Any]] = [await events.get(), await events.get()]
    assert [event.get("by") for event in told if event["event"] == "handover"] == ["takeover"]


async def test_a_replan_that_is_refused_holds_and_the_rig_goes_on(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    await desk.open()
    await refusal_of_auto(desk, desk.tick)
    autopilot, area = desk.rig.navigator.autopilot, desk.rig.control.scene.area
    assert area is not None

    async def refuse(order: PathOrder) -> PlannedPath | None:
        raise RefusedError("no_path", "no path leads there")

    monkeypatch.setattr(desk.rig.navigator, "plan_order", refuse)
    monkeypatch.setattr("mrnav_server.app.navigator.ticks", _ticks_at_once)
    autopilot.order = PathOrder(area.center, area.center, back_off=False)
    async with asyncio.timeout(5), asyncio.TaskGroup() as group:
        planner = group.create_task(desk.rig.navigator.run(lambda: desk.now_s))
        async for now_s in _ticks_at_once(0.01, lambda: desk.now_s):
            if autopilot.stuck(now_s):
                planner.cancel()
                break
    desk.tick()
    assert desk.mode is Mode.HOLD
    assert "no path" in desk.rig.control.machine.reason


async def _ticks_at_once(period_s: float, clock: Callable[[], float]) -> AsyncIterator[float]:
    while True:
        await asyncio.sleep(0)
        yield clock()
