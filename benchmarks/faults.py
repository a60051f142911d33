"""How fast running processes react to faults: of the operator, the controller, and the camera.

Run from a checkout: ``python -m benchmarks.faults``. Prints one JSON object; times come from the
server's and the emulator's own monotonic stamps. All simulated.
"""

import argparse
import json
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Frame
from mrnav_server.loops.trial_log import LogLine
from mrnav_server.vision.frame_watch import FrameWatch
from tests.camera_rig import CameraRig
from tests.camera_server import FAULTS
from tests.emulated_rig import EmulatedRig
from tests.rig_process import RigProcess


def hold_after(how: signal.Signals, mode: str, folder: Path) -> dict[str, float]:
    """Return how long after the operator's last line the rig held, and what it sent meanwhile."""
    rig = RigProcess(folder)
    try:
        rig.start_operator()
        trial = rig.begin_trial()
        if mode == "AUTO":
            rig.ask("auto")
            rig.until(lambda s: s["mode"] == "AUTO", "AUTO")
        time.sleep(0.6)
        assert rig.operator is not None
        rig.operator.send_signal(how)
        rig.until(lambda s: s["mode"] == "HOLD", "HOLD", 5.0)
        time.sleep(0.5)
        rig.post(f"/api/v1/trials/{trial}/end", {})
        lines = rig.log(trial)
    finally:
        rig.end()
    hold = next(line for line in lines if line.topic == "mode" and line.data["mode"] == "HOLD")
    heard_s = max(line.data["received_s"] for line in lines if line.topic == "hand" and line.t_s < hold.t_s)
    ahead_ms = [line.data["ahead_ms"] for line in lines if line.topic == "command"]
    return {"hold_ms": 1000 * (hold.t_s - heard_s), "ahead_ms": max(ahead_ms, default=0.0)}


CONTROLLER: dict[str, dict[str, object]] = {
    "mute": {"mute": True},
    "stall_xy": {"stall": "xy"},
    "stall_one_axis": {"stall": "y"},
    "reading_frozen": {"freeze_reading": True},
    "offset_80_um": {"offset_um": [0.0, 80.0, 0.0]},
    "calibration_lost": {"calibration_lost": True},
    "acks_dropped": {"drop_acks": 1_000_000},
    "latency_400_ms": {"latency_ms": 400.0},
    "reboot": {"reboot": True},
}
"""Faults of the emulated controller by name."""
PATIENT = {"MRNAV_SUPERVISOR__HANG_S": "0.2"}
"""What is measured here is the rig's reaction, and not the supervisor's on a busy machine."""


CAMERA_REPEATS = 20
WELL_S = 120.0
"""How long a camera without a fault is watched for false alarms."""


def fault_after(knobs: dict[str, object], repeats: int) -> list[float]:
    """Return how long after a fault of the controller in motion the rig was in FAULT, in ms."""
    took_ms = []
    with tempfile.TemporaryDirectory() as folder, EmulatedRig(Path(folder), PATIENT) as emulated:
        emulated.prepare()
        for _ in range(repeats):
            emulated.go()
            emulated.rig.events.clear()
            began_s = emulated.emulator.turn(**knobs)["t"]
            emulated.rig.until(lambda s: s["mode"] == "FAULT", "FAULT", 5.0)
            time.sleep(0.1)
            events = [e for e in emulated.rig.events if e["event"] == "mode" and e["mode"] == "FAULT"]
            took_ms.append(1000 * (events[0]["t"] - began_s))
            emulated.recover()
    return took_ms


def camera_fault_after(fault: str, repeats: int) -> list[float]:
    """Return how long after the first spoilt picture the rig left AUTO for HOLD, by its log, in ms.

    A picture is spoilt at the moment when it was taken, or should have been.
    """
    spoilt_s = []
    with tempfile.TemporaryDirectory() as folder, CameraRig(Path(folder)) as filmed:
        trial = filmed.prepare()
        for _ in range(repeats):
            filmed.go()
            spoilt_s.append(filmed.spoil(fault))
            filmed.rig.until(lambda s: s["mode"] == "HOLD", "HOLD", 5.0)
            time.sleep(0.3)
            filmed.spoil("recover")
        filmed.rig.post(f"/api/v1/trials/{trial}/end", {})
        lines = filmed.rig.log(trial)
    held = [
        line
        for line in lines
        if line.topic == "mode" and (line.data["before"], line.data["mode"]) == ("AUTO", "HOLD")
    ]
    first = [next(line for line in held if line.t_s >= at_s) for at_s in spoilt_s]
    # On a busy machine the hand that supervises may be late at that moment, which holds AUTO too.
    return [
        1000 * (line.t_s - at_s)
        for line, at_s in zip(first, spoilt_s, strict=True)
        if "supervises" not in line.data["reason"]
    ]


def false_alarms(span_s: float) -> dict[str, int]:
    """Run a camera without a fault; return its frames, those that were lost, and how often it was suspected.

    What the server said of its camera is in its log; whether a frame was overdue is asked anew.
    """
    with tempfile.TemporaryDirectory() as folder:
        rig = RigProcess(Path(folder))
        try:
            trial = rig.begin_trial()
            time.sleep(span_s)
            rig.post(f"/api/v1/trials/{trial}/end", {})
            lines = rig.log(trial)
        finally:
            rig.end()
    said = [line.data for line in lines if line.topic == "event" and line.data["event"] == "fault"]
    tracks = [line for line in lines if line.topic == "track"]
    return {
        "frames": len(tracks),
        "named": sum("works again" not in event["reason"] for event in said),
        **_overdue(tracks, PictureFormat().fps),
    }


def _overdue(tracks: list[LogLine], fps: float) -> dict[str, int]:
    """Return how many frames were lost, and how often one was called overdue."""
    random = np.random.default_rng(0)
    images = [random.integers(50, 200, (240, 320, 3), np.uint8) for _ in range(2)]
    watch = FrameWatch(fps)
    overdue = number = 0
    before_s = tracks[0].data["taken_s"]
    for line in tracks:
        taken_s = line.data["taken_s"]
        number += max(round((taken_s - before_s) * fps), 1)
        before_s = taken_s
        overdue += bool(watch.overdue(line.t_s))
        watch.look(Frame(number, taken_s, images[number % 2]), line.t_s)
    return {"lost": watch.missing, "overdue": overdue}


def main() -> None:
    """Measure every fault a few times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    result: dict[str, object] = {"simulated": True}
    for how in (signal.SIGKILL, signal.SIGSTOP):
        for mode in ("MANUAL", "AUTO"):
            runs = []
            for _ in range(repeats):
                with tempfile.TemporaryDirectory() as folder:
                    runs.append(hold_after(how, mode, Path(folder)))
                print(f"{how.name} in {mode}: HOLD after {runs[-1]['hold_ms']:.1f} ms", file=sys.stderr)
            held = [run["hold_ms"] for run in runs]
            result[f"{how.name.lower()}_{mode.lower()}"] = {
                "hold_ms_median": round(float(np.median(held)), 1),
                "hold_ms_max": round(max(held), 1),
                "ahead_ms_max": max(run["ahead_ms"] for run in runs),
            }
    for name, knobs in CONTROLLER.items():
        took_ms = fault_after(knobs, repeats)
        print(f"emulated controller, {name}: FAULT after {max(took_ms):.1f} ms at most", file=sys.stderr)
        result[name] = {
            "fault_ms_median": round(float(np.median(took_ms)), 1),
            "fault_ms_max": round(max(took_ms), 1),
        }
    for fault in FAULTS:
        took_ms = camera_fault_after(fault, max(repeats, CAMERA_REPEATS))
        if not took_ms:
            raise RuntimeError("the hand that supervises was late every time: the machine is too busy")
        print(f"simulated camera, {fault}: HOLD after {max(took_ms):.1f} ms at most", file=sys.stderr)
        result[f"camera_{fault}"] = {
            "n": len(took_ms),
            "hold_ms_median": round(float(np.median(took_ms)), 1),
            "hold_ms_max": round(max(took_ms), 1),
        }
    result["camera_without_fault"] = well = false_alarms(WELL_S)
    print(f"simulated camera, without a fault: {well}", file=sys.stderr)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
