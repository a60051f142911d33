"""Makes docs/screenshot.png and docs/figures/dashboard-*.png: the simulated rig at four sizes.

Run from a checkout with the test requirements: ``python -m docs.make_screenshot``.
"""

import tempfile
from pathlib import Path

from playwright.sync_api import expect, sync_playwright

from tests.e2e.conftest import CALM, came
from tests.e2e.test_e2e_dashboard import CHROMIUM, FLAGS, PATIENCE_MS
from tests.rig_process import RigProcess

FOLDER = Path(__file__).parent
TRIES = 4
SIZES = ((1280, 720), (820, 1180), (1920, 1080))


def main() -> None:
    """Drive the page as an operator would, and take the picture on the way."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        rig = RigProcess(Path(folder), **CALM)
        try:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
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
            for _ in range(TRIES):
                page.get_by_test_id("auto").click()
                if came(rig, lambda s: s["mode"] == "AUTO" and s["distance_um"] < 4500):
                    break
            page.screenshot(path=FOLDER / "screenshot.png")
            for width, height in SIZES:
                page.set_viewport_size({"width": width, "height": height})
                page.wait_for_timeout(500)
                page.screenshot(path=FOLDER / "figures" / f"dashboard-{width}x{height}.png")
            browser.close()
        finally:
            rig.end()


if __name__ == "__main__":
    main()
