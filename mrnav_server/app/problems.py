"""Errors as ``application/problem+json`` (RFC 9457) with a stable ``code``."""

from http import HTTPStatus
from typing import Any

import orjson
from fastapi import FastAPI, Request, WebSocket
from fastapi.exceptions import RequestValidationError, WebSocketRequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection
from starlette.responses import Response

from mrnav_server.core.errors import DeviceError, MrnavError, RefusedError

_CODES = {400: "bad_request", 404: "not_found", 405: "method_not_allowed"}
_MISSING = {"no_such_area", "no_such_model", "no_such_trial"}


class ApiError(MrnavError):
    """A request is answered with an error status.

    Args:
        status: HTTP status.
        code: Stable machine-readable reason.
        message: One sentence for a person, with the remedy.
    """

    def __init__(self, status: int, code: str, message: str) -> None:
        super().__init__(message)
        self.status = status
        self.code = code


def problem(status: int, code: str, detail: str, **extra: object) -> Response:
    """Return an error answer; ``extra`` becomes further members."""
    content = {"title": HTTPStatus(status).phrase, "status": status, "code": code, "detail": detail, **extra}
    headers = {"WWW-Authenticate": "Bearer"} if status == HTTPStatus.UNAUTHORIZED else None
    return Response(orjson.dumps(content), status, headers, "application/problem+json")


def install_problems(app: FastAPI) -> None:
    """Answer every error of an app with a problem."""

    async def api_error(connection: HTTPConnection, error: Exception) -> Response | None:
        assert isinstance(error, ApiError)
        return await _answer(connection, problem(error.status, error.code, str(error)))

    async def refused(connection: HTTPConnection, error: Exception) -> Response | None:
        assert isinstance(error, RefusedError)
        status = HTTPStatus.NOT_FOUND if error.code in _MISSING else HTTPStatus.CONFLICT
        return await _answer(connection, problem(status, error.code, str(error)))

    async def invalid(connection: HTTPConnection, error: Exception) -> Response | None:
        assert isinstance(error, RequestValidationError | WebSocketRequestValidationError)
        faults = [_fault(item) for item in error.errors()]
        detail = "; ".join(f"{fault['field']}: {fault['message']}" for fault in faults)
        return await _answer(connection, problem(422, "invalid_request", detail, errors=faults))

    async def device(_: Request, error: Exception) -> Response:
        return problem(503, "device_failed", str(error))

    async def http(connection: HTTPConnection, error: Exception) -> Response | None:
        assert isinstance(error, HTTPException)
        code = _CODES.get(error.status_code, f"http_{error.status_code}")
        return await _answer(connection, problem(error.status_code, code, error.detail))

    async def bug(_: Request, __: Exception) -> Response:
        return problem(500, "internal_error", "the server made a mistake; its log says more")

    for kind, handler in (
        (ApiError, api_error),
        (RefusedError, refused),
        (RequestValidationError, invalid),
        (WebSocketRequestValidationError, invalid),
        (DeviceError, device),
        (HTTPException, http),
        (Exception, bug),
    ):
        # Starlette's types know no handler for requests and WebSockets both.
        app.add_exception_handler(kind, handler)  # type: ignore[arg-type]


async def _answer(connection: HTTPConnection, response: Response) -> Response | None:
    """Return the answer to a request; a WebSocket's handshake is answered here."""
    if not isinstance(connection, WebSocket):
        return response
    await connection.send_denial_response(response)
    return None


def _fault(item: dict[str, Any]) -> dict[str, str]:
    """Name the field and what is wrong with it; the value is left out, for it may be NaN or huge."""
    path = [str(part) for part in item["loc"] if part != "body"]
    return {"field": ".".join(path) or "body", "message": str(item["msg"])}
