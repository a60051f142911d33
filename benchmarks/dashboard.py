"""The dashboard in headless Chromium: pictures drawn a second, page weight, and hosts that it asks.

Run from a checkout: ``python -m benchmarks.dashboard``. Prints one JSON object. The server is a whole one on
the simulated rig, on the same machine. Frames are those of the browser's own animation clock, with the live
picture, the charts and, unless left out, the twin; without a graphics card the processor draws that. The
weight is that of all files of the page, each compressed by gzip.
"""

import argparse
import gzip
import json
import os
import tempfile
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from playwright.sync_api import Response, sync_playwright

from tests.e2e.test_e2e_dashboard import CHROMIUM, FLAGS
from tests.rig_process import RigProcess

_SETTLE_MS = 3000
_COUNT = """(seconds) => new Promise((done) => {
  let frames = 0;
  const began_ms = performance.now();
  const step = (now_ms) => {
    frames += 1;
    if (now_ms - began_ms < 1000 * seconds) requestAnimationFrame(step);
    else done((1000 * (frames - 1)) / (now_ms - began_ms));
  };
  requestAnimationFrame(step);
})"""


def dashboard(seconds: float, *, webgl: bool) -> dict[str, Any]:
    """Return frames a second, weight in bytes, and requests to other hosts.

    Args:
        seconds: For how long frames are counted.
        webgl: Whether the browser may draw the twin.
    """
    os.environ["no_proxy"] = "127.0.0.1"
    flags = [flag for flag in FLAGS if not (webgl and flag in ("--disable-3d-apis", "--disable-gpu"))]
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        rig = RigProcess(Path(folder))
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        try:
            page = browser.new_page(viewport={"width": 1440, "height": 900})
            answers: list[Response] = []
            asked: list[str] = []
            page.on("response", lambda answer: answers.append(answer))
            page.on("request", lambda request: asked.append(request.url))
            page.goto(rig.ready["url"])
            page.wait_for_selector("html[data-video=live]", timeout=60_000)
            page.wait_for_timeout(_SETTLE_MS)
            fps = float(page.evaluate(_COUNT, seconds))
            bodies = {answer.url: answer.body() for answer in answers if answer.status == 200}
        finally:
            browser.close()
            rig.end()
    files = {url: body for url, body in bodies.items() if not urlsplit(url).path.startswith("/api/")}
    here = urlsplit(rig.url).netloc
    away = [
        url for url in asked if urlsplit(url).scheme not in ("data", "blob") and urlsplit(url).netloc != here
    ]
    return {
        "simulated": True,
        "webgl": webgl,
        "fps": round(fps, 1),
        "files": len(files),
        "bytes": sum(len(body) for body in files.values()),
        "gzip_bytes": sum(len(gzip.compress(body, 9)) for body in files.values()),
        "other_hosts": len(away),
    }


def main() -> None:
    """Measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--no-webgl", action="store_true", help="leave the twin out")
    options = parser.parse_args()
    print(json.dumps(dashboard(options.seconds, webgl=not options.no_webgl)))


if __name__ == "__main__":
    main()
