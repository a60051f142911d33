"""Recorded trials in a real browser: results, playback, and the study that leads to them."""

import re
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from playwright.sync_api import Page, expect

from mrnav_server.core.tlx import KEYS, Choice, shown_pairs
from mrnav_server.loops.tlx_record import TlxAnswers, keep_tlx
from mrnav_server.loops.video_recorder import VIDEO_NAME, VideoRecorder
from mrnav_server.study.plan import new_plan
from mrnav_server.study.study_folder import StudyFolder
from mrnav_server.study.trial_report import write_trial_report
from tests.e2e.axe import stumbling_blocks
from tests.e2e.pages_server import pages_server, signed_in
from tests.e2e.test_e2e_dashboard import PATIENCE_MS, page
from tests.recorded_trials import GO_S, HANDOVER_S, RecordedTrial, shipped_vessel

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
    root = tmp_path_factory.mktemp("study") / "trials"
    trials = [
        RecordedTrial("P01").record(root),
        RecordedTrial("SIM01", "without_autonomy", "simulated", sway_px=60.0).record(root),
        RecordedTrial("P02", simulated_rig=False).record(root),
    ]
    for folder in trials[:2]:
        write_trial_report(folder, shipped_vessel())
    film = VideoRecorder(trials[0] / VIDEO_NAME)
    for frame in range(30):
        picture = np.full((48, 64, 3), 8 * frame, np.uint8)
        film.add(GO_S + frame / 2, cv2.imencode(".jpg", picture)[1].tobytes())
    film.finish()
    return trials


@pytest.fixture(scope="module")
def study(trials: list[Path]) -> StudyFolder:
    """Whose trials they might be, with nothing done."""
    plan = new_plan(2, ("bifurcation",), 1, 0, training_s=5400.0)
    return StudyFolder.create(trials[0].parent.parent, plan)


@pytest.fixture(scope="module")
def url(trials: list[Path], study: StudyFolder) -> Iterator[str]:
    with pages_server(trials[0].parent, study) as url:
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
    expect(page.get_by_test_id(trials[1].name)).to_contain_text("✕ no result")
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


def test_a_trial_is_played_back_in_step_with_its_film(url: str, trials: list[Path], page: Page) -> None:
    page.goto(signed_in(url, f"/results?trial={trials[0].name}"))
    page.get_by_test_id("play-back").click()
    expect(page.get_by_test_id("playback")).to_have_attribute("data-state", "ready", timeout=PATIENCE_MS)
    expect(page.get_by_test_id("simulated")).to_be_visible()
    expect(page.get_by_test_id("about")).to_contain_text("the robot's motion is simulated")
    mode, clock, line = (page.get_by_test_id(name) for name in ("now-mode", "clock", "line"))
    expect(mode).to_have_text("AUTO")
    page.get_by_test_id("events").get_by_text("Target reached").click()
    expect(clock).to_contain_text("12.00 s of")
    expect(mode).to_have_text("MANUAL")
    picture = page.get_by_test_id("film-picture")
    expect(picture).to_have_attribute("src", f"/api/v1/trials/{trials[0].name}/film/24.jpg")
    assert page.get_by_test_id("map").evaluate(COLOURS)["auto"] > 100

    line.press("Home")
    expect(page.get_by_test_id("now-frame")).to_have_text("0")
    line.press("ArrowRight")
    expect(page.get_by_test_id("now-frame")).to_have_text("1")
    page.get_by_test_id("speed-0.25").click()
    line.press("Space")
    expect(page.get_by_test_id("play")).to_have_text("Pause")
    page.get_by_test_id("speed-8").click()
    expect(mode).to_have_text("MANUAL", timeout=PATIENCE_MS)
    expect(page.get_by_test_id("play")).to_have_text("Play", timeout=PATIENCE_MS)
    box = line.bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 40)
    assert abs(float(line.get_attribute("aria-valuenow") or "nan") - 6.0) < 1.0
    assert HANDOVER_S - GO_S > 7.0
    expect(mode).to_have_text("AUTO")
    assert stumbling_blocks(page) == []


def test_the_dashboard_leads_through_a_study(
    url: str, trials: list[Path], study: StudyFolder, page: Page
) -> None:
    page.goto(signed_in(url, "/"))
    go, say, steps = (page.get_by_test_id(f"study-{name}") for name in ("go", "say", "steps"))
    expect(page.get_by_test_id("study-code")).to_have_text("P01", timeout=PATIENCE_MS)
    expect(page.get_by_test_id("study-where")).to_contain_text("Block 1 of 2")
    expect(page.get_by_test_id("trial-start")).to_be_hidden()
    expect(go).to_be_enabled(timeout=PATIENCE_MS)
    go.press("Enter")
    expect(go).to_have_text("End training", timeout=PATIENCE_MS)
    expect(page.get_by_test_id("study-left")).to_have_text(re.compile(r"8\d:\d\d|90:00"))
    page.reload()
    expect(go).to_have_text("End training", timeout=PATIENCE_MS)
    expect(go).to_be_enabled(timeout=PATIENCE_MS)
    page.get_by_test_id("study-interrupt").press("Enter")
    expect(page.get_by_test_id("study-interrupt")).to_have_attribute("data-sure", "true")
    page.get_by_test_id("study-interrupt").press("Enter")
    expect(go).to_have_text("Begin training", timeout=PATIENCE_MS)
    expect(page.get_by_test_id("study-where")).to_contain_text("again")
    expect(steps.locator("[data-status=interrupted] + [data-status=now]")).to_have_count(1)

    go.click()
    expect(go).to_have_text("End training", timeout=PATIENCE_MS)
    go.click()
    expect(go).to_have_text("Begin trial", timeout=PATIENCE_MS)
    expect(say).to_contain_text("P01 does trial 1")
    expect(page.get_by_test_id("study-trouble")).to_contain_text("a trial needs a target")
    expect(go).to_be_disabled()
    page.get_by_test_id("study-all").locator("summary").press("Enter")
    expect(page.get_by_test_id("study-participants")).to_contain_text("1 of 6, 1 interrupted")
    assert stumbling_blocks(page) == []

    study.finish(study.plan.steps[1], trials[0].name)
    ask = page.get_by_test_id("study-ask")
    expect(ask).to_be_visible(timeout=PATIENCE_MS)
    with page.expect_popup() as opened:
        ask.press("Enter")
    expect(opened.value.get_by_test_id("participant")).to_have_text("P01", timeout=PATIENCE_MS)
    expect(opened.value.get_by_test_id("trial")).to_have_text(trials[0].name)
    expect(go).to_have_text("Next block", timeout=PATIENCE_MS)
    expect(go).to_be_disabled()
    choices = tuple(Choice(left, right, left) for left, right in shown_pairs(trials[0].name))
    keep_tlx(trials[0].parent, trials[0].name, TlxAnswers(dict.fromkeys(KEYS, 50), choices), 0.0)
    expect(ask).to_have_text("Answered ✓", timeout=PATIENCE_MS)
    expect(go).to_be_enabled(timeout=PATIENCE_MS)
    go.press("Enter")
    expect(page.get_by_test_id("study-where")).to_contain_text("Block 2 of 2", timeout=PATIENCE_MS)
    expect(go).to_have_text("Begin training")
