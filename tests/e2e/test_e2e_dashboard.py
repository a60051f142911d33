"""The dashboard in a real browser against a real server: what an operator sees, and what the buttons do."""

import os
import shutil
import signal
from collections.abc import Iterator

import pytest
from playwright.sync_api import Page, expect, sync_playwright

from tests.rig_process import RigProcess

pytestmark = [pytest.mark.browser, pytest.mark.timeout(180)]
CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), ""
)
FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-3d-apis",  # drawn by software, the twin would take the server's cores
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
PATIENCE_MS = 20_000
AN_ANSWER_THEN_A_FAULT = """async () => {
  const { Messages } = await import("/static/js/messages.js");
  const messages = new Messages();
  const shown = () => document.getElementById("message-text").textContent;
  messages.say("refused", "warning");
  messages.report("a fault", "warning");
  const seen = [shown()];
  messages.clear();
  seen.push(shown());
  messages.report("another fault", "warning");
  return [...seen, shown()];
}"""


@pytest.fixture
def page() -> Iterator[Page]:
    os.environ["no_proxy"] = "127.0.0.1"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        complaints: list[str] = []
        page.on("pageerror", lambda error: complaints.append(str(error)))
        yield page
        browser.close()
        assert complaints == []


def test_an_operator_runs_a_task_from_the_page(rig_process: RigProcess, page: Page) -> None:
    page.goto(rig_process.ready["url"])
    assert "token" not in page.url
    expect(page.get_by_test_id("simulated")).to_be_visible()
    expect(page.get_by_test_id("mode")).to_have_text("DISARMED", timeout=PATIENCE_MS)
    expect(page.locator("html")).to_have_attribute("data-video", "live", timeout=PATIENCE_MS)

    page.get_by_test_id("take").click()
    expect(page.get_by_test_id("arm")).to_be_enabled(timeout=PATIENCE_MS)
    box = page.get_by_test_id("overlay").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 0.02 * box["width"], box["y"] + 0.5 * box["height"])
    expect(page.get_by_test_id("message-text")).to_contain_text("outside", timeout=PATIENCE_MS)
    assert page.evaluate(AN_ANSWER_THEN_A_FAULT) == ["Refused.", "A fault.", "Another fault."]
    site = rig_process.snapshot["vessel"]["suggested_areas"][0]
    (a, _, tx), (_, d, ty) = rig_process.snapshot["calibration"]["image_from_vessel"]
    x_px, y_px = a * site["x_px"] + tx, d * site["y_px"] + ty
    page.mouse.click(box["x"] + x_px / 1600 * box["width"], box["y"] + y_px / 1200 * box["height"])
    expect(page.get_by_label("Choose area-1")).to_be_checked(timeout=PATIENCE_MS)
    marked = rig_process.http.get("/api/v1/critical-areas").json()[0]["center"]
    assert abs(marked["x_px"] - site["x_px"]) < 4.0
    assert abs(marked["y_px"] - site["y_px"]) < 4.0

    page.get_by_test_id("arm").click()
    expect(page.get_by_test_id("auto")).to_be_enabled(timeout=PATIENCE_MS)
    page.get_by_test_id("auto").click()
    rig_process.until(lambda s: s["mode"] == "AUTO", "AUTO")
    rig_process.until(lambda s: s["distance_um"] is not None and s["distance_um"] < 500, "arrival")

    page.keyboard.press("Space")
    expect(page.get_by_test_id("mode")).to_have_text("STOP", timeout=PATIENCE_MS)
    page.get_by_test_id("reset").click()
    expect(page.get_by_test_id("mode")).to_have_text("DISARMED", timeout=PATIENCE_MS)


def test_a_viewer_sees_all_and_can_only_stop(rig_process: RigProcess, page: Page) -> None:
    page.goto(f"{rig_process.url}/?token={rig_process.ready['viewer_token']}")
    expect(page.get_by_test_id("mode")).to_have_text("DISARMED", timeout=PATIENCE_MS)
    for control in ("take", "arm", "auto"):
        expect(page.get_by_test_id(control)).to_be_disabled()
    page.get_by_test_id("stop").click()
    expect(page.get_by_test_id("mode")).to_have_text("STOP", timeout=PATIENCE_MS)


def test_without_a_token_the_page_says_what_to_do(rig_process: RigProcess, page: Page) -> None:
    page.goto(rig_process.url)
    expect(page.get_by_test_id("banner")).to_contain_text("Not signed in", timeout=PATIENCE_MS)


def test_data_that_stops_is_shown_as_stale_and_resumes(rig_process: RigProcess, page: Page) -> None:
    page.goto(rig_process.ready["url"])
    expect(page.locator("html")).to_have_attribute("data-data", "live", timeout=PATIENCE_MS)
    rig_process.process.send_signal(signal.SIGSTOP)
    expect(page.locator("html")).to_have_attribute("data-data", "stale", timeout=PATIENCE_MS)
    expect(page.get_by_test_id("banner")).to_be_visible()
    rig_process.process.send_signal(signal.SIGCONT)
    expect(page.locator("html")).to_have_attribute("data-data", "live", timeout=PATIENCE_MS)
