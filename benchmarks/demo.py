"""The demonstration for several seeds, with a dashboard open: completion, latencies, and the server's CPU.

Run from a checkout: ``python -m benchmarks.demo``. Prints one JSON object. All simulated.
"""

import argparse
import json
import subprocess
import sys
import time

import psutil
from playwright.sync_api import sync_playwright

from tests.e2e.test_e2e_dashboard import CHROMIUM, FLAGS

MRNAV = (sys.executable, "-m", "mrnav_server.cli.main")


def run(seed: int, manipulator: str, *, browser: bool) -> dict[str, object]:
    """Run one demonstration; return its result with wall time and the server's mean CPU in cores."""
    began_s = time.monotonic()
    process = subprocess.Popen(
        [*MRNAV, "demo", "--seed", str(seed), "--manipulator", manipulator, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    cores = _watch(process, browser=browser)
    out = process.stdout.read() if process.stdout else ""
    process.wait()
    result: dict[str, object] = json.loads(out.strip().splitlines()[-1])
    return result | {"wall_s": round(time.monotonic() - began_s, 1), "server_cores": cores}


def _watch(process: "subprocess.Popen[str]", *, browser: bool) -> float | None:
    """Open the page once the server is up, and measure the server's CPU until the demonstration ends."""
    url = None
    for line in process.stderr or ():
        if "http://" in line:
            url = line[line.index("http://") :].strip()
            break
    server = next((c for c in psutil.Process(process.pid).children() if "serve" in c.cmdline()), None)
    if url is None or server is None:
        return None
    with sync_playwright() as playwright:
        if browser:
            opened = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
            opened.new_page(viewport={"width": 1440, "height": 900}).goto(url)
        before, began_s = server.cpu_times(), time.monotonic()
        used_s, elapsed_s = 0.0, 1.0
        while process.poll() is None:
            try:
                now = server.cpu_times()
                used_s = now.user + now.system - before.user - before.system
                elapsed_s = time.monotonic() - began_s
            except psutil.Error:
                break
            time.sleep(0.2)
        if browser:
            opened.close()
    return round(used_s / elapsed_s, 2)


def main() -> None:
    """Run the seeds one after the other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--manipulator", default="simulated", help="or sensapex-udp, sensapex-sdk: emulated")
    parser.add_argument("--no-browser", action="store_true")
    options = parser.parse_args()
    runs = []
    for seed in range(1, options.seeds + 1):
        result = run(seed, options.manipulator, browser=not options.no_browser)
        runs.append(result)
        shown = (
            "completed",
            "final_distance_um",
            "handover_by",
            "collisions_in_auto",
            "wall_s",
            "server_cores",
        )
        print(f"seed {seed}:", {name: result[name] for name in shown}, result["latency_ms"], file=sys.stderr)
    print(
        json.dumps(
            {
                "simulated": True,
                "manipulator": options.manipulator,
                "completed": sum(bool(r["completed"]) for r in runs),
                "runs": runs,
            }
        )
    )


if __name__ == "__main__":
    main()
