"""The browser pages: static files, and the cookie for whoever opens one with a token."""

from pathlib import Path
from urllib.parse import urlencode

from starlette.datastructures import URL
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from mrnav_server.app.auth import COOKIE, Tokens
from mrnav_server.app.problems import ApiError
from mrnav_server.core.errors import ConfigError

_SERVED = {".html", ".js", ".mjs", ".css", ".svg", ".png", ".ico", ".woff2", ".glb", ".map", ".txt", ""}


class Pages(StaticFiles):
    """Serves the pages to everybody (they hold no secret) and turns ``?token=`` into a cookie.

    Args:
        folder: The pages.
        tokens: Recognises a token.
    """

    def __init__(self, folder: Path, tokens: Tokens) -> None:
        super().__init__(directory=folder, html=True)
        self._folder = folder
        self._tokens = tokens

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return a file (``/xr`` is ``xr.html``); with a token in the URL, the cookie and a redirect."""
        request = Request(scope)
        token = request.query_params.get("token")
        if token is not None:
            return self._signed_in(request, token)
        parts = Path(path).parts
        hidden = any(part.startswith(".") and part != "." for part in parts) or "node_modules" in parts
        if hidden or Path(path).suffix not in _SERVED:
            raise ApiError(404, "not_found", f"there is no page {request.url.path}")
        if path and not Path(path).suffix and (self._folder / f"{path}.html").is_file():
            path = f"{path}.html"
        response = await super().get_response(path, scope)
        # An update of the server must reach the browser at once: files are revalidated, not trusted.
        response.headers["Cache-Control"] = "no-cache"
        return response

    def _signed_in(self, request: Request, token: str) -> Response:
        if self._tokens.role(token) is None:
            raise ApiError(
                401, "unauthenticated", "this token is unknown: open the URL that the server printed"
            )
        rest = urlencode([item for item in request.query_params.multi_items() if item[0] != "token"])
        target = URL(path=request.url.path, query=rest)
        response = RedirectResponse(str(target), status_code=303)
        secure = request.url.scheme == "https"
        response.set_cookie(COOKIE, token, httponly=True, samesite="strict", secure=secure)
        return response


def pages_folder() -> Path:
    """Return where the pages lie: in the installed package, or beside it in a checkout.

    Raises:
        ConfigError: If there are none.
    """
    package = Path(__file__).resolve().parent.parent
    for folder in (package / "static", package.parent / "static"):
        if folder.is_dir():
            return folder
    raise ConfigError(f"the browser pages are missing from {package}: reinstall mrnav-server")
