"""REST routes of the trials."""

import asyncio
from typing import Any

from fastapi import APIRouter

from mrnav_server.app.context import Context, Operator
from mrnav_server.app.problems import ApiError
from mrnav_server.app.schemas import TrialBody

router = APIRouter(prefix="/trials", tags=["trials"])


@router.get("")
async def list_trials(parts: Context) -> list[dict[str, Any]]:
    """Return all trials, oldest first; they are read from the disk, which the rig must not wait for."""
    return await asyncio.to_thread(parts.rig.trials.list)


@router.post("", status_code=201)
async def start_trial(parts: Context, body: TrialBody, _: Operator) -> dict[str, Any]:
    """Begin a trial; 409 with the reason while another runs, or if a study leads."""
    if parts.study is not None:
        parts.study.require_own_trials()
    return parts.rig.trials.start(body.participant, body.condition, body.operator_kind, body.notes)


@router.get("/{trial_id}")
async def get_trial(parts: Context, trial_id: str) -> dict[str, Any]:
    """Return one trial; its id is only ever compared, never a path."""
    for trial in await list_trials(parts):
        if trial["id"] == trial_id:
            return trial
    raise ApiError(404, "no_such_trial", f"there is no trial {trial_id!r}")


@router.post("/{trial_id}/end")
async def end_trial(parts: Context, trial_id: str, _: Operator) -> dict[str, Any]:
    """End the running trial and return its result."""
    return await parts.rig.trials.end(trial_id)
