"""The vessel registered from the page, and another one imported, against a real server."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from playwright.sync_api import Page, expect

from tests.e2e.test_e2e_dashboard import PATIENCE_MS, page
from tests.rig_process import RigProcess

__all__ = ["page"]
pytestmark = [pytest.mark.browser, pytest.mark.timeout(180)]


@pytest.fixture
def shifted(tmp_path: Path) -> Iterator[RigProcess]:
    elsewhere = {"MRNAV_SIM__VESSEL_SHIFT_UM": "[900.0, -600.0]", "MRNAV_SIM__VESSEL_TURN_DEG": "3.0"}
    rig = RigProcess(tmp_path, MRNAV_MODELS__ROOT=str(tmp_path / "models"), **elsewhere)
    yield rig
    rig.end()


def test_an_operator_registers_the_vessel_from_the_page(shifted: RigProcess, page: Page) -> None:
    page.goto(shifted.ready["url"])
    expect(page.get_by_test_id("mode")).to_have_text("DISARMED", timeout=PATIENCE_MS)
    page.get_by_test_id("registration").locator("summary").click()
    find, overlap = page.get_by_test_id("registration-find"), page.get_by_test_id("registration-overlap")
    expect(find).to_be_disabled()
    page.get_by_test_id("take").click()
    expect(find).to_be_enabled(timeout=PATIENCE_MS)
    page.get_by_test_id("nudge-right").click()
    expect(page.get_by_test_id("registration-pose")).to_contain_text("50, 0 µm", timeout=PATIENCE_MS)
    find.click()
    expect(page.get_by_test_id("registration-pose")).not_to_contain_text("50, 0 µm", timeout=PATIENCE_MS)
    expect(overlap).to_contain_text("9", timeout=PATIENCE_MS)
    found = shifted.http.get("/api/v1/registration").json()
    assert found["pose"]["turn_deg"] == pytest.approx(3.0, abs=0.1)
    vessel_from_a_picture(page)
    choose_vessel(page, "channel")
    page.get_by_test_id("arm").click()
    expect(page.get_by_test_id("training-why")).to_contain_text("disarm", timeout=PATIENCE_MS)
    expect(page.get_by_test_id("training-begin")).to_be_disabled()
    expect(find).to_be_disabled(timeout=PATIENCE_MS)


def vessel_from_a_picture(page: Page) -> None:
    """Bring a picture of a vessel, begin a training for it, load the page again, and cancel it."""
    mask = np.zeros((300, 300), np.uint8)
    mask[100:200, 20:280] = 255
    picture = cv2.imencode(".png", mask)[1].tobytes()
    page.get_by_test_id("training").locator("summary").click()
    page.get_by_test_id("training-from-file").check(force=True)
    page.get_by_test_id("training-file").set_input_files(
        {"name": "channel.png", "mimeType": "image/png", "buffer": picture}
    )
    page.get_by_test_id("training-name").fill("channel")
    page.get_by_test_id("training-scale").fill("20")
    page.get_by_test_id("training-find").click()
    expect(page.get_by_test_id("training-facts")).to_contain_text("mostly 2.0", timeout=4 * PATIENCE_MS)
    assert page.get_by_test_id("training-preview").evaluate("image => image.decode().then(() => image.width)")
    page.get_by_test_id("training-begin").click()
    expect(page.get_by_test_id("training-text")).to_contain_text("shortest paths", timeout=PATIENCE_MS)
    page.reload()
    expect(page.get_by_test_id("training-text")).to_contain_text("channel", timeout=PATIENCE_MS)
    page.get_by_test_id("training-cancel").click()
    expect(page.get_by_test_id("training-cancel")).to_be_hidden(timeout=PATIENCE_MS)
    page.get_by_test_id("take").click()


def choose_vessel(page: Page, name: str) -> None:
    """Lay another vessel under the microscope; whoever has control keeps it."""
    page.get_by_test_id("registration").locator("summary").click()
    page.get_by_test_id("vessel-choice").select_option(name)
    page.get_by_test_id("vessel-change").click()
    expect(page.get_by_test_id("vessel-name")).to_have_text(name, timeout=2 * PATIENCE_MS)
    expect(page.get_by_test_id("arm")).to_be_enabled(timeout=PATIENCE_MS)
