"""Take-over and hand-over: setpoint, jerk, and how soon the operator's hand counts.

Run from a checkout: ``python -m benchmarks.handover``. Prints one JSON object. Take-overs are measured in a
running server, from the packet that closes the clutch to the first command of the hand; hand-overs at arrival
in lock-step with a simulated operator. All simulated.
"""

import argparse
import functools
import json
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from benchmarks._handover_run import HandedOver, Style, handed_over
from mrnav_server.autonomy.path import PathPlanner
from mrnav_server.cli.operator_chart import MIDDLE
from mrnav_server.core.vessel import VesselMap
from mrnav_server.settings import Settings
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model
from tests.hand_client import HandClient
from tests.rig_process import RigProcess

STYLES: tuple[Style, ...] = ("blended", "stop", "paper", "abrupt")
MODELS = ("bifurcation", "serpentine", "network")
EPSILON_UM = 2500.0
"""The operator takes over where he begins to be careful (docs/operator.md)."""
_LEAST_S, _SPAN_S = 0.3, 0.9
"""A take-over comes this long after AUTO began, at a random moment of the span."""


def takeovers(count: int, seed: int) -> list[float]:
    """Return for each take-over how long after its packet the first command of the hand was sent, in ms."""
    random = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        rig = RigProcess(Path(folder))
        try:
            with HandClient(rig.ready["hand_port"], rig.ready["operator_token"]) as hand:
                trial = _begin(rig)
                closed_s = [_take_over(rig, hand, random) for _ in range(count)]
                rig.post(f"/api/v1/trials/{trial}/end", {})
            lines = rig.log(trial)
        finally:
            rig.end()
    by_hand = np.array(
        [line.data["sent_s"] for line in lines if line.topic == "command" and line.data["mode"] == "MANUAL"]
    )
    return [1000.0 * float(by_hand[np.searchsorted(by_hand, at_s)] - at_s) for at_s in closed_s]


def _begin(rig: RigProcess) -> str:
    trial = rig.begin_trial()
    for site in rig.snapshot["vessel"]["suggested_areas"][1:]:
        center = {"frame": "vessel", "x": site["x_px"], "y": site["y_px"]}
        rig.post("/api/v1/critical-areas", {"center": center, "epsilon_um": 500.0})
    return trial


def _take_over(rig: RigProcess, hand: HandClient, random: np.random.Generator) -> float:
    """Begin AUTO towards the farthest area, take over on the way; return when the packet was sent."""
    areas = rig.http.get("/api/v1/critical-areas").json()

    def distance(area: dict[str, Any]) -> float:
        x, y = rig.state["robot_vessel_px"]
        return float(np.hypot(area["center"]["x_px"] - x, area["center"]["y_px"] - y))

    rig.until(lambda s: s["track"]["state"] == "tracking", "the robot")
    farthest = max(areas, key=distance)
    rig.ask("auto", area=farthest["id"])
    rig.until(lambda s: s["mode"] == "AUTO", "AUTO")
    time.sleep(_LEAST_S + _SPAN_S * float(random.random()))
    velocity = random.uniform(-0.05, 0.05, 2)
    closed_s = hand.close_clutch((float(velocity[0]), 0.0, float(velocity[1])))
    rig.until(lambda s: s["mode"] == "MANUAL", "MANUAL", 2.0)
    time.sleep(0.2)
    hand.open_clutch()
    time.sleep(0.3)
    return closed_s


def arrivals(
    style: Style, count: int, seed: int, place_um: tuple[float, float], workers: int
) -> list[HandedOver]:
    """Return the hand-overs at arrival that came about, the vessel models in turn."""
    jobs = [(style, number % len(MODELS), 1000 * seed + number, place_um) for number in range(count)]
    with ProcessPoolExecutor(workers) as pool:
        done = track(
            pool.map(arrival, jobs),
            f"hand-overs, {style} (simulated)",
            total=count,
            console=Console(stderr=True),
        )
        return [run for run in done if run is not None]


def arrival(job: tuple[Style, int, int, tuple[float, float]]) -> HandedOver | None:
    """Return one hand-over; the job ends with the area's radius and the target's distance from its centre."""
    style, which, seed, place_um = job
    vessel, planner, middle = _rig(which)
    return handed_over(vessel, planner, middle, Settings(), style, seed, *place_um)


@functools.cache
def _rig(which: int) -> tuple[VesselMap, PathPlanner, PathPlanner]:
    vessel = load_vessel_model(find_model(MODELS[which]))
    return vessel, PathPlanner(vessel), PathPlanner(vessel, MIDDLE)


def summary(runs: dict[Style, list[HandedOver]]) -> dict[str, Any]:
    """Return the contract's figures, and the three styles side by side."""
    everything = [run for each in runs.values() for run in each]
    smooth = {style: _median([run.window.smoothness.value for run in each]) for style, each in runs.items()}
    return {
        "jump_um": max(run.jump_um for run in everything),
        "jerk_max": max(run.jerk_um_per_s3 for run in everything),
        "jerk_limit": Settings().limits.jerk_um_per_s3,
        "s_switch": smooth["blended"],
        "s_manual": _median([run.smoothness_hand for run in everything]),
        "s_auto": _median([run.smoothness_auto for run in everything]),
        "s_abrupt": smooth["abrupt"],
        "styles": {style: _style(each) for style, each in runs.items()},
    }


def _style(runs: list[HandedOver]) -> dict[str, float | int]:
    return {
        "n": len(runs),
        "s": _median([run.window.smoothness.value for run in runs]),
        "peak_jerk_um_per_s3": _median([run.window.peak_jerk_um_per_s3 for run in runs]),
        "standstill_s": _median([run.window.standstill_s for run in runs]),
        "take_over_s": _median([run.window.take_over_s for run in runs]),
        "contacts": sum(run.contacts for run in runs),
    }


def _median(values: list[float]) -> float:
    return round(float(np.nanmedian(values)), 3)


def main() -> None:
    """Measure both."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--epsilon-um", type=float, default=EPSILON_UM, help="radius of the critical area")
    parser.add_argument("--beyond-um", type=float, default=0.0, help="from its centre to the target")
    parser.add_argument("--workers", type=int, default=1, help="processes that hand over at arrival")
    options = parser.parse_args()
    taken_ms = takeovers(options.count, options.seed)
    print(f"{options.count} take-overs: p99 {np.percentile(taken_ms, 99):.1f} ms", file=sys.stderr)
    result: dict[str, Any] = {
        "simulated": True,
        "takeover_ms": {
            "p50": round(float(np.percentile(taken_ms, 50)), 2),
            "p99": round(float(np.percentile(taken_ms, 99)), 2),
        },
    }
    place_um = (options.epsilon_um, options.beyond_um)
    runs = {
        style: arrivals(style, options.count, options.seed, place_um, options.workers) for style in STYLES
    }
    print(json.dumps(result | summary(runs)))


if __name__ == "__main__":
    main()
