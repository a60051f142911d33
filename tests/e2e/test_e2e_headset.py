"""The headset page in an emulated headset, against a real server on the simulated rig."""

import math
import os
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser, expect, sync_playwright

from tests.e2e.axe import stumbling_blocks
from tests.e2e.headset import BY_SOFTWARE, IWER, REST_M, Headset
from tests.e2e.test_e2e_dashboard import CHROMIUM, FLAGS, PATIENCE_MS
from tests.rig_process import RigProcess

pytestmark = [
    pytest.mark.browser,
    pytest.mark.timeout(240),
    pytest.mark.skipif(not IWER.is_file(), reason="static/node_modules is not installed: make check-static"),
]
LEAST_HZ = 20.0
"""For a machine that does much else; `mrnav bench headset` measures the rate."""


@pytest.fixture
def browser() -> Iterator[Browser]:
    os.environ["no_proxy"] = "127.0.0.1"
    flags = [flag for flag in FLAGS if flag != "--disable-3d-apis"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags + BY_SOFTWARE)
        yield browser
        browser.close()


def tip(rig: RigProcess) -> tuple[float, float]:
    x_um, y_um, _ = rig.state["tip_um"]
    return x_um, y_um


def moved_um(rig: RigProcess, since: tuple[float, float]) -> float:
    return math.dist(tip(rig), since)


def in_mode(mode: str, *, clutch: bool | None = None) -> Any:  # noqa: ANN401 - a condition of RigProcess.until
    return lambda state: state["mode"] == mode and clutch in (None, state["clutch"])


def persist(rig: RigProcess, act: Callable[[], None], condition: Callable[[dict[str, Any]], bool]) -> None:
    """Act until it has the effect: a machine that stalls makes the rig hold at any moment."""
    for left in (3, 2, 1, 0):
        act()
        try:
            rig.until(condition, "the effect", 8.0)
        except AssertionError:
            if not left:
                raise
        else:
            return


def armed(headset: Headset, rig: RigProcess) -> None:
    headset.enter()
    rig.until(lambda s: s["lease"]["hand"] and s["track"]["state"] == "tracking", "the hand's seat")

    def arm() -> None:
        if rig.state["mode"] == "DISARMED":
            headset.press("Arm")

    persist(rig, arm, lambda s: s["mode"] in ("MANUAL", "HOLD"))


def pinch_anew(headset: Headset) -> None:
    headset.do("pinch", False)
    headset.wait(250)
    headset.do("pinch", True)


@pytest.mark.parametrize("kind", ["hand", "controller"])
def test_an_operator_drives_loses_the_hand_and_goes_on(
    rig_process: RigProcess, browser: Browser, kind: str
) -> None:
    headset = Headset(browser, rig_process, kind=kind)
    armed(headset, rig_process)
    start, first = tip(rig_process), len(headset.sent)

    def drive() -> None:
        pinch_anew(headset)
        headset.do("move", [0.04, 0.0, 0.0], 1500)

    persist(rig_process, drive, lambda _: moved_um(rig_process, start) > 500.0)
    assert headset.rate_hz(first) > LEAST_HZ

    persist(rig_process, lambda: pinch_anew(headset), in_mode("MANUAL", clutch=True))
    headset.see_hand(False)
    rig_process.until(in_mode("HOLD", clutch=False), "HOLD without a hand")
    headset.wait(200)
    assert headset.sent[-1]["valid"] is False
    assert not headset.sent[-1]["clutch"]
    silent, held = len(headset.sent), tip(rig_process)
    headset.do("pinch", False)
    headset.do("rest", [REST_M[0] - 0.2, REST_M[1] + 0.1, REST_M[2]])
    # Long enough for the seat to be freed: it comes back with the hand.
    rig_process.until(lambda s: not s["lease"]["hand"], "the silent hand's seat")
    assert len(headset.sent) == silent, "a hand that is not seen sends nothing"

    headset.see_hand(True)
    rig_process.until(lambda s: s["lease"]["hand"], "the seat, again")
    headset.wait(300)
    assert not any(message["clutch"] for message in headset.sent[silent:])
    persist(rig_process, lambda: pinch_anew(headset), in_mode("MANUAL", clutch=True))
    headset.wait(300)
    assert moved_um(rig_process, held) < 60.0, "the tip went on from where it was"
    if kind == "controller":
        headset.page.evaluate("window.guessing = true")
        rig_process.until(in_mode("HOLD", clutch=False), "HOLD: the place of the controller is a guess")
    assert headset.complaints == []


def test_a_pinch_takes_over_and_who_leaves_can_come_back(rig_process: RigProcess, browser: Browser) -> None:
    headset = Headset(browser, rig_process)
    armed(headset, rig_process)
    site = rig_process.snapshot["vessel"]["suggested_areas"][0]
    (a, _, tx), (_, d, ty) = rig_process.snapshot["calibration"]["image_from_vessel"]
    headset.mark((a * site["x_px"] + tx) / 1600, (d * site["y_px"] + ty) / 1200)
    rig_process.until(lambda s: s["critical_area"] is not None, "the area")
    (area,) = rig_process.http.get("/api/v1/critical-areas").json()
    center = (area["center"]["x_px"], area["center"]["y_px"])
    assert math.dist(center, (site["x_px"], site["y_px"])) < 20.0

    def take_over() -> None:
        rig_process.until(lambda s: s["auto_ready"], "AUTO to be possible")
        persist(rig_process, lambda: headset.press("Auto"), in_mode("AUTO"))
        pinch_anew(headset)

    def taken(state: dict[str, Any]) -> bool:
        by_hand = any(e["event"] == "handover" and e["by"] == "takeover" for e in rig_process.events)
        return by_hand and in_mode("MANUAL", clutch=True)(state)

    persist(rig_process, take_over, taken)
    headset.do("pinch", False)

    headset.press("Leave")
    headset.page.wait_for_selector("html[data-xr=outside]", timeout=PATIENCE_MS)
    rig_process.until(
        lambda s: not s["lease"]["hand"] and s["lease"]["console"] is None, "the seats to be free"
    )
    headset.wait(100)
    left = len(headset.sent)
    headset.wait(300)
    assert len(headset.sent) == left
    headset.enter()
    rig_process.until(lambda s: s["lease"]["hand"], "the seat, again")
    headset.press("STOP")
    rig_process.until(in_mode("STOP"), "STOP")
    assert headset.complaints == []


def test_another_hand_keeps_its_seat_and_a_viewer_gets_none(
    rig_process: RigProcess, browser: Browser
) -> None:
    rig_process.start_operator()
    headset = Headset(browser, rig_process)
    headset.enter()
    headset.wait(500)
    assert headset.page.locator("html").get_attribute("data-seated") == "false"
    assert headset.sent == []
    headset.close()
    viewer = Headset(browser, rig_process, role="viewer", lacks="immersive-ar")
    expect(viewer.page.get_by_test_id("checks")).to_contain_text("Virtual reality only", timeout=PATIENCE_MS)
    viewer.enter()
    assert viewer.page.evaluate("headset.device.activeSession.environmentBlendMode") == "opaque"
    viewer.wait(300)
    assert viewer.sent == []
    viewer.press("STOP")
    rig_process.until(in_mode("STOP"), "STOP by a viewer")


def test_the_page_says_what_is_missing(rig_process: RigProcess, browser: Browser) -> None:
    page = browser.new_page()
    page.goto(f"{rig_process.url}/xr?token={rig_process.ready['operator_token']}")
    expect(page.get_by_test_id("checks")).to_contain_text("headset's own browser", timeout=PATIENCE_MS)
    expect(page.get_by_test_id("enter")).to_be_disabled()
    expect(page.get_by_test_id("authority")).to_be_hidden()
    assert stumbling_blocks(page) == []
    page.close()
    context = browser.new_context()
    context.add_init_script(
        "Object.defineProperty(window, 'isSecureContext', { value: false });"
        "Object.defineProperty(navigator, 'xr', { value: undefined });"
    )
    page = context.new_page()
    page.goto(f"{rig_process.url}/xr")
    for advice in ("mrnav tls --save", "with the token"):
        expect(page.get_by_test_id("checks")).to_contain_text(advice, timeout=PATIENCE_MS)
    expect(page.get_by_test_id("summary")).to_contain_text("missing")
    expect(page.get_by_test_id("enter")).to_be_disabled()
