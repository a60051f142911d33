"""Every route against every role, every origin, and bodies that must not pass."""

import json
from collections.abc import AsyncIterator
from typing import Any

import cv2
import httpx
import numpy as np
import pytest
from fastapi import FastAPI
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mrnav_server.core.errors import DeviceError, RefusedError
from mrnav_server.core.tlx import KEYS, shown_pairs
from tests.app.fake_rig import CHIEF_TOKEN, OPERATOR_TOKEN, VIEWER_TOKEN, FakeRig

OWN = "http://127.0.0.1:8000"
AREA = {"center": {"frame": "vessel", "x": 200, "y": 200}, "epsilon_um": 500, "label": "clot"}
TRIAL = {"participant": "P01", "condition": "with_autonomy"}
TLX = {
    "ratings": dict.fromkeys(KEYS, 50),
    "choices": [{"left": a, "right": b, "chosen": a} for a, b in shown_pairs("trial-1")],
}
OPEN, WATCH, CONTROL = "open", "watch", "control"

ROUTES: dict[tuple[str, str], tuple[str, Any, int]] = {
    ("GET", "/healthz"): (OPEN, None, 200),
    ("GET", "/readyz"): (OPEN, None, 200),
    ("GET", "/docs"): (OPEN, None, 200),
    ("GET", "/metrics"): (WATCH, None, 200),
    ("GET", "/frame.jpg"): (WATCH, None, 200),
    ("GET", "/api/v1/state"): (WATCH, None, 200),
    ("GET", "/api/v1/rig"): (WATCH, None, 200),
    ("GET", "/api/v1/vessel"): (WATCH, None, 200),
    ("GET", "/api/v1/vessel.png"): (WATCH, None, 200),
    ("GET", "/api/v1/vessel.glb"): (WATCH, None, 200),
    ("GET", "/api/v1/policies"): (WATCH, None, 200),
    ("GET", "/api/v1/critical-areas"): (WATCH, None, 200),
    ("GET", "/api/v1/critical-areas/{area_id}"): (WATCH, None, 200),
    ("POST", "/api/v1/critical-areas"): (CONTROL, AREA, 201),
    ("PUT", "/api/v1/critical-areas/{area_id}"): (CONTROL, AREA, 200),
    ("PUT", "/api/v1/critical-areas"): (CONTROL, {"order": ["area-1"]}, 200),
    ("POST", "/api/v1/critical-areas/{area_id}/choose"): (CONTROL, None, 204),
    ("DELETE", "/api/v1/critical-areas/{area_id}"): (CONTROL, None, 204),
    ("POST", "/api/v1/hand"): (CONTROL, {"scale": "fine"}, 200),
    ("POST", "/api/v1/mode"): (CONTROL, {"ask": "arm"}, 200),
    ("POST", "/api/v1/lease"): (CONTROL, {}, 200),
    ("DELETE", "/api/v1/lease"): (CONTROL, None, 204),
    ("GET", "/api/v1/registration"): (WATCH, None, 200),
    ("POST", "/api/v1/registration"): (CONTROL, {"auto": True}, 200),
    ("GET", "/api/v1/calibration"): (WATCH, None, 200),
    ("POST", "/api/v1/calibration/begin"): (CONTROL, {"water_depth_um": 0.0}, 200),
    ("POST", "/api/v1/calibration/next"): (CONTROL, None, 200),
    ("POST", "/api/v1/calibration/cancel"): (CONTROL, None, 200),
    ("POST", "/api/v1/calibration/use"): (CONTROL, None, 200),
    ("GET", "/api/v1/trials"): (WATCH, None, 200),
    ("POST", "/api/v1/trials"): (CONTROL, TRIAL, 201),
    ("GET", "/api/v1/trials/{trial_id}"): (WATCH, None, 200),
    ("POST", "/api/v1/trials/{trial_id}/end"): (CONTROL, None, 200),
    ("GET", "/api/v1/results"): (WATCH, None, 200),
    ("GET", "/api/v1/tlx.csv"): (WATCH, None, 200),
    # This trial is on no disk: test_results_routes.py has some that are.
    ("GET", "/api/v1/trials/{trial_id}/result"): (WATCH, None, 404),
    ("POST", "/api/v1/trials/{trial_id}/result"): (CONTROL, None, 404),
    ("GET", "/api/v1/trials/{trial_id}/trajectory"): (WATCH, None, 404),
    ("GET", "/api/v1/trials/{trial_id}/playback"): (WATCH, None, 404),
    ("GET", "/api/v1/trials/{trial_id}/film/{number}.jpg"): (WATCH, None, 404),
    ("GET", "/api/v1/trials/{trial_id}/tlx"): (WATCH, None, 404),
    ("POST", "/api/v1/trials/{trial_id}/tlx"): (CONTROL, TLX, 404),
    ("GET", "/api/v1/trials/{trial_id}/tlx/form"): (WATCH, None, 404),
    ("GET", "/api/v1/twin.schema.json"): (WATCH, None, 200),
    ("GET", "/api/v1/study"): (WATCH, None, 404),
    ("POST", "/api/v1/study/next"): (CONTROL, None, 404),
    ("POST", "/api/v1/study/finish"): (CONTROL, None, 404),
    ("POST", "/api/v1/study/interrupt"): (CONTROL, None, 404),
    # What begins a computation is in test_training_routes.py.
    ("GET", "/api/v1/training"): (CONTROL, None, 200),
    ("POST", "/api/v1/training/picture"): (CONTROL, None, 422),
    ("POST", "/api/v1/training/live"): (CONTROL, {"name": "Not a name"}, 409),
    ("GET", "/api/v1/training/models/{model}/preview.png"): (CONTROL, None, 404),
    ("POST", "/api/v1/training/begin"): (CONTROL, {"model": "none"}, 404),
    ("POST", "/api/v1/training/cancel"): (CONTROL, None, 200),
    ("POST", "/api/v1/training/use"): (CONTROL, None, 409),
    ("GET", "/api/v1/vessels"): (WATCH, None, 200),
    ("POST", "/api/v1/vessels/{name}/choose"): (CONTROL, None, 404),
    ("POST", "/api/v1/study/vessel"): (CONTROL, None, 404),
}
STREAMED = {("GET", "/video.mjpeg")}
"""Endless answers: refused below, served in test_app_streams.py."""


@pytest.fixture
async def client(app: FastAPI, rig: FakeRig) -> AsyncIterator[httpx.AsyncClient]:
    rig.publish()
    rig.show()
    rig.areas.add(rig.to_vessel("vessel", 200, 200), 500.0, "")
    rig.trials.start("P00", "with_autonomy", "human", "")
    rig.asked.clear()
    transport = httpx.ASGITransport(app, raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url=OWN) as client:
        yield client
    app.state.context.encoder.close()


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def path_of(template: str) -> str:
    return template.format(area_id="area-1", trial_id="trial-1", number=0, model="none", name="none")


def test_the_matrix_knows_every_route(app: FastAPI) -> None:
    paths = app.openapi()["paths"]
    found = {(method.upper(), path) for path, operations in paths.items() for method in operations}
    assert found | {("GET", "/docs")} == set(ROUTES) | STREAMED


@pytest.mark.parametrize(
    ("method", "template", "token"),
    [(*route, token) for route in ROUTES for token in ("", "wrong", "viewer", "operator", "chief")]
    + [(*route, token) for route in STREAMED for token in ("", "wrong")],
)
async def test_route_and_role(client: httpx.AsyncClient, method: str, template: str, token: str) -> None:
    needs, body, success = ROUTES.get((method, template), (WATCH, None, 200))
    tokens = {"viewer": VIEWER_TOKEN, "operator": OPERATOR_TOKEN, "chief": CHIEF_TOKEN, "wrong": "x" * 20}
    headers = {"X-MRNAV-Session": "of-my-own"} | (bearer(tokens[token]) if token else {})
    answer = await client.request(method, path_of(template), json=body, headers=headers)
    if needs == OPEN or token in ("operator", "chief") or (token == "viewer" and needs == WATCH):
        assert answer.status_code == success, answer.text
    else:
        status, code = (403, "forbidden") if token == "viewer" else (401, "unauthenticated")
        assert (answer.status_code, answer.json()["code"]) == (status, code)
        assert answer.headers["content-type"] == "application/problem+json"


async def test_a_viewer_may_stop_and_nothing_else(client: httpx.AsyncClient, rig: FakeRig) -> None:
    for ask in ("arm", "disarm", "manual", "auto", "hold", "reset"):
        answer = await client.post("/api/v1/mode", json={"ask": ask}, headers=bearer(VIEWER_TOKEN))
        assert answer.status_code == 403
    answer = await client.post("/api/v1/mode", json={"ask": "stop"}, headers=bearer(VIEWER_TOKEN))
    assert answer.status_code == 200
    assert rig.asked == [("stop_now", "viewer")]


@pytest.mark.parametrize("way", ["bearer", "query", "cookie"])
async def test_a_token_comes_in_three_ways(client: httpx.AsyncClient, way: str) -> None:
    headers = {
        "bearer": bearer(VIEWER_TOKEN),
        "cookie": {"Cookie": f"mrnav_token={VIEWER_TOKEN}"},
        "query": {},
    }
    query = {"token": VIEWER_TOKEN} if way == "query" else {}
    answer = await client.get("/api/v1/vessel", headers=headers[way], params=query)
    assert answer.status_code == 200


async def test_a_wrong_header_is_not_healed_by_a_good_cookie(client: httpx.AsyncClient) -> None:
    headers = {**bearer("x" * 20), "Cookie": f"mrnav_token={VIEWER_TOKEN}"}
    assert (await client.get("/api/v1/vessel", headers=headers)).status_code == 401


@pytest.mark.parametrize(
    ("origin", "allowed"),
    [
        (OWN, True),
        ("http://localhost:8000", True),
        ("http://[::1]:8000", True),
        (None, True),
        ("null", False),
        ("", False),
        ("https://127.0.0.1:8000", False),
        ("http://127.0.0.1", False),
        ("http://127.0.0.1:8001", False),
        ("http://127.0.0.1:8000.evil.example", False),
        ("http://127.0.0.1:80000", False),
        ("http://evil.example:8000", False),
        ("HTTP://127.0.0.1:8000", False),
    ],
)
async def test_only_own_pages_change_state(
    client: httpx.AsyncClient, rig: FakeRig, origin: str | None, allowed: bool
) -> None:
    headers = bearer(OPERATOR_TOKEN) | ({} if origin is None else {"Origin": origin})
    answer = await client.post("/api/v1/mode", json={"ask": "arm"}, headers=headers)
    assert answer.status_code == (200 if allowed else 403)
    assert bool(rig.asked) is allowed
    if not allowed:
        assert answer.json()["code"] == "foreign_origin"


async def test_a_cookie_needs_an_origin_to_change_state(client: httpx.AsyncClient, rig: FakeRig) -> None:
    headers = {"Cookie": f"mrnav_token={OPERATOR_TOKEN}"}
    assert (await client.post("/api/v1/mode", json={"ask": "arm"}, headers=headers)).status_code == 403
    headers |= {"Origin": OWN, "Sec-Fetch-Site": "cross-site"}
    assert (await client.post("/api/v1/mode", json={"ask": "arm"}, headers=headers)).status_code == 403
    headers |= {"Sec-Fetch-Site": "same-origin"}
    assert (await client.post("/api/v1/mode", json={"ask": "arm"}, headers=headers)).status_code == 200
    assert rig.asked == [("arm", "operator", "")]


async def test_the_host_header_does_not_make_an_origin_own(client: httpx.AsyncClient) -> None:
    headers = bearer(OPERATOR_TOKEN) | {"Host": "evil.example:8000", "Origin": "http://evil.example:8000"}
    assert (await client.post("/api/v1/mode", json={"ask": "arm"}, headers=headers)).status_code == 403


async def test_refusals_are_409_with_their_code(client: httpx.AsyncClient, rig: FakeRig) -> None:
    rig.refusal = RefusedError("no_lease", "take the lease first")
    for method, path, body in (
        ("POST", "/api/v1/mode", {"ask": "arm"}),
        ("POST", "/api/v1/lease", {}),
        ("POST", "/api/v1/trials", TRIAL),
    ):
        headers = bearer(OPERATOR_TOKEN) | {"X-MRNAV-Session": "page-1"}
        answer = await client.request(method, path, json=body, headers=headers)
        assert answer.status_code == 409
        assert answer.json() == {
            "title": "Conflict",
            "status": 409,
            "code": "no_lease",
            "detail": "take the lease first",
        }


async def test_an_area_in_the_wall_is_refused_with_how_far(client: httpx.AsyncClient) -> None:
    body = AREA | {"center": {"frame": "vessel", "x": 200, "y": 80}}
    answer = await client.post("/api/v1/critical-areas", json=body, headers=bearer(OPERATOR_TOKEN))
    assert (answer.status_code, answer.json()["code"]) == (409, "in_wall")
    assert "µm" in answer.json()["detail"]


@pytest.mark.parametrize(
    "path", ["/api/v1/critical-areas/area-9", "/api/v1/trials/..%2F..%2Fetc", "/api/v1/no"]
)
async def test_what_is_missing_is_404(client: httpx.AsyncClient, path: str) -> None:
    answer = await client.get(path, headers=bearer(VIEWER_TOKEN))
    assert answer.status_code == 404
    assert answer.json()["code"] in {"no_such_area", "no_such_trial", "not_found"}


async def test_a_failed_device_is_503_and_a_bug_500(client: httpx.AsyncClient, rig: FakeRig) -> None:
    for failure, status, code in (
        (DeviceError("no controller"), 503, "device_failed"),
        (KeyError("secret detail"), 500, "internal_error"),
    ):

        def broken(failure: Exception = failure) -> list[dict[str, Any]]:
            raise failure

        rig.policies = broken  # type: ignore[method-assign]
        answer = await client.get("/api/v1/policies", headers=bearer(VIEWER_TOKEN))
        assert (answer.status_code, answer.json()["code"]) == (status, code)
        assert "secret" not in answer.text


async def test_not_ready_says_why(client: httpx.AsyncClient, rig: FakeRig) -> None:
    rig.not_ready = ["no camera", "no policy"]
    answer = await client.get("/readyz")
    assert answer.status_code == 503
    assert answer.json()["reasons"] == ["no camera", "no policy"]


async def test_areas_in_three_frames_agree(client: httpx.AsyncClient, rig: FakeRig) -> None:
    rig.areas.remove("area-1")
    image = rig.calibration.image_from_vessel(150.0, 180.0)
    for frame, (x, y) in (("vessel", (150.0, 180.0)), ("stage", (1500.0, 1800.0)), ("image", image)):
        body = AREA | {"center": {"frame": frame, "x": x, "y": y}}
        answer = await client.post("/api/v1/critical-areas", json=body, headers=bearer(OPERATOR_TOKEN))
        assert answer.json()["center"] == {"x_px": 150.0, "y_px": 180.0}
        assert answer.headers["location"] == f"/api/v1/critical-areas/{answer.json()['id']}"


async def test_the_lease_goes_to_the_session_that_asks(client: httpx.AsyncClient, rig: FakeRig) -> None:
    operator = bearer(OPERATOR_TOKEN)
    script, page = operator | {"X-MRNAV-Session": "hand-7"}, operator | {"X-MRNAV-Session": "page-1"}
    answer = await client.post("/api/v1/lease", json={"client": "script"}, headers=script)
    await client.post("/api/v1/lease", json={}, headers=page)
    await client.request("DELETE", "/api/v1/lease", headers=page)
    (_, one, _), (_, other, _), (_, given) = rig.asked
    assert answer.json() == {"session": one}
    assert one != other == given
    bad = await client.post("/api/v1/lease", json={}, headers=operator | {"X-MRNAV-Session": "a b"})
    assert (bad.status_code, bad.json()["code"]) == (400, "bad_session")
    none = await client.post("/api/v1/lease", json={}, headers=operator)
    assert (none.status_code, none.json()["code"]) == (400, "no_session")
    assert len(rig.asked) == 3


async def test_an_operator_takes_control_from_nobody(client: httpx.AsyncClient, rig: FakeRig) -> None:
    own = {"X-MRNAV-Session": "of-my-own"}
    for token in (VIEWER_TOKEN, OPERATOR_TOKEN):
        answer = await client.post("/api/v1/lease", json={"force": True}, headers=bearer(token) | own)
        assert (answer.status_code, answer.json()["code"]) == (403, "forbidden")
    assert rig.asked == []
    body = {"force": True, "client": "chief"}
    answer = await client.post("/api/v1/lease", json=body, headers=bearer(CHIEF_TOKEN) | own)
    assert answer.status_code == 200
    assert rig.asked == [("take_over", answer.json()["session"], "chief")]


async def test_who_reads_the_holders_name_cannot_act_for_it(client: httpx.AsyncClient, rig: FakeRig) -> None:
    secret = bearer(OPERATOR_TOKEN) | {"X-MRNAV-Session": "secret-of-the-holder"}
    shown = (await client.post("/api/v1/lease", json={}, headers=secret)).json()["session"]
    for claimed in (bearer(token) | {"X-MRNAV-Session": shown} for token in (OPERATOR_TOKEN, CHIEF_TOKEN)):
        await client.request("DELETE", "/api/v1/lease", headers=claimed)
        await client.post("/api/v1/mode", json={"ask": "stop"}, headers=claimed)
    # Another role's client with the same secret is another session, too.
    secret["Authorization"] = f"Bearer {CHIEF_TOKEN}"
    await client.request("DELETE", "/api/v1/lease", headers=secret)
    assert [ask for ask, *_ in rig.asked[1:]] == ["give_lease", "stop_now"] * 2 + ["give_lease"]
    assert all(shown not in by for _, *by in rig.asked[1:])


AREA_TEXT = '{"center":{"frame":"vessel","x":%s,"y":200},"epsilon_um":%s,"label":""}'
BAD_BODIES = {
    "nan": AREA_TEXT % ("NaN", "500"),
    "infinity": AREA_TEXT % ("-Infinity", "500"),
    "overflow": AREA_TEXT % ("1e999", "500"),
    "epsilon nan": AREA_TEXT % ("200", "NaN"),
    "epsilon zero": AREA_TEXT % ("200", "0"),
    "text for a number": AREA_TEXT % ('"200"', "500"),
    "bool for a number": AREA_TEXT % ("true", "500"),
    "whole with 5000 digits": AREA_TEXT % ("9" * 5000, "500"),
    "unknown field": AREA_TEXT[:-1] % ("200", "500") + ',"z":1}',
    "unknown frame": (AREA_TEXT % ("200", "500")).replace("vessel", "hand"),
    "list": "[]",
    "deep": "[" * 30_000 + "]" * 30_000,
    "no json": "{",
    "empty": "",
    "no utf-8": "\udcff",
    "huge": '{"label":"' + "x" * 70_000 + '"}',
}


@pytest.mark.parametrize("body", BAD_BODIES.values(), ids=BAD_BODIES)
async def test_bad_bodies_are_refused(client: httpx.AsyncClient, rig: FakeRig, body: str) -> None:
    content = body.encode(errors="surrogateescape")
    headers = bearer(OPERATOR_TOKEN) | {"Content-Type": "application/json"}
    answer = await client.post("/api/v1/critical-areas", content=content, headers=headers)
    assert answer.status_code in {400, 413, 422}, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert len(rig.areas.list()) == 1


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    body=st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
        lambda inner: (
            st.lists(inner) | st.dictionaries(st.sampled_from(["ask", "area", "x"]) | st.text(), inner)
        ),
    )
)
async def test_no_body_breaks_the_mode_route(client: httpx.AsyncClient, body: object) -> None:
    headers = bearer(OPERATOR_TOKEN) | {"Content-Type": "application/json"}
    answer = await client.post("/api/v1/mode", content=json.dumps(body).encode(), headers=headers)
    assert answer.status_code in {200, 400, 422}


async def test_a_body_is_bounded_on_every_route(client: httpx.AsyncClient) -> None:
    for path in ("/api/v1/mode", "/api/v1/trials/trial-1/end", "/healthz", "/"):
        answer = await client.post(path, content=b"x" * 65_537, headers=bearer(OPERATOR_TOKEN))
        assert (answer.status_code, answer.json()["code"]) == (413, "body_too_large")


async def test_an_invalid_field_is_named(client: httpx.AsyncClient) -> None:
    body = {"participant": "P 01", "condition": "both"}
    answer = await client.post("/api/v1/trials", json=body, headers=bearer(OPERATOR_TOKEN))
    assert answer.status_code == 422
    assert {fault["field"] for fault in answer.json()["errors"]} == {"participant", "condition"}


async def test_pages_and_the_cookie(client: httpx.AsyncClient) -> None:
    answer = await client.get("/", params={"token": OPERATOR_TOKEN, "emu": "1"})
    assert (answer.status_code, answer.headers["location"]) == (303, "/?emu=1")
    cookie = answer.headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie
    assert (await client.get("/", params={"token": "x" * 20})).status_code == 401


@pytest.mark.parametrize(
    "path",
    ["/package.json", "/node_modules/x.js", "/.git/config", "/..%2fpyproject.toml", "/%2e%2e/README.md"],
)
async def test_nothing_but_pages_is_served(client: httpx.AsyncClient, path: str) -> None:
    assert (await client.get(path)).status_code == 404


async def test_security_headers_are_on_every_answer(client: httpx.AsyncClient) -> None:
    for path in ("/", "/healthz", "/api/v1/state", "/docs"):
        headers = (await client.get(path)).headers
        assert "default-src 'self'" in headers["content-security-policy"]
        assert "unsafe-eval" not in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["x-frame-options"] == "DENY"


async def test_stills_and_mask(client: httpx.AsyncClient, rig: FakeRig) -> None:
    answer = await client.get("/frame.jpg?width=64", headers=bearer(VIEWER_TOKEN))
    picture = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (48, 64, 3)
    answer = await client.get("/api/v1/vessel.png", headers=bearer(VIEWER_TOKEN))
    mask = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert np.array_equal(mask > 0, rig.vessel.lumen)  # type: ignore[operator]


async def test_before_the_first_frame_and_state(app: FastAPI) -> None:
    fresh = httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url=OWN)
    for path, code in (("/frame.jpg", "no_frame"), ("/api/v1/state", "starting")):
        answer = await fresh.get(path, headers=bearer(VIEWER_TOKEN))
        assert (answer.status_code, answer.json()["code"]) == (503, code)
    await fresh.aclose()


async def test_prometheus_figures(client: httpx.AsyncClient) -> None:
    lines = (await client.get("/metrics", headers=bearer(VIEWER_TOKEN))).text.splitlines()
    for line in (
        'mrnav_mode{mode="DISARMED"} 1.0',
        'mrnav_mode{mode="AUTO"} 0.0',
        'mrnav_latency_seconds{name="tick",quantile="0.99"} 0.002',
        'mrnav_events_total{name="stale"} 3.0',
        "mrnav_simulated 1.0",
    ):
        assert line in lines
