"""REST routes of the rig: health, state, control, picture; and the WebSockets."""

import asyncio
from typing import Annotated, Any, Literal

import orjson
from fastapi import APIRouter, Depends, Query, Response, WebSocket

from mrnav_server.app import (
    areas,
    calibration_routes,
    playback_routes,
    registration_routes,
    results_routes,
    study_routes,
    tlx_routes,
    training_routes,
    trials,
    vessel_routes,
)
from mrnav_server.app.auth import SESSION_HEADER
from mrnav_server.app.context import Context, Operator, Viewer, chief, operator, viewer
from mrnav_server.app.metrics_endpoint import CONTENT_TYPE, RigCollector
from mrnav_server.app.problems import ApiError, problem
from mrnav_server.app.schemas import HandBody, LeaseBody, ModeBody
from mrnav_server.app.twin_scene import ToolShape, scene_glb
from mrnav_server.app.twin_schema import twin_schema
from mrnav_server.core.wire_twin import twin_state, vessel_fields

Width = Annotated[int, Query(ge=64, le=4096, description="Width of the picture in px, in steps of 16")]
Quality = Annotated[int, Query(ge=10, le=95, description="JPEG quality, in steps of 5")]
Codec = Annotated[Literal["jpeg", "h264"], Query(description="What is taken besides JPEG")]
RateHz = Annotated[float, Query(ge=1, le=120, allow_inf_nan=False, description="States a second at most")]

health = APIRouter(tags=["health"])
streams = APIRouter(tags=["streams"], dependencies=[Depends(viewer)])
api = APIRouter(prefix="/api/v1", dependencies=[Depends(viewer)])
api.include_router(areas.router)
api.include_router(trials.router)
api.include_router(playback_routes.router)
api.include_router(results_routes.router)
api.include_router(tlx_routes.router)
api.include_router(study_routes.router)
api.include_router(registration_routes.router)
api.include_router(calibration_routes.router)
api.include_router(training_routes.router)
api.include_router(vessel_routes.router)


@health.get("/healthz")
async def healthz() -> dict[str, str]:
    """Tell that the process answers."""
    return {"status": "ok"}


@health.get("/readyz")
async def readyz(parts: Context) -> Response:
    """Tell whether the rig is ready, and if not, why."""
    reasons = parts.rig.readiness()
    if reasons:
        return problem(503, "not_ready", "; ".join(reasons), reasons=reasons)
    return _json({"status": "ready"})


@health.get("/metrics", dependencies=[Depends(viewer)])
async def metrics(parts: Context) -> Response:
    """Return the rig's figures for Prometheus."""
    figures = RigCollector(parts.rig, parts.twin, parts.video).text()
    return Response(figures, media_type=CONTENT_TYPE)


@api.get("/state", tags=["rig"])
async def state(parts: Context) -> Response:
    """Return the newest state, as ``/ws/twin`` sends it."""
    newest = parts.rig.states.value
    if newest is None:
        raise ApiError(503, "starting", "the rig has not published a state yet: ask again in a second")
    return _json(twin_state(newest, parts.rig.calibration))


@api.get("/rig", tags=["rig"])
async def rig(parts: Context, principal: Viewer) -> Response:
    """Return devices, camera, calibration and limits."""
    whole = parts.rig.snapshot(principal.session, principal.role.name.lower())
    return _json({name: whole[name] for name in ("rig", "camera", "calibration", "limits")})


@api.get("/vessel", tags=["rig"])
async def vessel(parts: Context) -> dict[str, Any]:
    """Return the vessel model's size and suggested areas."""
    return vessel_fields(parts.rig.vessel)


@api.get("/vessel.png", tags=["rig"])
async def vessel_png(parts: Context) -> Response:
    """Return the vessel's mask, one picture pixel a grid pixel, white inside."""
    return Response(parts.vessel_png, media_type="image/png")


@api.get("/vessel.glb", tags=["rig"])
async def vessel_glb(parts: Context) -> Response:
    """Return the rig as a scene in metres: vessel, robot, tool and critical areas (docs/protocol.md)."""
    rig, magnets = parts.rig, parts.rig.settings.sim.magnets
    tool = ToolShape(
        magnets.needle_diameter_um, magnets.needle_length_um, magnets.tilt_deg, magnets.azimuth_deg
    )
    glb = await asyncio.to_thread(scene_glb, rig.vessel, rig.calibration, rig.areas.list(), tool)
    return Response(glb, media_type="model/gltf-binary")


@api.get("/twin.schema.json", tags=["rig"])
async def schema_of_twin() -> Response:
    """Return the JSON Schema of the messages of ``/ws/twin``."""
    schema = orjson.dumps(await asyncio.to_thread(twin_schema))
    return Response(schema, media_type="application/schema+json")


@api.get("/policies", tags=["rig"])
async def policies(parts: Context) -> list[dict[str, Any]]:
    """Return the policies and whether each was verified for this vessel model."""
    return parts.rig.policies()


@api.post("/mode", tags=["control"])
async def mode(parts: Context, body: ModeBody, principal: Viewer) -> dict[str, Any]:
    """Ask for a mode; 409 with the reason if it is refused. Anyone may stop."""
    if body.ask == "stop":
        parts.rig.console.stop_now(principal.session)
    else:
        await parts.rig.console.ask(body.ask, operator(principal).session, body.area)
    return {"ok": True, "code": "ok", "message": ""}


@api.post("/hand", tags=["control"])
async def hand_scale(parts: Context, body: HandBody, principal: Operator) -> dict[str, Any]:
    """Choose the hand's scale; 409 while the clutch is closed."""
    parts.rig.console.choose_scale(principal.session, body.scale)
    return {"ok": True, "code": "ok", "message": ""}


@api.post("/lease", tags=["control"])
async def take_lease(parts: Context, body: LeaseBody, principal: Operator) -> dict[str, str]:
    """Take control; 409 while another has it, unless a chief takes it over."""
    if principal.anonymous:
        what = f"control belongs to a session: send a secret of your own as {SESSION_HEADER}"
        raise ApiError(400, "no_session", what)
    if body.force:
        await parts.rig.console.take_over(chief(principal).session, body.client)
    else:
        parts.rig.console.take_lease(principal.session, body.client)
    return {"session": principal.session}


@api.delete("/lease", status_code=204, tags=["control"])
async def give_lease(parts: Context, principal: Operator) -> None:
    """Give control back."""
    parts.rig.console.give_lease(principal.session)


@streams.get("/frame.jpg")
async def frame_jpg(parts: Context, width: Width = 1600, quality: Quality = 90) -> Response:
    """Return the newest picture."""
    version = parts.rig.frames.version
    if version == 0:
        raise ApiError(503, "no_frame", "the camera has given no picture yet")
    frame, jpeg, _ = await parts.encoder.newer_than(version - 1, _step(width, 16), _step(quality, 5))
    return Response(jpeg, media_type="image/jpeg", headers={"X-Frame-Number": str(frame.number)})


@streams.get("/video.mjpeg")
async def video_mjpeg(parts: Context, width: Width = 800, quality: Quality = 75) -> Response:
    """Return an endless picture for ``<img>``."""
    return parts.video.mjpeg(_step(width, 16), _step(quality, 5))


@streams.websocket("/ws/twin")
async def ws_twin(websocket: WebSocket, parts: Context, principal: Viewer, rate_hz: RateHz = 60.0) -> None:
    """Serve the twin stream."""
    await parts.twin.serve(websocket, principal, rate_hz)


@streams.websocket("/ws/video")
async def ws_video(
    websocket: WebSocket, parts: Context, width: Width = 800, quality: Quality = 75, codec: Codec = "jpeg"
) -> None:
    """Serve frames: 16 bytes of header (number, format, capture time), then the picture."""
    await parts.video.serve(websocket, _step(width, 16), _step(quality, 5), takes_h264=codec == "h264")


def _step(value: int, step: int) -> int:
    """Return the value on a grid: every size in use is one more encoding of each frame."""
    return max(1, round(value / step)) * step


def _json(content: object) -> Response:
    return Response(orjson.dumps(content), media_type="application/json")
