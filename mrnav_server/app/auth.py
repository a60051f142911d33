"""Who may do what: tokens, roles, and which pages may talk to the server."""

import hashlib
import hmac
import ipaddress
import re
from dataclasses import dataclass
from enum import IntEnum

from starlette.requests import HTTPConnection

from mrnav_server.app.problems import ApiError
from mrnav_server.settings import ServerConfig

COOKIE = "mrnav_token"
SESSION_HEADER = "X-MRNAV-Session"
OPERATORS_ONLY = "this needs the operator's token; yours lets you watch, and stop"
CHIEFS_ONLY = "taking control from another operator needs the chief's token"
_SESSION = re.compile(r"[A-Za-z0-9_-]{1,64}")
_SAFE_METHODS = {"GET", "HEAD", "OPTIONS"}
_DEFAULT_PORTS = {"http": 80, "https": 443}


class Role(IntEnum):
    """What a token allows; a larger role includes the smaller."""

    VIEWER = 1
    """Watch, and stop."""
    OPERATOR = 2
    """Control the rig."""
    CHIEF = 3
    """Take control from another operator."""


@dataclass(frozen=True, slots=True)
class Principal:
    """Whoever sent a request.

    Attributes:
        role: What the token allows.
        session: Names the sender towards the rig's lease (``session_name``); the role's name if it did not
            say which one.
    """

    role: Role
    session: str

    @property
    def anonymous(self) -> bool:
        """Whether the sender did not say which session it is: then it can hold no lease."""
        return self.session == self.role.name.lower()


class Tokens:
    """Recognises the tokens; keeps their hashes alone.

    Args:
        config: Its tokens must be set (``Settings.with_tokens``).
    """

    def __init__(self, config: ServerConfig) -> None:
        if config.operator_token is None or config.viewer_token is None:
            raise ValueError("settings without tokens: call Settings.with_tokens() first")
        self._hashes = {
            Role.OPERATOR: _hash(config.operator_token),
            Role.VIEWER: _hash(config.viewer_token),
        }
        if config.chief_token is not None:
            self._hashes[Role.CHIEF] = _hash(config.chief_token)

    def role(self, token: str) -> Role | None:
        """Return what a token allows, None if it is unknown; takes the same time for any wrong one."""
        given = _hash(token)
        matches = [role for role, known in self._hashes.items() if hmac.compare_digest(given, known)]
        return matches[0] if matches else None


class Gate:
    """Lets requests in.

    Args:
        config: Tokens and further origins.
    """

    def __init__(self, config: ServerConfig) -> None:
        self.tokens = Tokens(config)
        self._origins = frozenset(config.origins)

    def admit(self, connection: HTTPConnection) -> Principal:
        """Return who sent a request.

        Raises:
            ApiError: 403 for a foreign page, 401 for a missing or unknown token.
        """
        from_cookie = _explicit_token(connection) is None
        if connection.scope["type"] == "websocket" or connection.scope["method"] not in _SAFE_METHODS:
            self._require_own_page(connection, from_cookie)
        token = connection.cookies.get(COOKIE) if from_cookie else _explicit_token(connection)
        role = self.tokens.role(token) if token else None
        if role is None:
            what = "this token is unknown" if token else "a token is missing"
            raise ApiError(
                401, "unauthenticated", f"{what}: open the URL that the server printed at its start"
            )
        session = connection.headers.get(SESSION_HEADER)
        if session is None:
            return Principal(role, role.name.lower())
        if not _SESSION.fullmatch(session):
            raise ApiError(400, "bad_session", f"{SESSION_HEADER} is 1 to 64 letters, digits, - or _")
        return Principal(role, session_name(session, role))

    def _require_own_page(self, connection: HTTPConnection, from_cookie: bool) -> None:
        """Refuse other pages: a browser sends its cookie along with whatever a foreign page asks for."""
        origin = connection.headers.get("origin")
        site = connection.headers.get("sec-fetch-site", "same-origin")
        if origin is None:
            foreign = from_cookie and COOKIE in connection.cookies
        else:
            foreign = origin not in self._origins | own_origins(connection)
        if foreign or (site not in {"same-origin", "none"} and origin not in self._origins):
            raise ApiError(
                403, "foreign_origin", "pages of another origin are refused: list it under server.origins"
            )


def session_name(session: str, role: Role) -> str:
    """Return the name under which everybody sees a session.

    Everybody who watches can read who holds the lease: that name must not be enough to act for it. So a
    session is a secret of its client, and what others see is made from it.
    """
    return f"session-{_hash(f'{role.name}:{session}').hex()[:16]}"


def own_origins(connection: HTTPConnection) -> frozenset[str]:
    """Return the origins under which a connection's own address is known.

    It is the address that the socket was reached at, never the Host header, which an attacker may choose.
    """
    secure = connection.scope["scheme"] in {"https", "wss"}
    scheme = "https" if secure else "http"
    host, port = connection.scope["server"]
    suffix = "" if port == _DEFAULT_PORTS[scheme] else f":{port}"
    address = ipaddress.ip_address(host)
    names = {f"[{address}]" if address.version == 6 else str(address)}
    if address.is_loopback:
        names |= {"localhost", "127.0.0.1", "[::1]"}
    return frozenset(f"{scheme}://{name}{suffix}" for name in names)


def _explicit_token(connection: HTTPConnection) -> str | None:
    """Return the token that the sender itself put in, unlike a cookie, which the browser adds."""
    scheme, _, credentials = connection.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        return credentials.strip()
    return connection.query_params.get("token")


def _hash(token: str) -> bytes:
    return hashlib.sha256(token.encode()).digest()
