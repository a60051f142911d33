"""REST routes of the guided calibration."""

from typing import Annotated, Any

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field

from mrnav_server.app.context import Context, Operator

router = APIRouter(prefix="/calibration", tags=["calibration"])


class CalibrationBody(BaseModel):
    """The sheet that lies ready, and the water over the robot's centre; what is left out is as configured."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)

    square_um: Annotated[float, Field(gt=0)] | None = None
    columns: Annotated[int, Field(ge=2, le=100)] | None = None
    rows: Annotated[int, Field(ge=2, le=100)] | None = None
    water_depth_um: Annotated[float, Field(ge=0)]


@router.get("")
async def calibration(parts: Context) -> dict[str, Any]:
    """Return where the guided calibration stands: stage, progress, what is asked for, residuals."""
    return parts.rig.calibrating.state()


@router.post("/begin")
async def begin(parts: Context, body: CalibrationBody, principal: Operator) -> dict[str, Any]:
    """Begin the guided calibration; needs the lease, a disarmed rig and no trial."""
    sheet = body.model_dump(exclude={"water_depth_um"}, exclude_none=True)
    return parts.rig.calibrating.begin(principal.session, sheet, body.water_depth_um)


@router.post("/next")
async def proceed(parts: Context, principal: Operator) -> dict[str, Any]:
    """Go on: the bench is prepared as asked, and nobody's hand is near it."""
    return parts.rig.calibrating.next(principal.session)


@router.post("/cancel")
async def cancel(parts: Context, principal: Operator) -> dict[str, Any]:
    """Bring the tip to rest and forget what was measured; every operator may."""
    return parts.rig.calibrating.cancel()


@router.post("/use")
async def use(parts: Context, principal: Operator) -> dict[str, Any]:
    """Write the calibration into a file and go by it from here on."""
    return parts.rig.calibrating.use(principal.session)
