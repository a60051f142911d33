"""The REST client against a small HTTP server."""

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from mrnav_server.client.rest import Rest, RestError

ANSWERS: dict[str, tuple[int, object]] = {
    "/api/v1/rig": (200, {"calibration": {"stage_from_vessel": [[10.0, 0.0, 1000.0], [0.0, 10.0, 2000.0]]}}),
    "/api/v1/critical-areas/area-1": (200, {"center": {"x_px": 30.0, "y_px": 40.0}}),
    "/api/v1/critical-areas/area-2": (404, {"code": "no_such_area", "detail": "there is no area-2"}),
    "/api/v1/mode": (409, {"code": "guard", "detail": "the robot is not seen"}),
    "/odd": (502, "not a problem"),
}


class Handler(BaseHTTPRequestHandler):
    seen: list[tuple[str, dict[str, str], bytes]]

    def do_GET(self) -> None:
        self._answer(b"")

    def do_POST(self) -> None:
        self._answer(self.rfile.read(int(self.headers["Content-Length"])))

    def _answer(self, body: bytes) -> None:
        self.seen.append((self.path, {name.lower(): value for name, value in self.headers.items()}, body))
        status, content = ANSWERS[self.path]
        payload = json.dumps(content).encode()
        self.send_response(status)
        self.send_header("Content-Length", str(len(payload)))
        self.end_headers()
        self.wfile.write(payload)

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing."""


@pytest.fixture
def url(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")  # must not be used for this machine
    Handler.seen = []
    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


def test_it_sends_token_session_and_body(url: str) -> None:
    with pytest.raises(RestError) as refusal:
        Rest(url, "secret", "page-1").post("/api/v1/mode", {"ask": "auto"})
    assert (refusal.value.status, refusal.value.code) == (409, "guard")
    assert str(refusal.value) == "the robot is not seen"
    path, headers, body = Handler.seen[-1]
    assert path == "/api/v1/mode"
    assert headers["authorization"] == "Bearer secret"
    assert headers["x-mrnav-session"] == "page-1"
    assert json.loads(body) == {"ask": "auto"}


def test_an_answer_that_is_no_problem_still_has_a_code(url: str) -> None:
    with pytest.raises(RestError) as refusal:
        Rest(url, "secret").get("/odd")
    assert refusal.value.code == "http_502"


def test_no_server_is_told() -> None:
    with pytest.raises(RestError, match="no answer") as refusal:
        Rest("http://127.0.0.1:9", "secret").get("/odd")
    assert refusal.value.status == 0


def test_bytes_come_as_they_are(url: str) -> None:
    assert json.loads(Rest(url, "secret").get_bytes("/api/v1/rig")) == ANSWERS["/api/v1/rig"][1]
    with pytest.raises(RestError, match="there is no area-2"):
        Rest(url, "secret").get_bytes("/api/v1/critical-areas/area-2")
