"""The questionnaire in a real browser: by keyboard alone, on a tablet held upright, and who may not."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from mrnav_server.core.tlx import KEYS, shown_pairs
from tests.app.fake_rig import VIEWER_TOKEN
from tests.e2e.axe import stumbling_blocks
from tests.e2e.pages_server import pages_server, signed_in
from tests.e2e.test_e2e_dashboard import PATIENCE_MS, page
from tests.recorded_trials import RecordedTrial

__all__ = ["page"]
pytestmark = [pytest.mark.browser, pytest.mark.timeout(180)]
TABLET = {"width": 768, "height": 1024}


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Three persons' trials, a simulated operator's, and one that still runs."""
    root = tmp_path_factory.mktemp("trials")
    persons = {name: RecordedTrial(name).record(root) for name in ("P01", "P02", "P03")}
    simulated = RecordedTrial("SIM01", operator_kind="simulated").record(root)
    return {**persons, "SIM01": simulated, "P04": RecordedTrial("P04").record(root, close=False)}


@pytest.fixture(scope="module")
def url(trials: dict[str, Path]) -> Iterator[str]:
    with pages_server(trials["P01"].parent) as url:
        yield url


def answer_pairs(page: Page, presses: list[str]) -> None:
    for number, key in enumerate(presses, start=1):
        expect(page.get_by_test_id("pair-count")).to_have_text(f"Pair {number} of 15", timeout=PATIENCE_MS)
        page.keyboard.press(key)


def test_a_person_answers_by_keyboard_alone(url: str, trials: dict[str, Path], page: Page) -> None:
    trial = trials["P01"]
    page.goto(signed_in(url, f"/tlx?trial={trial.name}"))
    expect(page.get_by_test_id("step-intro")).to_be_visible(timeout=PATIENCE_MS)
    expect(page.get_by_test_id("participant")).to_have_text("P01")
    assert stumbling_blocks(page) == []
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")

    presses = ["ArrowLeft", "ArrowRight"] * 7 + ["ArrowLeft"]
    answer_pairs(page, presses[:3])
    expect(page.get_by_test_id("pair-count")).to_have_text("Pair 4 of 15", timeout=PATIENCE_MS)
    assert stumbling_blocks(page) == []
    page.keyboard.press("Backspace")
    expect(page.get_by_test_id("pair-count")).to_have_text("Pair 3 of 15")
    expect(page.get_by_test_id("left")).to_have_attribute("data-chosen", "true")
    page.reload()
    expect(page.get_by_test_id("step-intro")).to_be_visible(timeout=PATIENCE_MS)
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    for number, key in enumerate(presses[3:], start=4):
        expect(page.get_by_test_id("pair-count")).to_have_text(f"Pair {number} of 15", timeout=PATIENCE_MS)
        page.keyboard.press(key)

    expect(page.get_by_test_id("step-scales")).to_be_visible(timeout=PATIENCE_MS)
    assert stumbling_blocks(page) == []
    marks = {}
    for steps, key in enumerate(KEYS, start=1):
        page.keyboard.press("Tab")
        expect(page.get_by_test_id(f"scale-{key}").locator(":focus")).to_have_count(1)
        page.keyboard.press("Space")
        for _ in range(2 * steps):
            page.keyboard.press("ArrowRight")
        marks[key] = 10 * steps
    page.keyboard.press("Tab")
    expect(page.get_by_test_id("hand-in")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.get_by_test_id("step-done")).to_be_visible(timeout=PATIENCE_MS)

    kept = json.loads((trial / "tlx.json").read_text())
    assert kept["answers"]["ratings"] == marks
    sides = [0 if key == "ArrowLeft" else 1 for key in presses]
    chosen = [pair[side] for pair, side in zip(shown_pairs(trial.name), sides, strict=True)]
    assert [each["chosen"] for each in kept["answers"]["choices"]] == chosen
    page.reload()
    expect(page.get_by_test_id("step-filled")).to_be_visible(timeout=PATIENCE_MS)


def test_it_fits_a_tablet_held_upright_and_asks_for_what_is_missing(
    url: str, trials: dict[str, Path], page: Page
) -> None:
    trial = trials["P02"]
    page.set_viewport_size({"width": TABLET["width"], "height": TABLET["height"]})
    page.goto(signed_in(url, f"/tlx?trial={trial.name}"))
    page.get_by_test_id("begin").click()
    for number in range(1, 16):
        expect(page.get_by_test_id("pair-count")).to_have_text(f"Pair {number} of 15", timeout=PATIENCE_MS)
        page.get_by_test_id("left").click()
    expect(page.get_by_test_id("step-scales")).to_be_visible(timeout=PATIENCE_MS)
    assert page.evaluate("document.documentElement.scrollWidth") <= TABLET["width"]
    mark = page.get_by_test_id("effort-55").locator("..")
    box = mark.bounding_box()
    assert box is not None
    assert box["width"] >= 24
    assert box["height"] >= 44
    mark.click()
    page.get_by_test_id("hand-in").click()
    expect(page.get_by_test_id("told")).to_contain_text("5 scales have no mark yet")
    expect(page.get_by_test_id("scale-mental")).to_have_attribute("data-missing", "true")
    expect(page.get_by_test_id("effort-55")).to_be_checked()
    assert not (trial / "tlx.json").exists()


def test_who_cannot_answer_is_told_why(url: str, trials: dict[str, Path], page: Page) -> None:
    told = page.get_by_test_id("told")
    for trial, why in (
        (trials["SIM01"].name, "Only people feel workload"),
        (trials["P04"].name, "still runs"),
        ("none", "there is no trial"),
    ):
        page.goto(signed_in(url, f"/tlx?trial={trial}"))
        expect(told).to_contain_text(why, timeout=PATIENCE_MS)
        expect(page.get_by_test_id("step-intro")).to_be_hidden()
    page.goto(signed_in(url, f"/tlx?trial={trials['P03'].name}", VIEWER_TOKEN))
    expect(told).to_contain_text("You may only watch", timeout=PATIENCE_MS)
    page.goto(f"{url}/tlx")
    expect(told).to_contain_text("Which trial?", timeout=PATIENCE_MS)
