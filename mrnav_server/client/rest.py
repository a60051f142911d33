"""The server's REST interface as a client."""

import json
import socket
import ssl
from http.client import HTTPConnection, HTTPResponse
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.request import HTTPHandler, HTTPSHandler, ProxyHandler, Request, build_opener

from mrnav_server.client.waiting import REAL, Waiting
from mrnav_server.core.errors import MrnavError


class RestError(MrnavError):
    """The server refuses a request or does not answer. Reaction: the command reports it.

    Args:
        status: HTTP status; 0 without an answer.
        code: The server's own reason, for example ``"guard"``.
        message: One sentence for a person.
    """

    def __init__(self, status: int, code: str, message: str) -> None:
        super().__init__(message)
        self.status = status
        self.code = code


class Rest:
    """Sends requests as one session.

    Args:
        url: The server's web address without a path.
        token: Sent as ``Authorization: Bearer``.
        session: Names the sender towards the lease; None is one session per role.
        timeout_s: Longest wait for an answer.
        context: How a server over TLS is checked; None trusts what this machine trusts.
        waiting: How it waits for a server without TLS.
    """

    def __init__(
        self,
        url: str,
        token: str,
        session: str | None = None,
        timeout_s: float = 15.0,
        context: ssl.SSLContext | None = None,
        waiting: Waiting = REAL,
    ) -> None:
        self.waiting = waiting
        self._timeout_s = timeout_s
        self._url = url.rstrip("/")
        self._headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
        if session is not None:
            self._headers["X-MRNAV-Session"] = session
        # A proxy of the environment knows nothing of a server on this machine.
        self._opener = build_opener(ProxyHandler({}), HTTPSHandler(context=context), _Handler(waiting))

    def get(self, path: str) -> Any:  # noqa: ANN401 - JSON has no narrower type
        """Return the answer to GET, parsed.

        Raises:
            RestError: If it is refused or not answered.
        """
        return self._send(Request(self._url + path, headers=self._headers))

    def get_bytes(self, path: str) -> bytes:
        """Return the answer to GET as it came, for example a picture.

        Raises:
            RestError: If it is refused or not answered.
        """
        return self._content(Request(self._url + path, headers=self._headers))

    def post(self, path: str, body: dict[str, Any]) -> Any:  # noqa: ANN401 - see above
        """Return the answer to POST, parsed.

        Raises:
            RestError: If it is refused or not answered.
        """
        content = json.dumps(body).encode()
        return self._send(Request(self._url + path, content, self._headers, method="POST"))

    def _send(self, request: Request) -> Any:  # noqa: ANN401 - see above
        return json.loads(self._content(request) or b"null")

    def _content(self, request: Request) -> bytes:
        try:
            with self._opener.open(request, timeout=self._timeout_s) as answer:
                content: bytes = answer.read()
                return content
        except HTTPError as error:
            with error:
                raise _refusal(error.code, error.read()) from None
        except (URLError, OSError) as error:
            raise RestError(0, "no_answer", f"no answer from {self._url} ({error})") from None


class _Socket(socket.socket):
    """A socket that is read only once something has come."""

    waiting: Waiting

    def recv_into(self, *args: Any, **kwargs: Any) -> int:  # noqa: ANN401 - as the socket's own
        until_s = self.waiting.now_s() + (self.gettimeout() or 0.0)
        if not self.waiting.readable(self, until_s):
            raise TimeoutError("timed out")
        return super().recv_into(*args, **kwargs)


class _Connection(HTTPConnection):
    """An HTTP connection that waits as it is told to."""

    waiting: Waiting

    def connect(self) -> None:
        super().connect()
        timeout_s = self.sock.gettimeout()
        self.sock = _Socket(fileno=self.sock.detach())
        self.sock.waiting = self.waiting
        self.sock.settimeout(timeout_s)


class _Handler(HTTPHandler):
    def __init__(self, waiting: Waiting) -> None:
        super().__init__()
        self._waiting = waiting

    def http_open(self, req: Request) -> HTTPResponse:
        return self.do_open(self._connection, req)

    def _connection(self, host: str, **options: Any) -> HTTPConnection:  # noqa: ANN401 - passed on
        connection = _Connection(host, **options)
        connection.waiting = self._waiting
        return connection


def _refusal(status: int, content: bytes) -> RestError:
    try:
        problem = json.loads(content)
        return RestError(status, problem["code"], problem["detail"])
    except (ValueError, KeyError, TypeError):
        return RestError(status, f"http_{status}", f"the server answered {status}")
