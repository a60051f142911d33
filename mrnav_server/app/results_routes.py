"""REST routes of the results: metrics, live and afterwards, and what is drawn of a trial."""

import asyncio
from pathlib import Path
from typing import Any

import orjson
from fastapi import APIRouter, Response

from mrnav_server.app.context import Context, Operator
from mrnav_server.app.problems import ApiError
from mrnav_server.app.reporting import ReportError, trial_report
from mrnav_server.app.rig_port import RigPort
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.metric_flags import FLAGS
from mrnav_server.loops.tlx_record import read_tlx
from mrnav_server.loops.trial_log import TrialInfo, list_trials, read_trial, trial_folder

router = APIRouter(tags=["results"])

_RESULT, _TRAJECTORY = "result.json", "trajectory.json"


@router.get("/results")
async def results(parts: Context) -> Response:
    """Return every trial with its result and workload scores, newest first; null where there is none."""
    counted = parts.study.results() if parts.study is not None else None
    found = await asyncio.to_thread(_results, _root(parts.rig), counted)
    return _json({"flags": FLAGS, "trials": found})


@router.get("/trials/{trial_id}/result")
async def get_result(parts: Context, trial_id: str) -> Response:
    """Return a trial's result: while it runs, its metrics up to now; then what its report says."""
    live = await parts.rig.trials.live_metrics(trial_id)
    if live is not None:
        return _json({**live, "live": True})
    return await asyncio.to_thread(_file, _root(parts.rig), trial_id, _RESULT)


@router.post("/trials/{trial_id}/result")
async def make_result(parts: Context, trial_id: str, _: Operator) -> dict[str, Any]:
    """Make an ended or interrupted trial's report again, from its log."""
    root = _root(parts.rig)
    info = await asyncio.to_thread(read_trial, root, trial_id)
    if info.status == "running":
        raise ApiError(409, "trial_running", f"trial {trial_id} still runs: end it first")
    try:
        return await trial_report(trial_folder(root, trial_id))
    except ReportError as error:
        raise ApiError(409, "no_report", str(error)) from None


@router.get("/trials/{trial_id}/trajectory")
async def trajectory(parts: Context, trial_id: str) -> Response:
    """Return a finished trial's filtered path in the vessel's grid, its speed, its contacts and the walls."""
    return await asyncio.to_thread(_file, _root(parts.rig), trial_id, _TRAJECTORY)


def _results(root: Path, counted: frozenset[str] | None) -> list[dict[str, Any]]:
    return [
        _summary(root, info) | {"in_study": None if counted is None else info.id in counted}
        for info in reversed(list_trials(root))
    ]


def _summary(root: Path, info: TrialInfo) -> dict[str, Any]:
    folder, head = trial_folder(root, info.id), info.header
    try:
        answered = read_tlx(folder)
    except ConfigError:
        answered = None
    scores = answered.answers.workload() if answered else None
    try:
        result: dict[str, Any] | None = orjson.loads((folder / _RESULT).read_bytes())
    except (FileNotFoundError, orjson.JSONDecodeError):
        result = None
    return {
        "id": info.id,
        "status": info.status,
        "participant": head.participant,
        "condition": head.condition,
        "operator_kind": head.operator_kind,
        "simulated_rig": head.simulated_rig,
        "simulated": head.simulated_rig or head.operator_kind == "simulated",
        "vessel": head.vessel,
        "notes": head.notes,
        "reached": result["reached"] if result else None,
        "metrics": result["metrics"] if result else None,
        "tlx": {"weighted": scores.weighted, "raw": scores.raw} if scores else None,
    }


def _file(root: Path, trial_id: str, name: str) -> Response:
    try:
        return Response((trial_folder(root, trial_id) / name).read_bytes(), media_type="application/json")
    except FileNotFoundError:
        raise ApiError(
            404,
            "no_result",
            f"trial {trial_id} has no {name} yet: end it, or POST /api/v1/trials/{trial_id}/result",
        ) from None


def _root(rig: RigPort) -> Path:
    return Path(rig.settings.recording.root).absolute()


def _json(content: object) -> Response:
    return Response(orjson.dumps(content), media_type="application/json")
