"""REST routes of the vessel's registration."""

from typing import Any

from fastapi import APIRouter

from mrnav_server.app.context import Context, Operator
from mrnav_server.app.schemas import RegistrationBody

router = APIRouter(prefix="/registration", tags=["registration"])


@router.get("")
async def registration(parts: Context) -> dict[str, Any]:
    """Return where the vessel lies by the registration in use, and its outline in the picture."""
    return parts.rig.registration.state()


@router.post("")
async def register(parts: Context, body: RegistrationBody, principal: Operator) -> dict[str, Any]:
    """Register the vessel from the picture, or move it by hand; needs the lease, and a disarmed rig."""
    desk = parts.rig.registration
    if body.auto:
        return await desk.find(principal.session)
    return await desk.adjust(principal.session, body.dx_um, body.dy_um, body.turn_deg)
