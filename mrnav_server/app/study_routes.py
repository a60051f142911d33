"""REST routes of a study that this server leads through (`mrnav serve --study`)."""

from typing import Any

from fastapi import APIRouter

from mrnav_server.app.context import Context, Operator
from mrnav_server.app.problems import ApiError
from mrnav_server.app.study_desk import StudyDesk

router = APIRouter(prefix="/study", tags=["study"])


@router.get("")
async def study_state(parts: Context) -> dict[str, Any]:
    """Return where the study stands and what comes next; 404 on a server without one."""
    return await _desk(parts).state()


@router.post("/next")
async def next_step(parts: Context, _: Operator) -> dict[str, Any]:
    """Begin the next step; 409 with the reason."""
    return await _desk(parts).next()


@router.post("/finish")
async def finish_step(parts: Context, _: Operator) -> dict[str, Any]:
    """End the step that is under way; its trial is a result."""
    return await _desk(parts).finish()


@router.post("/interrupt")
async def interrupt_step(parts: Context, _: Operator) -> dict[str, Any]:
    """Give up the step that is under way; it is done again."""
    return await _desk(parts).interrupt()


@router.post("/vessel", status_code=202)
async def change_vessel(parts: Context, principal: Operator) -> dict[str, str]:
    """Go by the vessel model that the next step needs; needs the lease and a rig at rest. All links break."""
    vessel = _desk(parts).next_vessel()
    await parts.vessels.change(principal.session, vessel)
    return {"vessel": vessel}


def _desk(parts: Context) -> StudyDesk:
    if parts.study is None:
        raise ApiError(404, "no_study", "this server leads no study: start it with --study FOLDER")
    return parts.study
