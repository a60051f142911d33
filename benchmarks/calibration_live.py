"""The guided calibration of a running server, from the sheet to its use, as the page leads through it.

Run from a checkout: ``python -m benchmarks.calibration_live``. A server process on the simulated rig with
distortion, tilt and water is asked over REST; the tip moves through its control loop in real time. Prints one
JSON object. All simulated.
"""

import json
import math
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from mrnav_server.app.calibration_run import distorted
from mrnav_server.core.frames import VesselPoint
from mrnav_server.settings import Settings
from mrnav_server.sim.world import SimulatedWorld
from mrnav_server.vision.calibration_file import load_calibration
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model
from tests.rig_process import RigProcess

STAGE_S = 900.0
POLL_S = 0.5
OPTICS = {"radial": -0.01, "tilt_deg": 2.0, "water_depth_um": 3000.0}
PLAN = {
    "descent_speed_um_per_s": 1000.0,
    "speed_um_per_s": 4500.0,
    "raster_z_um": "[14000, 11500]",
    "travel_z_um": 14_500.0,
    "descent_step_um": 100.0,
}
"""Four minutes instead of the default plan's twelve; as many places as a calibration needs."""
AUTO_S = 60.0
MOST_REFUSALS = 2


def calibrate(rig: RigProcess) -> tuple[dict[str, Any], dict[str, float]]:
    """Be the person who does as asked; return the final state, and how long each stage took."""

    def state() -> dict[str, Any]:
        answer: dict[str, Any] = rig.http.get("/api/v1/calibration", timeout=60.0).json()
        return answer

    took_s: dict[str, float] = {}
    refusals: list[str] = []
    rig.post("/api/v1/calibration/begin", {"water_depth_um": OPTICS["water_depth_um"]})
    while (now := state())["phase"] != "done":
        if now["refusal"]:
            # A person would try the stage again; what was refused is told.
            refusals.append(f"{now['stage']}: {now['refusal']}")
            print(refusals[-1], file=sys.stderr)
            if len(refusals) > MOST_REFUSALS:
                raise AssertionError("; ".join(refusals))
        began_s = time.monotonic()
        rig.post("/api/v1/calibration/next", {})
        while state()["phase"] == "moving":
            if time.monotonic() - began_s > STAGE_S:
                raise AssertionError(f"{now['stage']}: not within {STAGE_S} s")
            time.sleep(POLL_S)
        took_s[now["stage"]] = round(took_s.get(now["stage"], 0.0) + time.monotonic() - began_s, 1)
        print(f"{now['stage']}: {took_s[now['stage']]} s", file=sys.stderr)
    rig.post("/api/v1/calibration/use", {})
    return state() | {"refusals": refusals}, took_s


def against_the_truth(file: Path) -> dict[str, float]:
    """Compare what the server wrote with the simulator's truth."""
    settings = distorted(Settings())
    vessel = load_vessel_model(find_model(settings.rig.vessel))
    world = SimulatedWorld(settings.sim, vessel, settings.camera)
    found, truth = load_calibration(file, settings.camera, vessel, simulated=True), world.true_calibration
    view = world.optics or truth
    line = [vessel.size_px * share / 8.0 for share in range(9)]
    points = [VesselPoint(x, y) for x in line for y in line]
    miss_um = [found.vessel_point(view.image_point(p)).distance_px(p) * vessel.um_per_px for p in points]
    return {
        "floor_rms_um": round(math.sqrt(sum(m * m for m in miss_um) / len(miss_um)), 2),
        "floor_max_um": round(max(miss_um), 2),
        "offset_um": round(math.dist(found.magnet_offset_um, truth.magnet_offset_um), 1),
        "critical_height_share": round(abs(found.critical_height_um / truth.critical_height_um - 1.0), 4),
    }


def drive(rig: RigProcess) -> dict[str, Any]:
    """Let autonomy steer the robot by the new calibration; return how it ended."""
    rig.until(lambda s: s["track"]["state"] == "tracking", "finding the robot again")
    robot, site = rig.state["robot_vessel_px"], rig.snapshot["vessel"]["suggested_areas"][0]
    center = {"frame": "vessel", "x": site["x_px"], "y": site["y_px"]}
    area = rig.post("/api/v1/critical-areas", {"center": center, "epsilon_um": 300.0})
    away_um = 10.0 * math.dist(robot, (site["x_px"], site["y_px"]))
    rig.ask("arm")
    rig.until(lambda s: s["mode"] == "HOLD", "arming")
    rig.ask("auto", area=area["id"])
    rig.until(lambda s: s["mode"] == "AUTO", "AUTO")
    began_s = time.monotonic()
    rig.until(lambda s: s["mode"] != "AUTO", "arriving", AUTO_S)
    now = rig.state
    return {
        "from_um": round(away_um),
        "left_um": now["distance_um"] and round(now["distance_um"]),
        "took_s": round(time.monotonic() - began_s, 1),
        "reason": now["reason"],
        "collisions": now["collisions"],
    }


def main() -> None:
    """Run it and print the figures."""
    environment = {f"MRNAV_SIM__OPTICS__{name.upper()}": str(value) for name, value in OPTICS.items()}
    environment |= {f"MRNAV_CALIBRATION__{name.upper()}": str(value) for name, value in PLAN.items()}
    with tempfile.TemporaryDirectory() as folder:
        rig = RigProcess(Path(folder), MRNAV_RECORDING__ROOT=folder, **environment)
        try:
            rig.post("/api/v1/lease", {"client": "calibration"})
            done, took_s = calibrate(rig)
            figures = {
                stage["stage"]: {figure["name"]: figure["value_um"] for figure in stage["figures"]}
                for stage in done["stages"]
            }
            result = {
                "simulated": True,
                "took_s": took_s,
                "refusals": done["refusals"],
                "figures": figures,
                "true_errors": against_the_truth(Path(done["file"])),
                "afterwards": drive(rig),
            }
        finally:
            rig.end()
    print(json.dumps(result))


if __name__ == "__main__":
    main()
