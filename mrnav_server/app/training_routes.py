"""REST routes of the training wizard: from a picture of a vessel to a verified policy."""

import asyncio
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import FileResponse
from pydantic import BaseModel, ConfigDict, Field

from mrnav_server.app.context import Context, Operator
from mrnav_server.app.problems import ApiError

PICTURE_PATH = "/api/v1/training/picture"
_MAX_PICTURE_BYTES = 40_000_000
_PICTURE_S = 60.0
_SUFFIXES = {"image/png": ".png", "image/jpeg": ".jpg", "image/tiff": ".tif"}
_STRICT = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)

router = APIRouter(prefix="/training", tags=["training"])

Polarity = Literal["auto", "bright", "dark"]
Name = Annotated[str, Field(min_length=1, max_length=64)]
Scale = Annotated[float, Field(gt=0.0, le=10_000.0, allow_inf_nan=False)]


class LiveBody(BaseModel):
    """A vessel model from the live picture."""

    model_config = _STRICT

    name: Name
    polarity: Polarity = "auto"


class TrainingBody(BaseModel):
    """One training; ``settings`` are changed hyper-parameters as of ``mrnav train --set``."""

    model_config = _STRICT

    model: Name
    preset: Literal["best", "paper+", "paper"] = "best"
    seed: Annotated[int, Field(ge=0, le=2**31)] = 0
    pairs: Annotated[int, Field(ge=1, le=10_000)] = 1000
    settings: Annotated[tuple[Name, ...], Field(max_length=20, strict=False)] = ()


@router.get("")
async def training(parts: Context, _: Operator) -> dict[str, Any]:
    """Return the vessel models that there are, what runs, and how it went."""
    return await asyncio.to_thread(parts.training.state)


@router.post("/picture")
async def import_picture(
    parts: Context,
    operator: Operator,
    request: Request,
    name: Annotated[str, Query(min_length=1, max_length=64)],
    um_per_px: Annotated[float, Query(gt=0.0, le=10_000.0, allow_inf_nan=False)],
    polarity: Polarity = "auto",
) -> dict[str, Any]:
    """Make a vessel model from a picture, which is the body: PNG, JPEG or TIFF, 40 MB at most."""
    suffix = _SUFFIXES.get(request.headers.get("content-type", ""))
    if suffix is None:
        raise ApiError(415, "no_picture", "send a PNG, JPEG or TIFF picture, and say which as Content-Type")
    picture = await _body(request)
    await asyncio.to_thread(parts.training.import_picture, name, picture, suffix, um_per_px, polarity)
    return await training(parts, operator)


@router.post("/live")
async def import_live(parts: Context, operator: Operator, body: LiveBody) -> dict[str, Any]:
    """Make a vessel model from the microscope's newest picture; the calibration gives its scale."""
    await asyncio.to_thread(parts.training.import_live, body.name, body.polarity)
    return await training(parts, operator)


@router.get("/models/{model}/preview.png")
async def preview(parts: Context, _: Operator, model: Annotated[str, Path(max_length=64)]) -> FileResponse:
    """Return what was found in a model's photograph, as a picture."""
    return FileResponse(parts.training.preview(model), media_type="image/png")


@router.post("/begin")
async def begin(parts: Context, operator: Operator, body: TrainingBody) -> dict[str, Any]:
    """Train and evaluate a policy; 409 while a trial runs, the rig is armed, or another one runs."""
    await asyncio.to_thread(
        parts.training.train, body.model, body.preset, body.seed, body.pairs, body.settings
    )
    return await training(parts, operator)


@router.post("/cancel")
async def cancel(parts: Context, operator: Operator) -> dict[str, Any]:
    """End the import or training that runs."""
    await asyncio.to_thread(parts.training.cancel)
    return await training(parts, operator)


@router.post("/use")
async def use(parts: Context, operator: Operator) -> dict[str, Any]:
    """Use the policy that was trained last."""
    await parts.training.use()
    return await training(parts, operator)


async def _body(request: Request) -> bytes:
    picture = bytearray()
    try:
        async with asyncio.timeout(_PICTURE_S):
            async for chunk in request.stream():
                picture += chunk
                if len(picture) > _MAX_PICTURE_BYTES:
                    raise ApiError(413, "body_too_large", "a picture has at most 40 MB")
    except TimeoutError:
        raise ApiError(408, "slow_body", "the picture took more than 60 s") from None
    return bytes(picture)
