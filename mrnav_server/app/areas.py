"""REST routes of the critical areas."""

from typing import Any

from fastapi import APIRouter, Response

from mrnav_server.app.context import AppContext, Context, Operator
from mrnav_server.app.schemas import AreaBody, OrderBody
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.wire_twin import area_fields

router = APIRouter(prefix="/critical-areas", tags=["critical areas"])


@router.get("")
async def list_areas(parts: Context) -> list[dict[str, Any]]:
    """Return all critical areas, in the order of their visits."""
    return _fields(parts)


@router.post("", status_code=201)
async def add_area(parts: Context, body: AreaBody, _: Operator, response: Response) -> dict[str, Any]:
    """Mark a critical area; 409 with the reason where the robot cannot go."""
    area = parts.rig.areas.add(_center(parts, body), body.epsilon_um, body.label)
    response.headers["Location"] = f"/api/v1/critical-areas/{area.id}"
    return area_fields(area, _active(parts), parts.rig.areas.visited)


@router.put("")
async def reorder_areas(parts: Context, body: OrderBody, _: Operator) -> list[dict[str, Any]]:
    """Change the order of the visits; 409 unless every area is named once."""
    parts.rig.areas.reorder(body.order)
    return _fields(parts)


@router.get("/{area_id}")
async def get_area(parts: Context, area_id: str) -> dict[str, Any]:
    """Return one critical area."""
    return area_fields(parts.rig.areas.get(area_id), _active(parts), parts.rig.areas.visited)


@router.put("/{area_id}")
async def replace_area(parts: Context, area_id: str, body: AreaBody, _: Operator) -> dict[str, Any]:
    """Change a critical area; 409 with the reason where the robot cannot go."""
    area = parts.rig.areas.replace(area_id, _center(parts, body), body.epsilon_um, body.label)
    return area_fields(area, _active(parts), parts.rig.areas.visited)


@router.post("/{area_id}/choose", status_code=204)
async def choose_area(parts: Context, area_id: str, _: Operator) -> None:
    """Make an area the goal, also of a trial that is steered by hand; 409 while autonomy drives."""
    parts.rig.console.choose_area(area_id)


@router.delete("/{area_id}", status_code=204)
async def remove_area(parts: Context, area_id: str, _: Operator) -> None:
    """Forget a critical area."""
    parts.rig.areas.remove(area_id)


def _center(parts: AppContext, body: AreaBody) -> VesselPoint:
    return parts.rig.to_vessel(body.center.frame, body.center.x, body.center.y)


def _fields(parts: AppContext) -> list[dict[str, Any]]:
    active = _active(parts)
    return [area_fields(area, active, parts.rig.areas.visited) for area in parts.rig.areas.list()]


def _active(parts: AppContext) -> str | None:
    state = parts.rig.states.value
    return state.critical_area if state else None
