"""REST routes of the choice of the vessel."""

import asyncio
from typing import Annotated, Any

from fastapi import APIRouter, Path

from mrnav_server.app.context import Context, Operator

router = APIRouter(prefix="/vessels", tags=["rig"])


@router.get("")
async def vessels(parts: Context) -> list[dict[str, Any]]:
    """Return the vessel models that there are, and which one is in use."""
    return await asyncio.to_thread(parts.vessels.shelf.describe)


@router.post("/{name}/choose", status_code=202)
async def choose(
    parts: Context, principal: Operator, name: Annotated[str, Path(max_length=64)]
) -> dict[str, str]:
    """Go by another vessel model; needs the lease and a rig at rest. All links break and come back to it."""
    vessel = await asyncio.to_thread(parts.vessels.shelf.setting, name)
    await parts.vessels.change(principal.session, vessel)
    return {"vessel": name}
