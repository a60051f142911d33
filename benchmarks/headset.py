"""The headset page in an emulated headset: hand messages a second, and how soon a lost hand is held.

Headless Chromium, iwer and a server on the simulated rig, all on this machine; the page does not draw.
"""

import json
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

from playwright.sync_api import sync_playwright

from tests.e2e.headset import BY_SOFTWARE, Headset
from tests.rig_process import RigProcess

_FLAGS = ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", *BY_SOFTWARE]
_DRIVE_MS = 10_000
_LOSSES = 5


def main() -> None:
    """Print the figures as one line of JSON."""
    os.environ["no_proxy"] = "127.0.0.1"
    chromium = next((path for name in ("chromium", "google-chrome") if (path := shutil.which(name))), None)
    if chromium is None:
        sys.exit("this needs Chromium")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        rig = RigProcess(Path(folder))
        try:
            browser = playwright.chromium.launch(executable_path=chromium, args=_FLAGS)
            headset = Headset(browser, rig)
            headset.enter()
            rig.until(lambda s: s["lease"]["hand"] and s["track"]["state"] == "tracking", "the hand's seat")
            headset.press("Arm")
            rig.until(lambda s: s["mode"] in ("MANUAL", "HOLD"), "arming")
            driven = _drive(headset, rig)
            losses_ms = [_lose(headset, rig) for _ in range(_LOSSES)]
            browser.close()
        finally:
            rig.end()
    print(json.dumps({**driven, "hold_after_loss_ms": {"worst": max(losses_ms), "losses": _LOSSES}}))


def _drive(headset: Headset, rig: RigProcess) -> dict[str, object]:
    """Pinch and move for ten seconds; return rates and how far the tip went."""
    headset.do("pinch", True)
    rig.until(lambda s: s["mode"] == "MANUAL" and s["clutch"], "the clutch")
    first, start_um = len(headset.sent), rig.state["tip_um"][0]
    headset.do("move", [0.05, 0.0, 0.0], _DRIVE_MS)
    gaps_ms = sorted(
        1e3 * (after["t"] - before["t"])
        for before, after in zip(headset.sent[first:], headset.sent[first + 1 :], strict=False)
    )
    poses = len({message["pose"] for message in headset.sent[first:]})
    return {
        "messages_hz": round(headset.rate_hz(first), 2),
        "poses_hz": round(headset.rate_hz(first) * poses / (len(headset.sent) - first), 2),
        "server_hz": rig.state["rates_hz"]["hand"],
        "gap_ms": {
            "p50": round(gaps_ms[len(gaps_ms) // 2], 2),
            "p99": round(gaps_ms[int(0.99 * len(gaps_ms))], 2),
        },
        "tip_moved_um": round(rig.state["tip_um"][0] - start_um),
    }


def _lose(headset: Headset, rig: RigProcess) -> float:
    """Lose a pinched hand; return when the rig held, in ms, and check that nothing was sent after."""
    headset.do("pinch", False)
    headset.wait(300)
    headset.do("pinch", True)
    rig.until(lambda s: s["mode"] == "MANUAL" and s["clutch"], "the clutch")
    began_s = time.monotonic()
    headset.see_hand(False)
    rig.until(lambda s: s["mode"] == "HOLD" and not s["clutch"], "HOLD")
    held_ms = round(1e3 * (time.monotonic() - began_s), 1)
    headset.wait(100)
    silent = len(headset.sent)
    headset.wait(500)
    if len(headset.sent) != silent:
        sys.exit("a hand that was not seen sent messages")
    headset.see_hand(True)
    return held_ms


if __name__ == "__main__":
    main()
