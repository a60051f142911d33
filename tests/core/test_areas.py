"""Critical areas in the order of their visits."""

import pytest

from mrnav_server.core.areas import CriticalAreas
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model


@pytest.fixture
def told() -> list[list[str]]:
    return []


@pytest.fixture
def areas(told: list[list[str]]) -> CriticalAreas:
    """Three areas, area-1 to area-3."""
    vessel = load_vessel_model(find_model("bifurcation"))
    marked = CriticalAreas(vessel, lambda: told.append([area.id for area in marked.list()]))
    for point, epsilon_um in zip(vessel.suggested_areas[:3], (100.0, 300.0, 500.0), strict=True):
        marked.add(point, epsilon_um, "")
    told.clear()
    return marked


def following(areas: CriticalAreas, area_id: str) -> str | None:
    area = areas.following(area_id)
    return area.id if area is not None else None


def test_every_area_has_its_own_radius(areas: CriticalAreas) -> None:
    assert [area.epsilon_um for area in areas.list()] == [100.0, 300.0, 500.0]


def test_one_area_follows_the_other_until_all_were_visited(
    areas: CriticalAreas, told: list[list[str]]
) -> None:
    areas.visit("area-1")
    assert following(areas, "area-1") == "area-2"
    areas.visit("area-2")
    assert following(areas, "area-2") == "area-3"
    areas.visit("area-3")
    assert following(areas, "area-3") is None
    assert len(told) == 3
    areas.visit("area-3")
    assert len(told) == 3, "an area is visited once"


def test_the_areas_can_be_told_again(areas: CriticalAreas, told: list[list[str]]) -> None:
    areas.tell()
    assert told == [["area-1", "area-2", "area-3"]]


def test_what_was_left_out_comes_after_the_last(areas: CriticalAreas) -> None:
    areas.visit("area-3")
    assert following(areas, "area-3") == "area-1"


def test_the_order_can_be_changed_and_the_visits_begin_anew(
    areas: CriticalAreas, told: list[list[str]]
) -> None:
    areas.visit("area-1")
    areas.reorder(["area-3", "area-1", "area-2"])
    assert [area.id for area in areas.list()] == ["area-3", "area-1", "area-2"]
    assert told[-1] == ["area-3", "area-1", "area-2"]
    assert areas.visited == frozenset()
    assert following(areas, "area-3") == "area-1"


@pytest.mark.parametrize(
    "ids", [["area-1"], ["area-1", "area-1", "area-2"], ["area-1", "area-2", "area-3", "area-4"]]
)
def test_an_order_names_every_area_once(areas: CriticalAreas, ids: list[str]) -> None:
    with pytest.raises(RefusedError, match="area-1, area-2, area-3"):
        areas.reorder(ids)


def test_an_area_that_was_moved_or_removed_is_not_visited(areas: CriticalAreas) -> None:
    for area_id in ("area-1", "area-2"):
        areas.visit(area_id)
    kept = areas.get("area-1")
    areas.replace("area-1", VesselPoint(kept.center.x_px + 1.0, kept.center.y_px), 100.0, "")
    areas.remove("area-2")
    areas.visit("area-2")
    assert areas.visited == frozenset()
    assert following(areas, "area-2") == "area-1"
