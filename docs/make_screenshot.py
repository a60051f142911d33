"""Makes docs/screenshot.png: the dashboard on the simulated rig while the policy drives.

Run from a checkout with the test requirements: ``python -m docs.make_screenshot``.
"""

import tempfile
from pathlib import Path

from playwright.sync_api import expect, sync_playwright

from tests.e2e.test_e2e_dashboard import CHROMIUM, FLAGS, PATIENCE_MS
from tests.rig_process import RigProcess

TARGET = Path(__file__).parent / "screenshot.png"


def main() -> None:
    """Drive the page as an operator would, and take the picture on the way."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        rig = RigProcess(Path(folder))
        try:
            rig.start_operator()
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
            page = browser.new_page(viewport={"width": 1440, "height": 900})
            page.goto(rig.ready["url"])
            page.get_by_test_id("take").click()
            for number in (1, 2, 3):
                page.get_by_test_id("suggest").click()
                expect(page.get_by_label(f"Choose area-{number}")).to_be_visible(timeout=PATIENCE_MS)
            page.get_by_label("Choose area-2").check()
            page.wait_for_timeout(20_000)
            page.get_by_test_id("operator-simulated").check(force=True)
            page.get_by_test_id("trial-start").click()
            page.get_by_test_id("arm").click()
            expect(page.get_by_test_id("auto")).to_be_enabled(timeout=PATIENCE_MS)
            page.get_by_test_id("auto").click()
            rig.until(lambda s: s["mode"] == "AUTO" and s["distance_um"] < 4500, "half of the way")
            page.screenshot(path=TARGET)
            browser.close()
        finally:
            rig.end()


if __name__ == "__main__":
    main()
