"""What every route works with, and who may call it.

What routes depend on is async: FastAPI runs a plain function in a thread, for which the request waits.
"""

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends
from starlette.requests import HTTPConnection

from mrnav_server.app.auth import CHIEFS_ONLY, OPERATORS_ONLY, Gate, Principal, Role
from mrnav_server.app.problems import ApiError
from mrnav_server.app.rig_port import RigPort
from mrnav_server.app.study_desk import StudyDesk
from mrnav_server.app.training_desk import TrainingDesk
from mrnav_server.app.twin import TwinHub
from mrnav_server.app.vessel_desk import VesselDesk
from mrnav_server.app.video import VideoEncoder, VideoHub


@dataclass(frozen=True, slots=True)
class AppContext:
    """The parts of a running app.

    Attributes:
        rig: The rig.
        gate: Lets requests in.
        twin: Serves ``/ws/twin``.
        encoder: Turns the newest frame into JPEG.
        video: Serves ``/ws/video`` and ``/video.mjpeg``.
        vessel_png: The vessel's mask; encoding it takes longer than a control tick.
        study: The study that it leads through; None without one.
        training: Makes vessel models and policies for pages.
        vessels: Changes the vessel model.
    """

    rig: RigPort
    gate: Gate
    twin: TwinHub
    encoder: VideoEncoder
    video: VideoHub
    vessel_png: bytes
    study: StudyDesk | None
    training: TrainingDesk
    vessels: VesselDesk


async def context(connection: HTTPConnection) -> AppContext:
    """Return the parts of the app that a request came to."""
    parts: AppContext = connection.app.state.context
    return parts


async def viewer(connection: HTTPConnection) -> Principal:
    """Admit everybody with a token."""
    return (await context(connection)).gate.admit(connection)


def operator(principal: Principal) -> Principal:
    """Admit operators.

    Raises:
        ApiError: 403 for a viewer.
    """
    if principal.role < Role.OPERATOR:
        raise ApiError(403, "forbidden", OPERATORS_ONLY)
    return principal


async def _operator(principal: Annotated[Principal, Depends(viewer)]) -> Principal:
    return operator(principal)


def chief(principal: Principal) -> Principal:
    """Admit chiefs.

    Raises:
        ApiError: 403 for everybody else.
    """
    if principal.role < Role.CHIEF:
        raise ApiError(403, "forbidden", CHIEFS_ONLY)
    return principal


Context = Annotated[AppContext, Depends(context)]
Viewer = Annotated[Principal, Depends(viewer)]
Operator = Annotated[Principal, Depends(_operator)]
