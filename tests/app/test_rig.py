"""The rig's answers that need no running device."""

import pytest

from mrnav_server.app.rig import Rig
from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.settings import RigConfig, Settings


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig(Settings().with_tokens())


async def test_the_first_area_becomes_the_active_one_and_everybody_is_told(rig: Rig) -> None:
    with rig.events.subscribe() as events:
        first = rig.areas.add(rig.vessel.suggested_areas[0], 500, "")
        second = rig.areas.add(rig.vessel.suggested_areas[1], 500, "")
        told = [await events.get(), await events.get()]
    assert rig.control.scene.area == first
    assert [area["active"] for area in told[1]["critical_areas"]] == [True, False]
    rig.areas.remove(first.id)
    assert rig.control.scene.area == second
    rig.areas.remove(second.id)
    assert rig.control.scene.area is None


async def test_asks_need_the_lease_and_stop_does_not(rig: Rig) -> None:
    with pytest.raises(RefusedError, match="nobody has control"):
        await rig.console.ask("arm", "page-1", None)
    rig.console.take_lease("page-1", "Dashboard")
    with pytest.raises(RefusedError, match="Dashboard has control"):
        await rig.console.ask("arm", "page-2", None)
    rig.console.give_lease("page-1")


def test_points_of_all_frames_mean_the_same_place(rig: Rig) -> None:
    point = VesselPoint(700.0, 900.0)
    image = rig.calibration.image_point(point)
    stage = rig.calibration.stage_xy_um(point)
    for frame, x, y in (("vessel", 700.0, 900.0), ("image", image.x_px, image.y_px), ("stage", *stage)):
        assert rig.to_vessel(frame, x, y).distance_px(point) < 1e-6


def test_a_rig_that_does_not_run_is_not_ready(rig: Rig) -> None:
    assert rig.readiness() == ["the rig is starting or has stopped"]


def test_an_unknown_vessel_model_names_those_that_there_are() -> None:
    with pytest.raises(ConfigError, match="bifurcation"):
        Rig(Settings(rig=RigConfig(vessel="nowhere")).with_tokens())
