"""The picture as H.264 in a real browser, and JPEG where its decoder fails."""

from pathlib import Path

import pytest
from playwright.sync_api import Page, WebSocket, expect

from mrnav_server.app.openh264 import OpenH264
from mrnav_server.app.video import H264_DELTA, H264_KEY, HEADER, JPEG
from mrnav_server.core.errors import ConfigError
from tests.e2e.pages_server import pages_server, signed_in
from tests.e2e.test_e2e_dashboard import PATIENCE_MS, page

__all__ = ["page"]
pytestmark = [pytest.mark.browser, pytest.mark.timeout(120)]
_FAILS = "VideoDecoder.prototype.decode = function () { this.close(); throw new Error('no such decoder'); };"


@pytest.fixture(autouse=True)
def library() -> None:
    try:
        OpenH264()
    except ConfigError as error:
        pytest.skip(str(error))


def formats(page: Page) -> list[int]:
    """Return a list that gets the format of every picture that the page is sent."""
    found: list[int] = []

    def look(message: str | bytes) -> None:
        if isinstance(message, bytes):
            found.append(HEADER.unpack_from(message)[1])

    def watch(socket: WebSocket) -> None:
        if "/ws/video" in socket.url:
            socket.on("framereceived", look)

    page.on("websocket", watch)
    return found


def test_the_page_draws_h264(tmp_path: Path, page: Page) -> None:
    seen = formats(page)
    with pages_server(tmp_path, h264=True) as url:
        page.goto(signed_in(url, "/"))
        expect(page.get_by_test_id("video-placeholder")).to_be_hidden(timeout=PATIENCE_MS)
        page.wait_for_timeout(500)
        pixel = page.locator("#video").evaluate("c => [...c.getContext('2d').getImageData(9, 9, 1, 1).data]")
    assert seen[0] == H264_KEY
    assert set(seen[1:]) == {H264_DELTA}
    assert pixel == pytest.approx([90, 90, 90, 255], abs=4)


def test_a_browser_whose_decoder_fails_gets_jpeg(tmp_path: Path, page: Page) -> None:
    seen = formats(page)
    page.add_init_script(_FAILS)
    with pages_server(tmp_path, h264=True) as url:
        page.goto(signed_in(url, "/"))
        expect(page.get_by_test_id("video-placeholder")).to_be_hidden(timeout=PATIENCE_MS)
        page.wait_for_timeout(500)
    assert seen[0] == H264_KEY
    assert seen[-1] == JPEG
