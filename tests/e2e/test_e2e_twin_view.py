"""The twin in three dimensions, drawn by a real browser without a graphics card."""

import io
import os
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

from mrnav_server.core.arrays import ByteArray
from tests.e2e.test_e2e_dashboard import CHROMIUM, FLAGS, PATIENCE_MS
from tests.rig_process import RigProcess

pytestmark = pytest.mark.browser
NO_3D = "--disable-3d-apis"
BY_SOFTWARE = [flag for flag in FLAGS if flag != NO_3D] + [
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


@pytest.fixture
def browser(request: pytest.FixtureRequest) -> Iterator[Browser]:
    os.environ["no_proxy"] = "127.0.0.1"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=request.param)
        yield browser
        browser.close()


def opened(browser: Browser, rig: RigProcess) -> Page:
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    page.goto(f"{rig.url}/?token={rig.ready['operator_token']}")
    return page


def picture(page: Page) -> ByteArray:
    png = np.frombuffer(io.BytesIO(page.get_by_test_id("twin-view").screenshot()).getvalue(), np.uint8)
    decoded = cv2.imdecode(png, cv2.IMREAD_COLOR)
    assert decoded is not None
    return np.asarray(decoded, np.uint8)


def greenish(image: ByteArray) -> int:
    blue, green, red = (image[..., i].astype(int) for i in range(3))
    return int(((green > 1.25 * red) & (green > 60) & (green >= blue)).sum())


@pytest.mark.parametrize("browser", [BY_SOFTWARE], indirect=True, ids=["software"])
def test_the_twin_is_drawn_and_follows_the_areas(rig_process: RigProcess, browser: Browser) -> None:
    page = opened(browser, rig_process)
    view = page.get_by_test_id("twin-view")
    expect(view).to_have_attribute("data-state", "ready", timeout=PATIENCE_MS)
    page.get_by_test_id("twin-microscope").click()
    page.wait_for_timeout(500)
    plain = picture(page)
    assert plain.std() > 20.0, "nothing was drawn"
    site = rig_process.snapshot["vessel"]["suggested_areas"][0]
    center = {"frame": "vessel", "x": site["x_px"], "y": site["y_px"]}
    rig_process.post("/api/v1/lease", {"client": "test"})
    rig_process.post("/api/v1/critical-areas", {"center": center, "epsilon_um": 900.0})
    page.wait_for_timeout(1500)
    assert greenish(picture(page)) > greenish(plain) + 20
    page.get_by_test_id("twin-orbit").click()
    page.wait_for_timeout(500)
    assert np.abs(picture(page).astype(int) - plain).mean() > 5.0


@pytest.mark.parametrize("browser", [FLAGS], indirect=True, ids=["no-webgl"])
def test_without_webgl_the_card_says_so_and_the_page_works(rig_process: RigProcess, browser: Browser) -> None:
    page = opened(browser, rig_process)
    expect(page.get_by_test_id("twin-view")).to_have_attribute("data-state", "missing", timeout=PATIENCE_MS)
    expect(page.get_by_text("The twin cannot be drawn here")).to_be_visible()
    expect(page.get_by_test_id("mode")).to_have_text("DISARMED", timeout=PATIENCE_MS)
