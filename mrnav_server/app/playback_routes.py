"""REST routes of a trial's playback: its columns over time, and its film picture by picture."""

import asyncio
from functools import lru_cache
from pathlib import Path
from typing import Any

import orjson
from fastapi import APIRouter, Response

from mrnav_server.app.context import Context
from mrnav_server.app.playback import playback
from mrnav_server.app.problems import ApiError
from mrnav_server.app.rig_port import RigPort
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.film_index import FilmFrame, film_frames, film_picture
from mrnav_server.loops.trial_log import TrialInfo, read_trial, trial_folder
from mrnav_server.loops.video_recorder import VIDEO_NAME
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model
from mrnav_server.vision.vessel_outline import walls_px

router = APIRouter(prefix="/trials", tags=["results"])


@router.get("/{trial_id}/playback")
async def get_playback(parts: Context, trial_id: str) -> Response:
    """Return what happened in a trial, track by track; 409 while it runs."""
    content = await asyncio.to_thread(_playback, _root(parts.rig), trial_id, parts.rig.vessel)
    return Response(content, media_type="application/json")


@router.get("/{trial_id}/film/{number}.jpg")
async def get_picture(parts: Context, trial_id: str, number: int) -> Response:
    """Return one picture of a trial's film, counted from 0."""
    jpeg = await asyncio.to_thread(_picture, _root(parts.rig), trial_id, number)
    return Response(jpeg, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=3600"})


def _playback(root: Path, trial_id: str, vessel: VesselMap) -> bytes:
    info = read_trial(root, trial_id)
    if info.status == "running":
        raise ApiError(
            409, "trial_running", f"trial {trial_id} still runs: it can be played once it has ended"
        )
    folder = trial_folder(root, trial_id)
    fields = playback(folder, _frames(folder / VIDEO_NAME))
    return orjson.dumps(fields | {"status": info.status} | _drawn_vessel(info, vessel))


def _picture(root: Path, trial_id: str, number: int) -> bytes:
    film = trial_folder(root, trial_id) / VIDEO_NAME
    frames = _frames(film)
    if not 0 <= number < len(frames):
        raise ApiError(404, "no_picture", f"the film of trial {trial_id} has {len(frames)} pictures")
    return film_picture(film, frames[number])


def _frames(film: Path) -> tuple[FilmFrame, ...]:
    """Return a film's pictures; a film that still grows is read anew."""
    return _indexed(film, film.stat().st_size) if film.is_file() else ()


@lru_cache(maxsize=4)
def _indexed(film: Path, _size: int) -> tuple[FilmFrame, ...]:
    return tuple(film_frames(film))


def _drawn_vessel(info: TrialInfo, vessel: VesselMap) -> dict[str, Any]:
    """Return the vessel that the trial was in; without walls if its model is not here any more."""
    wanted = info.header.vessel_sha256
    if vessel.digest != wanted:
        vessel = _other_vessel(info.header.vessel) or vessel
    known = vessel.digest == wanted
    return {
        "size_px": vessel.size_px,
        "robot_radius_px": vessel.robot_radius_px,
        "walls_px": walls_px(vessel) if known else [],
    }


@lru_cache(maxsize=2)
def _other_vessel(name: str) -> VesselMap | None:
    try:
        return load_vessel_model(find_model(name))
    except ConfigError:
        return None


def _root(rig: RigPort) -> Path:
    return Path(rig.settings.recording.root).absolute()
