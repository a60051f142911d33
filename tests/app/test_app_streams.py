"""The WebSockets and MJPEG over real sockets."""

import asyncio
import base64
import contextlib
import json
import logging
import os
import socket
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from typing import Any

import cv2
import httpx
import numpy as np
import pytest
from fastapi import FastAPI
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from mrnav_server.app import connections, guards, twin, video
from mrnav_server.app.openh264 import OpenH264
from mrnav_server.app.server import create_app
from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.core.records import Frame
from mrnav_server.loops.ticks import ticks
from mrnav_server.settings import Settings
from tests.app.fake_rig import OPERATOR_TOKEN, SERVER, VIEWER_TOKEN, FakeRig, listening

TOKENS = {"operator": OPERATOR_TOKEN, "viewer": VIEWER_TOKEN}


@dataclass
class Site:
    """A rig that is served on a port."""

    rig: FakeRig
    app: FastAPI
    port: int

    @asynccontextmanager
    async def twin(self, role: str = "operator", query: str = "") -> AsyncIterator[ClientConnection]:
        url = f"ws://127.0.0.1:{self.port}/ws/twin?token={TOKENS[role]}{query}"
        async with connect(url, compression=None) as link:
            yield link

    async def refusal(self, path: str, headers: dict[str, str] | None = None) -> int:
        with pytest.raises(InvalidStatus) as refused:
            await connect(f"ws://127.0.0.1:{self.port}{path}", additional_headers=headers)
        return refused.value.response.status_code


@pytest.fixture
async def site(rig: FakeRig, app: FastAPI, caplog: pytest.LogCaptureFixture) -> AsyncIterator[Site]:
    rig.publish()
    async with listening(app) as port:
        yield Site(rig, app, port)
    app.state.context.encoder.close()
    records = caplog.get_records("call") + caplog.get_records("teardown")
    assert not [record.getMessage() for record in records if record.levelno >= logging.ERROR]


async def message(link: ClientConnection, kind: str) -> dict[str, Any]:
    """Read until a message of one type comes."""
    while True:
        content: dict[str, Any] = json.loads(await link.recv())
        if content["type"] == kind:
            return content


async def closing(link: ClientConnection) -> tuple[int, str]:
    """Read until the server closes; return its code and reason."""
    try:
        while True:
            await link.recv()
    except ConnectionClosed as closed:
        return (closed.rcvd.code, closed.rcvd.reason) if closed.rcvd else (1006, "")


async def test_the_snapshot_comes_first_and_then_the_newest_state(site: Site) -> None:
    site.rig.publish(seq=2)
    site.rig.publish(seq=3)
    async with site.twin() as link:
        first = json.loads(await link.recv())
        assert (first["type"], first["role"], first["session"][:5]) == ("snapshot", "operator", "page-")
        assert first["state"]["seq"] == 3
        assert json.loads(await link.recv())["seq"] == 3
        site.rig.publish(seq=4)
        assert json.loads(await link.recv())["seq"] == 4


async def test_every_page_has_a_session_of_its_own(site: Site) -> None:
    async with site.twin() as one, site.twin("viewer") as other:
        first, second = await message(one, "snapshot"), await message(other, "snapshot")
    assert first["session"] != second["session"]
    for snapshot in (first, second):
        assert snapshot["seat"] not in ("", snapshot["session"]), "what others see is not the secret"
    assert second["role"] == "viewer"


async def test_no_event_is_lost(site: Site) -> None:
    async with site.twin() as link:
        await message(link, "snapshot")
        for number in range(100):
            site.rig.events.publish({"type": "event", "event": "contact", "number": number})
        assert [(await message(link, "event"))["number"] for _ in range(100)] == list(range(100))


async def test_asks_are_answered(site: Site) -> None:
    async with site.twin() as link:
        session = (await message(link, "snapshot"))["seat"]
        await link.send('{"type":"ask","ask":"auto","area":"area-1"}')
        assert await message(link, "answer") == {"type": "answer", "ok": True, "code": "ok", "message": ""}
        site.rig.refusal = RefusedError("no_lease", "take the lease first")
        await link.send('{"type":"ask","ask":"arm"}')
        answer = await message(link, "answer")
        assert (answer["ok"], answer["code"], answer["message"]) == (
            False,
            "no_lease",
            "take the lease first",
        )
        await link.send('{"type":"heartbeat"}')
        await link.send('{"type":"ask","ask":"stop"}')
        assert (await message(link, "answer"))["ok"]
    assert site.rig.asked == [("auto", session, "area-1"), ("heartbeat", session), ("stop_now", session)]


async def test_stop_and_heartbeats_do_not_wait_behind_a_slow_ask(site: Site) -> None:
    begun, planned = asyncio.Event(), asyncio.Event()
    ask = site.rig.ask

    async def slow(name: str, session: str, area: str | None) -> None:
        begun.set()
        await planned.wait()
        await ask(name, session, area)

    site.rig.ask = slow  # type: ignore[method-assign]
    async with site.twin() as link:
        await link.send('{"type":"ask","ask":"auto"}')
        await begun.wait()
        for _ in range(9):
            await link.send('{"type":"ask","ask":"auto"}')
        assert (await message(link, "answer"))["code"] == "busy"
        await link.send('{"type":"heartbeat"}')
        await link.send('{"type":"ask","ask":"stop"}')
        assert (await message(link, "answer"))["code"] == "ok"
        assert [name for name, *_ in site.rig.asked] == ["heartbeat", "stop_now"]
        planned.set()
        assert [(await message(link, "answer"))["code"] for _ in range(9)] == ["ok"] * 9
    assert [name for name, *_ in site.rig.asked[2:]] == ["auto"] * 9


async def test_a_viewer_may_stop_and_nothing_else_here_too(site: Site) -> None:
    async with site.twin("viewer") as link:
        session = (await message(link, "snapshot"))["seat"]
        for ask in ("arm", "disarm", "manual", "auto", "hold", "reset"):
            await link.send(json.dumps({"type": "ask", "ask": ask}))
            assert (await message(link, "answer"))["code"] == "forbidden"
        await link.send('{"type":"heartbeat"}')
        assert (await message(link, "answer"))["code"] == "forbidden"
        await link.send('{"type":"ask","ask":"stop"}')
        assert (await message(link, "answer"))["ok"]
    assert site.rig.asked == [("stop_now", session)]


@pytest.mark.parametrize(
    ("sent", "code"),
    [
        ("{", "bad_json"),
        ('{"type":"heartbeat","t":NaN}', "bad_json"),
        ('{"type":"heartbeat","t":1e999}', "bad_json"),
        ("[" * 2000, "bad_json"),
        ("[]", "bad_message"),
        ('{"type":"fly"}', "bad_message"),
        ('{"type":"ask","ask":"fly"}', "bad_message"),
        ('{"type":"ask","ask":"arm","extra":1}', "bad_message"),
        ('{"type":"ask","ask":"auto","area":"../x"}', "bad_message"),
        (b"\x00\x01", "bad_message"),
    ],
)
async def test_who_breaks_the_protocol_is_told_and_dropped(site: Site, sent: str | bytes, code: str) -> None:
    async with site.twin() as link:
        await link.send(sent)
        close_code, reason = await closing(link)
    assert (close_code, reason.split(":")[0]) == (1008, code)
    assert site.rig.asked == []


async def test_an_endless_message_is_dropped(site: Site) -> None:
    async with site.twin() as link:
        await link.send("x" * 5000)
        assert (await closing(link))[0] == 1009


async def test_a_flood_is_dropped(site: Site) -> None:
    async with site.twin() as link:
        with contextlib.suppress(ConnectionClosed):
            for _ in range(1000):
                await link.send('{"type":"heartbeat"}')
        assert (await closing(link))[1].startswith("flood")
    assert len(site.rig.asked) < 1000


@pytest.mark.parametrize("path", ["/ws/twin", "/ws/video"])
async def test_who_may_connect(site: Site, path: str) -> None:
    own = f"http://127.0.0.1:{site.port}"
    other = f"http://127.0.0.1:{site.port + 1}"
    cookie = {"Cookie": f"mrnav_token={VIEWER_TOKEN}"}
    assert await site.refusal(path) == 401
    assert await site.refusal(f"{path}?token=wrong") == 401
    for origin in ("http://evil.example", "null", other, own.replace("http", "https")):
        assert await site.refusal(f"{path}?token={VIEWER_TOKEN}", {"Origin": origin}) == 403
    assert await site.refusal(path, cookie) == 403
    async with connect(f"ws://127.0.0.1:{site.port}{path}", additional_headers=cookie | {"Origin": own}):
        pass


@pytest.mark.parametrize("query", ["rate_hz=nan", "rate_hz=0", "rate_hz=1e9", "rate_hz=x"])
async def test_bad_rates_are_refused(site: Site, query: str) -> None:
    assert await site.refusal(f"/ws/twin?token={VIEWER_TOKEN}&{query}") == 422


async def test_too_many_clients_are_refused(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(twin, "_MAX_CLIENTS", 1)
    async with site.twin() as link:
        await message(link, "snapshot")
        assert await site.refusal(f"/ws/twin?token={VIEWER_TOKEN}") == 503


def deaf_client(port: int, path: str) -> socket.socket:
    """Open a WebSocket and never read from it."""
    peer = socket.socket()
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    peer.connect(("127.0.0.1", port))
    key = base64.b64encode(os.urandom(16)).decode()
    request = (
        f"GET {path} HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {key}\r\n\r\n"
    )
    peer.sendall(request.encode())
    return peer


def ends_within(peer: socket.socket, span_s: float) -> bool:
    peer.settimeout(span_s)
    try:
        while peer.recv(65_536):
            pass
    except ConnectionResetError:
        return True
    except TimeoutError:
        return False
    return True


async def test_a_slow_reader_is_dropped_while_a_healthy_one_keeps_up(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "SLOW_READER_S", 0.3)
    hub = site.app.state.context.twin
    deaf = deaf_client(site.port, f"/ws/twin?token={VIEWER_TOKEN}&rate_hz=120")
    path = tuple((float(i), float(i)) for i in range(64))
    async with site.twin("viewer", "&rate_hz=120") as link:
        await message(link, "state")
        seq = 1
        while hub.slow_readers == 0:
            seq += 1
            site.rig.publish(seq=seq, reason="x" * 20_000, path=path)
            assert (await message(link, "state"))["seq"] == seq
    assert hub.slow_readers == 1
    with deaf:
        assert await asyncio.to_thread(ends_within, deaf, 5.0)


async def test_a_client_that_answers_no_ping_is_dropped(
    rig: FakeRig, app: FastAPI, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "PING_S", 0.1)
    monkeypatch.setattr(connections, "PONG_DEADLINE_S", 0.2)
    rig.publish()
    async with listening(app) as port:
        site = Site(rig, app, port)
        deaf = deaf_client(port, f"/ws/twin?token={VIEWER_TOKEN}")
        async with site.twin() as link:
            assert (await message(link, "snapshot"))["role"] == "operator"
            with deaf:
                assert await asyncio.to_thread(ends_within, deaf, 5.0)
            rig.publish(seq=5)
            while (await message(link, "state"))["seq"] != 5:
                pass
    app.state.context.encoder.close()


async def test_a_client_that_takes_no_events_is_dropped(site: Site) -> None:
    async with site.twin() as link:
        await message(link, "snapshot")
        for number in range(257):
            site.rig.events.publish({"type": "event", "event": "contact", "number": number})
        assert await closing(link) == (1006, "")


async def test_video_carries_number_and_capture_time(site: Site) -> None:
    url = f"ws://127.0.0.1:{site.port}/ws/video?width=80&quality=75&token={VIEWER_TOKEN}"
    async with connect(url) as link:
        site.rig.show(number=7)
        content = await link.recv()
    assert isinstance(content, bytes)
    number, reserved, taken_s = video.HEADER.unpack(content[:16])
    assert (number, reserved, taken_s) == (7, 0, 7 / 30.0)
    picture = cv2.imdecode(np.frombuffer(content[16:], np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (60, 80, 3)


async def picture_format(link: ClientConnection) -> int:
    content = await link.recv()
    assert isinstance(content, bytes)
    return int(video.HEADER.unpack_from(content)[1])


async def test_viewers_that_take_h264_get_it_where_the_server_has_it() -> None:
    try:
        OpenH264()
    except ConfigError as error:
        pytest.skip(str(error))
    settings = Settings.model_validate({"server": {**SERVER, "h264": True}})
    rig = FakeRig(settings)
    app = create_app(rig, settings)
    async with listening(app) as port:
        url = f"ws://127.0.0.1:{port}/ws/video?width=80&token={VIEWER_TOKEN}"
        async with AsyncExitStack() as links:
            plain = await links.enter_async_context(connect(url))
            coded = [await links.enter_async_context(connect(f"{url}&codec=h264")) for _ in range(5)]
            seen = []
            for number in range(3):
                rig.show(number)
                seen.append([await picture_format(link) for link in (plain, *coded)])
        # The fifth finds no encoder free.
        key, delta = ([video.JPEG, *[form] * 4, video.JPEG] for form in (video.H264_KEY, video.H264_DELTA))
        assert seen == [key, delta, delta]
        hub = app.state.context.video
        await gone(lambda: hub.clients)
        async with connect(f"{url}&codec=h264") as link:
            assert await picture_format(link) == video.H264_KEY
    app.state.context.encoder.close()


async def test_a_server_without_h264_sends_jpeg_to_whoever_takes_it(site: Site) -> None:
    async with connect(f"ws://127.0.0.1:{site.port}/ws/video?codec=h264&token={VIEWER_TOKEN}") as link:
        site.rig.show(1)
        assert await picture_format(link) == video.JPEG


async def test_each_size_is_encoded_once_a_frame(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    encoded: list[tuple[int, int]] = []
    real = video.encode_jpeg

    def counted(frame: Frame, width_px: int, quality: int) -> bytes:
        encoded.append((frame.number, width_px))
        return real(frame, width_px, quality)

    monkeypatch.setattr(video, "encode_jpeg", counted)
    url = f"ws://127.0.0.1:{site.port}/ws/video?token={VIEWER_TOKEN}&width="
    async with connect(url + "80") as one, connect(url + "81") as two, connect(url + "160") as three:
        for number in (1, 2):
            site.rig.show(number)
            for link in (one, two, three):
                await link.recv()
    assert sorted(encoded) == [(1, 80), (1, 160), (2, 80), (2, 160)]


async def test_a_client_that_leaves_takes_no_picture_from_another(monkeypatch: pytest.MonkeyPatch) -> None:
    encoding = threading.Event()

    def slow(frame: Frame, width_px: int, quality: int) -> bytes:
        encoding.wait(10.0)
        return b"jpeg"

    monkeypatch.setattr(video, "encode_jpeg", slow)
    rig = FakeRig()
    encoder = video.VideoEncoder(rig.frames)
    rig.show(1)
    async with asyncio.TaskGroup() as group:
        leaving = group.create_task(encoder.newer_than(0, 80, 75))
        staying = group.create_task(encoder.newer_than(0, 80, 75))
        await asyncio.sleep(0)
        leaving.cancel()
        await asyncio.wait({leaving})
        encoding.set()
    assert staying.result()[1] == b"jpeg"
    encoder.close()


async def gone(clients: Callable[[], int]) -> None:
    async for _ in ticks(0.01, asyncio.get_running_loop().time):
        if clients() == 0:
            return


async def test_mjpeg_parts(site: Site) -> None:
    site.rig.show(1)
    url = f"http://127.0.0.1:{site.port}/video.mjpeg?width=80"
    headers = {"Authorization": f"Bearer {VIEWER_TOKEN}"}
    async with httpx.AsyncClient() as client, client.stream("GET", url, headers=headers) as answer:
        assert answer.headers["content-type"] == "multipart/x-mixed-replace; boundary=frame"
        parts = b""
        async for chunk in answer.aiter_raw():
            parts += chunk
            if parts.count(b"--frame") == 2:
                break
            if parts.endswith(b"\r\n"):
                site.rig.show(2)
    head, _, rest = parts.partition(b"\r\n\r\n")
    assert head.startswith(b"--frame\r\nContent-Type: image/jpeg")
    assert rest[:2] == b"\xff\xd8"
    site.rig.show(3)
    await gone(lambda: site.app.state.context.video.clients)


async def test_bodies_have_a_deadline(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guards, "_BODY_TIMEOUT_S", 0.1)
    reader, writer = await asyncio.open_connection("127.0.0.1", site.port)
    head = f"POST /api/v1/mode HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {OPERATOR_TOKEN}\r\n"
    writer.write(f"{head}Content-Length: 9\r\n\r\n".encode())
    assert (await reader.readline()).split()[1] == b"408"
    writer.close()


async def test_headers_have_a_deadline(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "HEADER_DEADLINE_S", 0.2)
    async with site.twin() as link:
        for start in (b"", b"GET / HTTP/1.1\r\nX-Slow: ", b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n"):
            reader, writer = await asyncio.open_connection("127.0.0.1", site.port)
            writer.write(start)
            if b"healthz" in start:
                await reader.readuntil(b'{"status":"ok"}')
                writer.write(b"GET /")
            with contextlib.suppress(ConnectionResetError):
                await reader.read()
            writer.close()
        site.rig.publish(seq=9)
        while (await message(link, "state"))["seq"] != 9:
            pass
