"""The vessel registered from the page, against a real server whose vessel lies elsewhere."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.e2e.test_e2e_dashboard import PATIENCE_MS, page
from tests.rig_process import RigProcess

__all__ = ["page"]
pytestmark = [pytest.mark.browser, pytest.mark.timeout(180)]


@pytest.fixture
def shifted(tmp_path: Path) -> Iterator[RigProcess]:
    rig = RigProcess(tmp_path, MRNAV_SIM__VESSEL_SHIFT_UM="[900.0, -600.0]", MRNAV_SIM__VESSEL_TURN_DEG="3.0")
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
    page.get_by_test_id("arm").click()
    expect(find).to_be_disabled(timeout=PATIENCE_MS)
