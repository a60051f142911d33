"""What the page says when something fails under an operator's hands, and that nothing keeps moving."""

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, WebSocketRoute, expect, sync_playwright

from tests.e2e.conftest import CALM, came
from tests.e2e.test_e2e_dashboard import CHROMIUM, FLAGS, PATIENCE_MS
from tests.rig_process import RigProcess

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]
TRIES = 4
Prepare = Callable[[Page], object]
CHIEF = "chief-0123456789abcdef"
KEEP_LINKS = """
  window.links = [];
  window.WebSocket = class extends WebSocket {
    constructor(...all) {
      super(...all);
      links.push(this);
    }
  };
"""
HIDE = """hidden => {
  Object.defineProperty(document, "hidden", {value: hidden, configurable: true});
  document.dispatchEvent(new Event("visibilitychange"));
}"""


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[RigProcess]:
    rig = RigProcess(tmp_path, **CALM, MRNAV_SERVER__CHIEF_TOKEN=CHIEF)
    yield rig
    rig.end()


@pytest.fixture
def browser() -> Iterator[Browser]:
    os.environ["no_proxy"] = "127.0.0.1"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


def opened(browser: Browser, rig: RigProcess, token: str, prepare: Prepare | None = None) -> Page:
    """Return a page of a browser context of its own."""
    page = browser.new_context(viewport={"width": 1280, "height": 720}).new_page()
    if prepare is not None:
        prepare(page)
    page.goto(f"{rig.url}/?token={token}")
    return page


def in_control(page: Page) -> None:
    """Take control."""
    page.get_by_test_id("take").click(timeout=PATIENCE_MS)
    expect(page.get_by_test_id("lease")).to_have_text("You", timeout=PATIENCE_MS)


def steering(page: Page, rig: RigProcess) -> None:
    """Hold the clutch closed by a key, and let the magnet go left."""
    page.get_by_test_id("tool-steer").click()
    expect(page.locator("html")).to_have_attribute("data-hand", "open", timeout=PATIENCE_MS)
    for _ in range(TRIES):
        page.keyboard.down("ArrowLeft")
        if came(rig, lambda s: s["mode"] == "MANUAL" and s["clutch"]):
            return
        # A browser that stalls on a busy machine has to close the clutch anew.
        page.keyboard.up("ArrowLeft")
    raise AssertionError(f"the key does not steer: {rig.state['mode']}, {rig.state['reason']}")


def resting(page: Page, rig: RigProcess) -> None:
    """See the rig hold with an open clutch, although the key is still down, and stand still."""
    rig.until(lambda s: s["mode"] == "HOLD" and not s["clutch"], "the hold")
    page.wait_for_timeout(500)
    before = rig.state["tip_um"]
    page.wait_for_timeout(500)
    assert rig.state["tip_um"] == pytest.approx(before, abs=20.0)
    page.keyboard.up("ArrowLeft")


def test_nothing_keeps_moving_and_the_page_says_what_to_do(rig: RigProcess, browser: Browser) -> None:
    page = opened(browser, rig, rig.ready["operator_token"], lambda page: page.add_init_script(KEEP_LINKS))
    said = page.get_by_test_id("message-text")
    in_control(page)
    page.get_by_test_id("arm").click()

    # The connection is lost under the hand, and comes back.
    steering(page, rig)
    page.evaluate("links.filter(link => link.url.includes('twin')).at(-1).close()")
    resting(page, rig)
    expect(page.locator("html")).to_have_attribute("data-data", "live", timeout=PATIENCE_MS)
    expect(page.get_by_test_id("lease")).to_have_text("You", timeout=PATIENCE_MS)

    # Another tab of this browser.
    tab = page.context.new_page()
    tab.goto(rig.url)
    expect(tab.get_by_test_id("next-step")).to_contain_text("Another tab", timeout=PATIENCE_MS)
    expect(tab.get_by_test_id("arm")).to_be_disabled()
    tab.close()
    page.bring_to_front()

    # Nobody sees the page; it comes back after its seat is gone.
    steering(page, rig)
    page.evaluate(HIDE, True)
    resting(page, rig)
    rig.until(lambda s: s["lease"]["console"] is None, "the freed seat")
    page.evaluate(HIDE, False)
    expect(said).to_contain_text("Nobody saw this page", timeout=PATIENCE_MS)
    in_control(page)

    # Somebody with the stronger role takes over.
    chief = opened(browser, rig, CHIEF)
    chief.get_by_test_id("force").click(timeout=PATIENCE_MS)
    expect(chief.get_by_test_id("lease")).to_have_text("You", timeout=PATIENCE_MS)
    expect(said).to_contain_text("took control over", timeout=PATIENCE_MS)
    expect(page.get_by_test_id("tool-mark")).to_have_attribute("aria-pressed", "true")
    expect(page.get_by_test_id("hold")).to_be_disabled()
    page.get_by_test_id("stop").click()
    expect(page.get_by_test_id("mode")).to_have_text("STOP", timeout=PATIENCE_MS)


def test_an_old_server_and_a_camera_that_is_gone_are_named(rig: RigProcess, browser: Browser) -> None:
    def old(message: dict[str, Any]) -> dict[str, Any]:
        return message | {"v": 0} if message["type"] == "snapshot" else message

    def blind(message: dict[str, Any]) -> dict[str, Any]:
        rates = message.get("rates_hz")
        return message | {"rates_hz": rates | {"camera": 0.0}} if rates else message

    def changed(by: Callable[[dict[str, Any]], dict[str, Any]]) -> Callable[[Page], None]:
        def route(route: WebSocketRoute) -> None:
            server = route.connect_to_server()
            server.on_message(lambda text: route.send(json.dumps(by(json.loads(text)))))

        def prepare(page: Page) -> None:
            page.route_web_socket("**/ws/twin", route)
            page.route_web_socket("**/ws/video**", lambda route: route.close())

        return prepare

    page = opened(browser, rig, rig.ready["operator_token"], changed(old))
    expect(page.get_by_test_id("banner")).to_contain_text("Reload the page", timeout=PATIENCE_MS)
    expect(page.get_by_test_id("banner")).to_be_in_viewport(ratio=1)
    page.close()
    page = opened(browser, rig, rig.ready["operator_token"], changed(blind))
    expect(page.get_by_test_id("banner")).to_contain_text("camera gives no picture", timeout=PATIENCE_MS)
    page.get_by_test_id("stop").click()
    rig.until(lambda s: s["mode"] == "STOP", "STOP")
