"""The running simulated rig, whose vessel lies elsewhere: registered by itself, by hand, kept, refused."""

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import orjson
import pytest

from mrnav_server.app.rig import Rig
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.modes import Mode
from mrnav_server.settings import RecordingConfig, ServerConfig, Settings
from mrnav_server.sim.world import SimConfig

PAGE = "page-1"


def settings_at(root: Path, shift_um: tuple[float, float] = (900.0, -600.0)) -> Settings:
    return Settings(
        server=ServerConfig(port=0, hand_port=0),
        recording=RecordingConfig(root=str(root)),
        sim=SimConfig(vessel_shift_um=shift_um, vessel_turn_deg=3.0),
    ).with_tokens()


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    # Built before the event loop runs: painting the microscope's floor takes a while.
    return Rig(settings_at(tmp_path))


@asynccontextmanager
async def running(rig: Rig) -> AsyncIterator[None]:
    started = asyncio.Event()
    async with asyncio.timeout(30), asyncio.TaskGroup() as group:
        task = group.create_task(rig.run(started))
        await started.wait()
        page = group.create_task(heartbeats(rig))
        yield
        page.cancel()
        task.cancel()


async def heartbeats(rig: Rig) -> None:
    """Be the page that keeps its lease."""
    while True:
        rig.console.heartbeat(PAGE)
        await asyncio.sleep(0.1)


def error_um(rig: Rig) -> float:
    """Return how far the rig misplaces the vessel's corners on the stage."""
    assert rig.bench.world is not None
    true, found = rig.bench.world.true_calibration, rig.calibration
    corners = [VesselPoint(200.0, 200.0), VesselPoint(1600.0, 200.0), VesselPoint(900.0, 1700.0)]
    return max(math.dist(true.stage_xy_um(corner), found.stage_xy_um(corner)) for corner in corners)


async def test_the_picture_registers_the_vessel_and_every_part_of_the_rig_goes_by_it(rig: Rig) -> None:
    before = rig.calibration
    async with running(rig):
        rig.console.take_lease(PAGE, "page")
        with rig.events.subscribe() as events:
            answer = await rig.registration.find(PAGE)
            told = await events.get()
            while told["event"] != "registration":
                told = await events.get()
        await until(rig, lambda: rig.control.scene.robot is not None)
        robot = rig.control.scene.robot
    assert answer["accepted"], answer["reason"]
    assert answer["overlap"] > 0.9
    assert answer["residual_um"] < 10.0
    assert answer["pose"]["dx_um"] == pytest.approx(900.0, abs=30.0)
    assert answer["pose"]["turn_deg"] == pytest.approx(3.0, abs=0.1)
    assert error_um(rig) < 30.0
    assert rig.calibration != before
    assert told["calibration"]["image_from_vessel"] == rig.calibration.image_from_vessel.rows()
    # The tracker goes by it, too.
    assert robot is not None
    assert rig.bench.world is not None
    assert robot.distance_px(rig.bench.world.robot) * 10.0 < 40.0


async def until(rig: Rig, condition: Callable[[], bool]) -> None:
    version = 0
    async with asyncio.timeout(10):
        while not condition():
            _, version = await rig.states.newer_than(version)


async def test_a_nudge_moves_the_model_and_says_how_it_fits(rig: Rig) -> None:
    async with running(rig):
        rig.console.take_lease(PAGE, "page")
        first = await rig.registration.adjust(PAGE, 900.0, -600.0, 0.0)
        second = await rig.registration.adjust(PAGE, 0.0, 0.0, 3.0)
        with pytest.raises(RefusedError) as refused:
            await rig.registration.adjust(PAGE, 5000.0, 0.0, 0.0)
    assert refused.value.code == "out_of_reach"
    assert second["overlap"] > first["overlap"]
    assert second["pose"] == {"dx_um": 900.0, "dy_um": -600.0, "turn_deg": 3.0}
    assert second["by"] == "hand"
    assert error_um(rig) < 1.0
    assert len(second["outline_px"]) == 1


async def test_another_calibration_voids_the_registration(rig: Rig) -> None:
    async with running(rig):
        rig.console.take_lease(PAGE, "page")
        base = rig.calibration
        first = await rig.registration.adjust(PAGE, 900.0, -600.0, 0.0)
        # As if the camera had been moved by 10 px.
        image = replace(base.image_from_vessel, tx=base.image_from_vessel.tx + 10.0)
        moved = replace(base, image_from_vessel=image)
        rig.registration.rebase(moved)
        state = rig.registration.state()
        kept = rig.registration.restore()
        again = await rig.registration.adjust(PAGE, 0.0, 0.0, 0.0)
    assert (state["registered"], state["pose"]["dx_um"]) == (False, 0.0)
    shift_px = np.array(state["outline_px"][0][0]) - first["outline_px"][0][0]
    # Back by the registration, 60 and -40 px, and on by what the calibration moved.
    assert shift_px == pytest.approx([-50.0, 40.0], abs=0.2)
    # The one on disk was made for the calibration before.
    assert "calibration" in kept
    assert again["pose"]["dx_um"] == 0.0
    assert rig.calibration.image_from_vessel.rows() == moved.image_from_vessel.rows()


async def test_it_needs_the_lease_and_a_disarmed_rig(rig: Rig) -> None:
    before = rig.calibration
    async with running(rig):
        with pytest.raises(RefusedError) as no_lease:
            await rig.registration.find(PAGE)
        rig.console.take_lease(PAGE, "page")
        await rig.console.ask("arm", PAGE, None)
        for ask in (rig.registration.find(PAGE), rig.registration.adjust(PAGE, 10.0, 0.0, 0.0)):
            with pytest.raises(RefusedError) as armed:
                await ask
            assert armed.value.code == "armed"
        assert rig.control.machine.mode is not Mode.DISARMED
    assert no_lease.value.code == "no_lease"
    assert rig.calibration == before


async def test_arming_during_the_search_wins(rig: Rig, tmp_path: Path) -> None:
    before = rig.calibration
    async with running(rig):
        rig.console.take_lease(PAGE, "page")
        async with asyncio.TaskGroup() as group:
            search = group.create_task(refused_code(rig))
            await asyncio.sleep(0.05)
            await rig.console.ask("arm", PAGE, None)
    assert search.result() == "armed"
    assert rig.calibration == before
    assert not (tmp_path / "registration.json").exists()


async def refused_code(rig: Rig) -> str:
    with pytest.raises(RefusedError) as refused:
        await rig.registration.find(PAGE)
    return refused.value.code


async def test_it_is_kept_and_a_stale_one_is_refused_with_a_warning(rig: Rig, tmp_path: Path) -> None:
    async with running(rig):
        rig.console.take_lease(PAGE, "page")
        await rig.registration.adjust(PAGE, 900.0, -600.0, 3.0)
    again = await asyncio.to_thread(Rig, settings_at(tmp_path))
    assert again.calibration == rig.calibration
    assert again.registration.state()["registered"]
    other = await asyncio.to_thread(Rig, settings_at(tmp_path, (0.0, 0.0)))
    assert not other.registration.state()["registered"]
    assert "another calibration, vessel model or rig" in other.control.surroundings.drift_warning()
    (tmp_path / "registration.json").write_bytes(orjson.dumps({"pose": "bad"}))
    broken = await asyncio.to_thread(Rig, settings_at(tmp_path))
    assert "is no registration" in broken.control.surroundings.drift_warning()


async def test_a_vessel_that_moves_during_the_session_is_told_and_keeps_auto_from_beginning(
    tmp_path: Path,
) -> None:
    still = Settings.model_validate({"drift": {"look_s": 0.2}, "sim": {}})
    settings = settings_at(tmp_path, (0.0, 0.0)).model_copy(update={"drift": still.drift, "sim": still.sim})
    rig = await asyncio.to_thread(Rig, settings)
    moved = await asyncio.to_thread(
        Rig, settings.model_copy(update={"sim": SimConfig(vessel_shift_um=(100.0, -98.0))})
    )
    async with running(rig):
        await until(rig, lambda: rig.sight.drift.moved_um is not None)
        assert rig.control.surroundings.drift_fault() == ""
        # The same camera over a vessel that somebody pushed.
        rig.bench.camera._render = moved.bench.camera._render  # type: ignore[attr-defined]
        await until(rig, lambda: "has moved by" in rig.control.facts.warning)
        assert "has moved by" in rig.control.surroundings.drift_fault()
