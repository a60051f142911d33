"""Whole trials from the page, by pointer and by keyboard alone, against a real server."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.e2e.axe import stumbling_blocks
from tests.e2e.conftest import CALM, came
from tests.e2e.test_e2e_dashboard import PATIENCE_MS, page
from tests.rig_process import RigProcess

__all__ = ["page"]
pytestmark = [pytest.mark.browser, pytest.mark.timeout(400)]
REPORT_MS = 120_000
GAMEPAD = """() => {
  const up = () => Array.from({ length: 17 }, () => ({ pressed: false, value: 0 }));
  window.pad = { connected: true, mapping: "standard", id: "a pad", axes: [0, 0], buttons: up() };
  window.pad.press = (...down) => {
    window.pad.buttons = up();
    for (const button of down) window.pad.buttons[button] = { pressed: true, value: 1 };
  };
  navigator.getGamepads = () => [window.pad];
}"""
TRIES = 4
"""A busy machine may hold the rig under way: whoever operates it goes on, as a person would."""


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[RigProcess]:
    rig = RigProcess(tmp_path, **CALM)
    yield rig
    rig.end()


def on_picture(page: Page, rig: RigProcess, x_px: float, y_px: float) -> tuple[float, float]:
    """Return where a point of the vessel's grid is on the screen."""
    (a, _, tx), (_, d, ty) = rig.snapshot["calibration"]["image_from_vessel"]
    box = page.get_by_test_id("overlay").bounding_box()
    assert box is not None
    x = box["x"] + (a * x_px + tx) / 1600 * box["width"]
    return x, box["y"] + (d * y_px + ty) / 1200 * box["height"]


def pressed(button: Locator) -> None:
    expect(button).to_have_attribute("aria-pressed", "true", timeout=PATIENCE_MS)


def test_an_operator_marks_drives_takes_over_and_answers(rig: RigProcess, page: Page) -> None:
    page.goto(rig.ready["url"])
    expect(page.locator("html")).to_have_attribute("data-video", "live", timeout=PATIENCE_MS)
    page.get_by_test_id("take").click()
    expect(page.get_by_test_id("arm")).to_be_enabled(timeout=PATIENCE_MS)

    site = rig.snapshot["vessel"]["suggested_areas"][0]
    x, y = on_picture(page, rig, site["x_px"], site["y_px"])
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 30, y, steps=3)
    page.mouse.up()
    expect(page.get_by_label("Choose area-1")).to_be_checked(timeout=PATIENCE_MS)
    drawn = rig.http.get("/api/v1/critical-areas/area-1").json()
    box = page.get_by_test_id("overlay").bounding_box()
    assert box is not None
    assert drawn["epsilon_um"] == pytest.approx(30 * 24_000 / box["width"], abs=40)

    page.get_by_test_id("trial-start").click()
    expect(page.get_by_test_id("trial-running")).to_be_visible(timeout=PATIENCE_MS)
    page.get_by_test_id("arm").click()
    page.get_by_test_id("tool-steer").click()
    expect(page.get_by_test_id("hand")).to_have_text("Live", timeout=PATIENCE_MS)
    let_it_drive(page, rig)
    drag(page, rig)

    page.get_by_test_id("scale-fine").click()
    pressed(page.get_by_test_id("scale-fine"))
    expect(page.get_by_test_id("learned")).to_contain_text("offset", timeout=PATIENCE_MS)
    page.get_by_test_id("disarm").click()
    expect(page.get_by_test_id("mode")).to_have_text("DISARMED", timeout=PATIENCE_MS)
    page.get_by_test_id("trial-end").click()
    expect(page.get_by_test_id("trial-result")).to_be_visible(timeout=REPORT_MS)

    with page.expect_popup() as opened:
        page.get_by_test_id("trial-tlx").click()
    fill_tlx(opened.value)
    with page.expect_popup() as opened:
        page.get_by_test_id("trial-results").click()
    expect(opened.value.get_by_text("P01").first).to_be_visible(timeout=PATIENCE_MS)


def let_it_drive(page: Page, rig: RigProcess) -> None:
    """Ask for AUTO until it was entered."""

    def entered(_: object) -> bool:
        return any(event["event"] == "mode" and event["mode"] == "AUTO" for event in rig.events)

    for _ in range(TRIES):
        expect(page.get_by_test_id("auto")).to_be_enabled(timeout=PATIENCE_MS)
        page.get_by_test_id("auto").click()
        if came(rig, entered):
            return
    raise AssertionError(f"AUTO was not entered: {rig.state['mode']}, {rig.state['reason']}")


def drag(page: Page, rig: RigProcess) -> None:
    """Take over from AUTO by pressing on the picture, and drag the magnet along the vessel."""
    box = page.get_by_test_id("overlay").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    for _ in range(TRIES):
        page.mouse.move(x, y)
        page.mouse.down()
        rig.until(lambda s: s["mode"] == "MANUAL" and s["clutch"], "the take-over")
        expect(page.locator("html")).to_have_attribute("data-hand", "pointer", timeout=PATIENCE_MS)
        before = rig.state["tip_um"]
        page.mouse.move(x - 20, y - 20, steps=20)
        page.wait_for_timeout(500)
        moved_um = [now - then for now, then in zip(rig.state["tip_um"], before, strict=True)]
        page.mouse.up()
        rig.until(lambda s: not s["clutch"], "the open clutch")
        if moved_um[0] < -300 and moved_um[1] < -300:
            return
    raise AssertionError(f"the magnet did not follow the pointer: {moved_um}")


def fill_tlx(form: Page) -> None:
    """Fifteen pairs and six scales, by keyboard."""
    # Keys go to what is hidden too, and nobody hears them there.
    expect(form.get_by_test_id("begin")).to_be_visible(timeout=PATIENCE_MS)
    form.get_by_test_id("begin").press("Enter")
    for number in range(1, 16):
        expect(form.get_by_test_id("pair-count")).to_have_text(f"Pair {number} of 15", timeout=PATIENCE_MS)
        form.keyboard.press("ArrowLeft")
    expect(form.get_by_test_id("step-scales")).to_be_visible(timeout=PATIENCE_MS)
    for scale in form.get_by_role("group").all():
        scale.get_by_role("radio").first.press("ArrowRight")
    form.get_by_test_id("hand-in").press("Enter")
    expect(form.get_by_test_id("step-done")).to_be_visible(timeout=PATIENCE_MS)


def test_a_trial_is_run_without_a_pointer(rig: RigProcess, page: Page) -> None:
    page.emulate_media(reduced_motion="reduce")
    page.set_viewport_size({"width": 820, "height": 1180})
    page.goto(rig.ready["url"])
    expect(page.locator("html")).to_have_attribute("data-video", "live", timeout=PATIENCE_MS)
    assert stumbling_blocks(page) == []
    assert page.get_by_test_id("take").evaluate("b => getComputedStyle(b).transitionDuration") == "0s"

    walk_to(page, "take").press("Enter")
    expect(page.get_by_test_id("arm")).to_be_enabled(timeout=PATIENCE_MS)
    walk_to(page, "tool-mark").press("Enter")
    expect(page.get_by_test_id("overlay")).to_be_focused()
    page.keyboard.press("ArrowUp")
    page.keyboard.press("Enter")
    expect(page.get_by_label("Choose area-1")).to_be_checked(timeout=PATIENCE_MS)
    walk_to(page, "participant").fill("P07")
    page.keyboard.press("Enter")
    expect(page.get_by_test_id("trial-running")).to_be_visible(timeout=PATIENCE_MS)
    walk_to(page, "arm").press("Enter")
    rig.until(lambda s: s["mode"] == "HOLD", "armed without a hand")

    walk_to(page, "tool-steer").press("Enter")
    expect(page.locator("html")).to_have_attribute("data-hand", "open", timeout=PATIENCE_MS)
    before = rig.state["tip_um"]
    page.keyboard.down("ArrowLeft")
    rig.until(lambda s: s["mode"] == "MANUAL" and s["tip_um"][0] < before[0] - 200, "the magnet going left")
    assert stumbling_blocks(page) == []
    page.keyboard.up("ArrowLeft")
    rig.until(lambda s: not s["clutch"], "the open clutch")
    steer_by_gamepad(page, rig)
    walk_to(page, "trial-end").press("Enter")
    expect(page.get_by_test_id("trial-result")).to_be_visible(timeout=REPORT_MS)
    page.evaluate("pad.press(1)")
    expect(page.get_by_test_id("mode")).to_have_text("STOP", timeout=PATIENCE_MS)
    page.evaluate("pad.press()")
    walk_to(page, "reset").press("Enter")
    expect(page.get_by_test_id("mode")).to_have_text("DISARMED", timeout=PATIENCE_MS)
    page.evaluate("scrollTo(0, document.body.scrollHeight)")
    expect(page.get_by_test_id("stop")).to_be_in_viewport(ratio=1)
    page.keyboard.press("Escape")
    expect(page.get_by_test_id("mode")).to_have_text("STOP", timeout=PATIENCE_MS)


def steer_by_gamepad(page: Page, rig: RigProcess) -> None:
    """Put a gamepad before the page: trigger, left stick and Y."""
    page.evaluate(f"({GAMEPAD})(); pad.press(7)")
    page.wait_for_timeout(200)
    assert not rig.state["clutch"], "a trigger that was held from before steers nothing"
    page.evaluate("pad.press()")
    page.evaluate("pad.axes = [1, 0]")
    page.wait_for_timeout(200)
    before = rig.state["tip_um"]
    page.evaluate("pad.press(7)")
    rig.until(lambda s: s["clutch"] and s["tip_um"][0] > before[0] + 200, "the magnet going right")
    expect(page.locator("html")).to_have_attribute("data-hand", "gamepad")
    page.evaluate("pad.press()")
    rig.until(lambda s: not s["clutch"], "the open clutch")
    page.evaluate("pad.press(3)")
    pressed(page.get_by_test_id("scale-fine"))
    page.evaluate("pad.press()")


def walk_to(page: Page, name: str) -> Locator:
    """Press Tab until something has the focus."""
    wanted = page.get_by_test_id(name)
    for _ in range(120):
        if wanted.evaluate("element => element === document.activeElement"):
            return wanted
        page.keyboard.press("Tab")
    raise AssertionError(f"Tab never reaches {name}")
