"""The results in a real browser: metrics, path, speed, and whose motion it was."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from mrnav_server.study.trial_report import write_trial_report
from tests.e2e.axe import stumbling_blocks
from tests.e2e.pages_server import pages_server, signed_in
from tests.e2e.test_e2e_dashboard import PATIENCE_MS, page
from tests.recorded_trials import RecordedTrial, shipped_vessel

__all__ = ["page"]
pytestmark = [pytest.mark.browser, pytest.mark.timeout(180)]
COLOURS = """canvas => {
  const {data} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  const count = (color) => {
    let n = 0;
    for (let i = 0; i < data.length; i += 4) n += color.every((c, k) => Math.abs(data[i + k] - c) < 5);
    return n;
  };
  return {auto: count([240, 228, 66]), manual: count([204, 121, 167]), contact: count([213, 94, 0])};
}"""


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A person's trial, a simulated operator's with a wall contact, and one without a report."""
    root = tmp_path_factory.mktemp("trials")
    trials = [
        RecordedTrial("P01").record(root),
        RecordedTrial("SIM01", "without_autonomy", "simulated", sway_px=60.0).record(root),
        RecordedTrial("P02", simulated_rig=False).record(root),
    ]
    for folder in trials[:2]:
        write_trial_report(folder, shipped_vessel())
    return trials


@pytest.fixture(scope="module")
def url(trials: list[Path]) -> Iterator[str]:
    with pages_server(trials[0].parent) as url:
        yield url


def test_a_trial_is_read_at_a_glance(url: str, trials: list[Path], page: Page) -> None:
    page.goto(signed_in(url, f"/results?trial={trials[0].name}"))
    expect(page.get_by_test_id("path")).to_have_attribute("data-state", "drawn", timeout=PATIENCE_MS)
    expect(page.get_by_test_id("kind")).to_have_text(
        "Person on a simulated rig: the robot's motion is simulated"
    )
    expect(page.get_by_test_id("five")).to_contain_text("12.00")
    expect(page.get_by_test_id("five")).to_contain_text("lower is smoother")
    expect(page.get_by_test_id("speed").locator("canvas")).to_be_visible()
    drawn = page.get_by_test_id("path").evaluate(COLOURS)
    assert drawn["auto"] > 100
    assert drawn["manual"] > 30
    assert drawn["contact"] == 0
    assert stumbling_blocks(page) == []


def test_simulated_operators_are_named_so_everywhere(url: str, trials: list[Path], page: Page) -> None:
    page.goto(signed_in(url, "/results"))
    simulated = page.get_by_test_id("trials").locator("tr", has=page.get_by_test_id(trials[1].name))
    expect(simulated.locator(".chip")).to_have_text("simulated", timeout=PATIENCE_MS)
    page.get_by_test_id(trials[1].name).click()
    expect(page.get_by_test_id("kind")).to_have_text("Simulated operator: no evidence about people")
    expect(page.get_by_test_id("kind")).to_have_attribute("data-kind", "simulated")
    expect(page.get_by_test_id("ask")).to_be_hidden()
    expect(page.get_by_test_id("path")).to_have_attribute("data-state", "drawn", timeout=PATIENCE_MS)
    drawn = page.get_by_test_id("path").evaluate(COLOURS)
    assert drawn["auto"] == 0
    assert drawn["manual"] > 100
    assert drawn["contact"] > 30

    page.get_by_test_id("kind-human").click()
    expect(page.get_by_test_id("trials").locator("tr")).to_have_count(2)
    expect(page.get_by_test_id(trials[1].name)).to_have_count(0)
    page.get_by_test_id("kind-simulated").click()
    expect(page.get_by_test_id("trials").locator("tr")).to_have_count(1)


def test_a_trial_without_a_report_says_so_until_it_has_one(url: str, trials: list[Path], page: Page) -> None:
    page.goto(signed_in(url, f"/results?trial={trials[2].name}"))
    expect(page.get_by_test_id("kind")).to_have_text("Person on a real rig", timeout=PATIENCE_MS)
    expect(page.get_by_test_id("detail-note")).to_contain_text("has no report")
    expect(page.get_by_test_id("make")).to_be_visible()
    expect(page.get_by_test_id("ask")).to_have_attribute("href", f"/tlx?trial={trials[2].name}")
    write_trial_report(trials[2], shipped_vessel())
    # The list is read again every few seconds.
    expect(page.get_by_test_id("path")).to_have_attribute("data-state", "drawn", timeout=PATIENCE_MS)
    expect(page.get_by_test_id("detail-note")).to_have_text("")


def test_the_page_fits_and_says_what_to_do_without_a_token(url: str, trials: list[Path], page: Page) -> None:
    page.goto(f"{url}/results")
    expect(page.get_by_test_id("list-note")).to_contain_text("Not signed in", timeout=PATIENCE_MS)
    page.goto(signed_in(url, f"/results?trial={trials[0].name}"))
    expect(page.get_by_test_id("path")).to_have_attribute("data-state", "drawn", timeout=PATIENCE_MS)
    for width, height in ((1440, 900), (768, 1024), (390, 844)):
        page.set_viewport_size({"width": width, "height": height})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
