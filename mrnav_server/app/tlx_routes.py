"""REST routes of the questionnaires: NASA-TLX, asked after a trial (docs/tlx.md)."""

import asyncio
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Response

from mrnav_server.app.auth import Role
from mrnav_server.app.context import Context, Operator, Viewer
from mrnav_server.app.problems import ApiError
from mrnav_server.app.rig_port import RigPort
from mrnav_server.app.schemas import TlxBody
from mrnav_server.core.tlx import MARK_STEP, SCALES, Choice, shown_pairs
from mrnav_server.loops.tlx_record import TlxAnswers, keep_tlx, read_tlx, tlx_csv
from mrnav_server.loops.trial_log import read_trial, trial_folder

router = APIRouter(tags=["questionnaires"])


@router.get("/trials/{trial_id}/tlx")
async def get_tlx(parts: Context, trial_id: str) -> dict[str, Any]:
    """Return a trial's questionnaire with its scores."""
    record = await asyncio.to_thread(read_tlx, trial_folder(_root(parts.rig), trial_id))
    if record is None:
        raise ApiError(404, "no_tlx", f"trial {trial_id} has none yet: open /tlx?trial={trial_id}")
    return record.fields()


@router.post("/trials/{trial_id}/tlx")
async def post_tlx(parts: Context, trial_id: str, body: TlxBody, _: Operator) -> dict[str, Any]:
    """Store a trial's questionnaire; the same one again changes nothing, another one needs ``replace``."""
    answers = TlxAnswers(
        body.ratings, tuple(Choice(each.left, each.right, each.chosen) for each in body.choices)
    )
    now_wall = datetime.now(UTC).timestamp()
    root = _root(parts.rig)
    record = await asyncio.to_thread(keep_tlx, root, trial_id, answers, now_wall, replace=body.replace)
    return record.fields()


@router.get("/trials/{trial_id}/tlx/form")
async def tlx_form(parts: Context, trial_id: str, principal: Viewer) -> dict[str, Any]:
    """Return what to ask after a trial: the scales, and the pairs in this trial's own random order."""
    form = await asyncio.to_thread(_form, _root(parts.rig), trial_id)
    return {**form, "may_answer": principal.role >= Role.OPERATOR}


@router.get("/tlx.csv")
async def all_tlx(parts: Context) -> Response:
    """Return every questionnaire as CSV, one row a trial."""
    text = await asyncio.to_thread(tlx_csv, _root(parts.rig))
    return Response(text, media_type="text/csv; charset=utf-8")


def _form(root: Path, trial_id: str) -> dict[str, Any]:
    info = read_trial(root, trial_id)
    return {
        "trial": trial_id,
        "participant": info.header.participant,
        "condition": info.header.condition,
        "operator_kind": info.header.operator_kind,
        "simulated_rig": info.header.simulated_rig,
        "status": info.status,
        "filled": read_tlx(trial_folder(root, trial_id)) is not None,
        "scales": [asdict(scale) for scale in SCALES],
        "mark_step": MARK_STEP,
        "pairs": shown_pairs(trial_id),
    }


def _root(rig: RigPort) -> Path:
    return Path(rig.settings.recording.root).absolute()
