"""Makes docs/screenshot.png and the pictures of the pages in docs/figures, all on the simulated rig.

Run from a checkout with the test requirements: ``python -m docs.make_screenshot``.
"""

import tempfile
from pathlib import Path

from playwright.sync_api import Browser, Page, expect, sync_playwright

from mrnav_server.study.plan import new_plan
from mrnav_server.study.study_folder import StudyFolder
from tests.e2e.conftest import CALM, came
from tests.e2e.headset import BY_SOFTWARE
from tests.e2e.test_e2e_dashboard import CHROMIUM, FLAGS, PATIENCE_MS
from tests.e2e.test_e2e_twin_view import NO_3D
from tests.rig_process import RigProcess

FOLDER = Path(__file__).parent
TRIES = 4
SIZES = ((1280, 720), (820, 1180), (1920, 1080))
LARGE, UPRIGHT = (1600, 1000), (820, 1180)
STEPS_DONE = 25
"""Of the study that is pictured: a trial with autonomy is next."""


def main() -> None:
    """Drive the pages as an operator would, and take the pictures on the way."""
    flags = [flag for flag in FLAGS if flag != NO_3D] + BY_SOFTWARE
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        dashboard(browser)
        study_and_playback(browser)
        browser.close()


def dashboard(browser: Browser) -> None:
    """A trial with the policy at work."""
    with tempfile.TemporaryDirectory() as folder:
        rig = RigProcess(Path(folder), **CALM)
        try:
            page = browser.new_page(viewport={"width": 1440, "height": 900})
            page.goto(rig.ready["url"])
            page.get_by_test_id("take").click()
            for number in (1, 2, 3):
                page.get_by_test_id("suggest").click()
                expect(page.get_by_label(f"Choose area-{number}")).to_be_visible(timeout=PATIENCE_MS)
            page.get_by_label("Choose area-2").check()
            page.get_by_test_id("tool-steer").click()
            page.wait_for_timeout(20_000)
            page.get_by_test_id("operator-simulated").check(force=True)
            page.get_by_test_id("trial-start").click()
            page.get_by_test_id("arm").click()
            under_way(page, rig, 4500.0)
            page.screenshot(path=FOLDER / "screenshot.png")
            take(page, "dashboard", SIZES)
            page.close()
        finally:
            rig.end()


def study_and_playback(browser: Browser) -> None:
    """A trial of a study in its middle, and then its playback with its film."""
    with tempfile.TemporaryDirectory() as name:
        plan = new_plan(12, ("bifurcation", "network", "serpentine"), 2, 3, training_s=300.0)
        study = StudyFolder.create(Path(name) / "study", plan)
        for step in plan.steps[:STEPS_DONE]:
            study.finish(step)
        arguments = ("--study", str(study.folder))
        rig = RigProcess(Path(name), arguments=arguments, MRNAV_VIDEO__ENABLED="true", **CALM)
        try:
            page = browser.new_page(viewport={"width": LARGE[0], "height": LARGE[1]})
            page.goto(rig.ready["url"])
            page.get_by_test_id("take").click()
            page.get_by_test_id("suggest").click()
            page.get_by_test_id("tool-steer").click()
            page.wait_for_timeout(10_000)
            for word in ("Give up", ""):
                page.get_by_test_id("study-go").click()
                expect(page.get_by_test_id("study-go")).to_have_text("End trial", timeout=PATIENCE_MS)
                if word:
                    page.get_by_test_id("study-interrupt").dblclick()
                    expect(page.get_by_test_id("study-go")).to_have_text("Begin trial", timeout=60_000)
            page.get_by_test_id("arm").click()
            under_way(page, rig, 3000.0)
            take(page, "study", (LARGE, UPRIGHT))
            came(rig, lambda s: s["mode"] != "AUTO", 15.0)
            page.wait_for_timeout(1500)
            page.get_by_test_id("disarm").click()
            trial = rig.state["trial"]
            page.get_by_test_id("study-go").click()
            expect(page.get_by_test_id("study-where")).to_contain_text("trial 2", timeout=60_000)
            page.goto(f"{rig.url}/playback?trial={trial}")
            expect(page.get_by_test_id("playback")).to_have_attribute(
                "data-state", "ready", timeout=PATIENCE_MS
            )
            page.get_by_test_id("line").click()
            page.wait_for_timeout(1000)
            take(page, "playback", (LARGE, UPRIGHT))
            page.close()
        finally:
            rig.end()


def under_way(page: Page, rig: RigProcess, nearer_um: float) -> None:
    """Ask for AUTO until it has come so near."""
    for _ in range(TRIES):
        page.get_by_test_id("auto").click()
        if came(rig, lambda s: s["mode"] == "AUTO" and s["distance_um"] < nearer_um):
            return


def take(page: Page, name: str, sizes: tuple[tuple[int, int], ...]) -> None:
    """Take the page's picture at each size."""
    for width, height in sizes:
        page.set_viewport_size({"width": width, "height": height})
        page.wait_for_timeout(500)
        page.screenshot(path=FOLDER / "figures" / f"{name}-{width}x{height}.png")


if __name__ == "__main__":
    main()
