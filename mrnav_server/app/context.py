"""What every route works with, and who may call it."""

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends
from starlette.requests import HTTPConnection

from mrnav_server.app.auth import CHIEFS_ONLY, OPERATORS_ONLY, Gate, Principal, Role
from mrnav_server.app.problems import ApiError
from mrnav_server.app.rig_port import RigPort
from mrnav_server.app.twin import TwinHub
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
    """

    rig: RigPort
    gate: Gate
    twin: TwinHub
    encoder: VideoEncoder
    video: VideoHub
    vessel_png: bytes


def context(connection: HTTPConnection) -> AppContext:
    """Return the parts of the app that a request came to."""
    parts: AppContext = connection.app.state.context
    return parts


def viewer(connection: HTTPConnection) -> Principal:
    """Admit everybody with a token."""
    return context(connection).gate.admit(connection)


def operator(principal: Annotated[Principal, Depends(viewer)]) -> Principal:
    """Admit operators.

    Raises:
        ApiError: 403 for a viewer.
    """
    if principal.role < Role.OPERATOR:
        raise ApiError(403, "forbidden", OPERATORS_ONLY)
    return principal


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
Operator = Annotated[Principal, Depends(operator)]
