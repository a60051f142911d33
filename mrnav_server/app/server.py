"""The web application: routes, guards and pages around a rig."""

import time
from html import escape
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from fastapi import FastAPI, Request
from fastapi.responses import FileResponse, HTMLResponse

from mrnav_server import __version__
from mrnav_server.app import api, training_routes
from mrnav_server.app.auth import Gate
from mrnav_server.app.context import AppContext
from mrnav_server.app.guards import BoundedBodies, SecurityHeaders, content_policy
from mrnav_server.app.model_shelf import ModelShelf
from mrnav_server.app.openh264 import OpenH264
from mrnav_server.app.pages import Pages, pages_folder
from mrnav_server.app.problems import install_problems
from mrnav_server.app.rig_port import RigPort
from mrnav_server.app.study_desk import StudyDesk
from mrnav_server.app.study_progress import LedStudy
from mrnav_server.app.training_desk import TrainingDesk, training_desk
from mrnav_server.app.twin import TwinHub
from mrnav_server.app.vessel_desk import BuildRig, VesselDesk
from mrnav_server.app.video import VideoHub
from mrnav_server.settings import Settings

_OPENAPI = "/api/v1/openapi.json"


def create_app(
    rig: RigPort, settings: Settings, study: LedStudy | None = None, build_rig: BuildRig | None = None
) -> FastAPI:
    """Return the web application of a rig. Touches no device and starts nothing.

    Args:
        rig: The rig; it need not run yet.
        settings: Their tokens must be set (``Settings.with_tokens``).
        study: What to lead the experimenter through; None without a study.
        build_rig: Builds a rig around another vessel model; None where the vessel stays.

    Raises:
        ConfigError: If the settings ask for H.264 and this machine has no encoder.
    """
    app = FastAPI(
        title="mrnav-server", version=__version__, openapi_url=_OPENAPI, docs_url=None, redoc_url=None
    )
    gate = Gate(settings.server)
    _, png = cv2.imencode(".png", rig.vessel.lumen.astype(np.uint8) * 255)
    shelf = ModelShelf(Path(settings.models.root), settings.rig.vessel)
    training = training_desk(rig, shelf)
    leading = _study_desk(rig, settings, study) if study is not None else None
    vessels = VesselDesk(
        rig, shelf, build_rig, lambda: _vessel_objection(rig, training, leading), time.monotonic
    )
    video = VideoHub(rig.encoder, OpenH264() if settings.server.h264 else None)
    app.state.context = AppContext(
        rig, gate, TwinHub(rig), rig.encoder, video, png.tobytes(), leading, training, vessels
    )
    install_problems(app)
    for router in (api.health, api.streams, api.api):
        app.include_router(router)

    app.get("/docs", include_in_schema=False)(_docs_page)
    if settings.server.tls_authority is not None:

        @app.api_route("/ca.crt", methods=["GET", "HEAD"], include_in_schema=False)
        async def authority() -> FileResponse:
            return FileResponse(settings.server.tls_authority or "", media_type="application/x-x509-ca-cert")

    folder = pages_folder()
    app.mount("/static", Pages(folder, gate.tokens), name="static")
    app.mount("/", Pages(folder, gate.tokens), name="pages")
    app.add_middleware(BoundedBodies, streamed={training_routes.PICTURE_PATH})
    app.add_middleware(SecurityHeaders, policy=content_policy(folder))
    return app


def _study_desk(rig: RigPort, settings: Settings, study: LedStudy) -> StudyDesk:
    return StudyDesk(study, settings.rig.vessel, rig.trials, lambda: bool(rig.areas.list()), time.monotonic)


def _vessel_objection(rig: RigPort, training: TrainingDesk, study: StudyDesk | None) -> str:
    """Return why the vessel must stay now, or ""."""
    if training.running:
        return "an import or training runs: wait for it, or cancel it"
    if rig.calibrating.state()["phase"] != "idle":
        return "a calibration is under way: finish or cancel it first"
    if study is not None and study.under_way:
        return "a step of the study is under way: finish it, or give it up"
    return ""


async def _docs_page(request: Request) -> HTMLResponse:
    # Not a closure over the application: the framework remembers its endpoints, and with them a whole rig.
    return HTMLResponse(_docs(request.app.openapi()))


def _docs(openapi: dict[str, Any]) -> str:
    """Return the REST interface as a page that needs nothing from elsewhere, unlike the usual viewers."""
    rows = [
        f"<tr><td>{method.upper()}</td><td><code>{escape(path)}</code></td>"
        f"<td>{escape(operation.get('description', ''))}</td></tr>"
        for path, operations in openapi["paths"].items()
        for method, operation in operations.items()
    ]
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>mrnav-server: REST interface</title>'
        "<style>body{font:15px system-ui;margin:2rem}td{padding:.3rem 1rem .3rem 0}</style>"
        f'<h1>REST interface</h1><p>Schema: <a href="{_OPENAPI}">OpenAPI</a>.</p>'
        f"<table>{''.join(rows)}</table></html>"
    )
