"""The demonstration as anybody runs it: three processes, real sockets, the simulated rig."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from tests.devices.sensapex_rig import NEEDS_SDK
from tests.emulated_rig import PATIENT


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "manipulator", ["simulated", "sensapex-udp", pytest.param("sensapex-sdk", marks=NEEDS_SDK)]
)
def test_the_demo_completes_a_trial_and_leaves_nothing_running(tmp_path: Path, manipulator: str) -> None:
    before = {child.pid for child in psutil.Process().children(recursive=True)}
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "mrnav_server.cli.main",
            "demo",
            "--seed",
            "1",
            "--manipulator",
            manipulator,
            "--json",
            "--trials",
            str(tmp_path),
        ],
        env=os.environ | PATIENT,
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    result = json.loads(done.stdout.strip().splitlines()[-1])
    assert result["completed"], said
    assert result["simulated"] is True
    assert result["handover_by"] == "arrival"
    modes = result["mode_history"]
    assert modes[modes.index("AUTO") :][:2] == ["AUTO", "MANUAL"], said
    assert result["final_distance_um"] <= 150.0
    assert result["collisions_in_auto"] == 0
    assert not result["robot_lost"]
    for name in ("toc_s", "va_um_per_s", "g", "s", "spl"):
        assert math.isfinite(result[name]), name
    for name in ("hand_to_command", "frame_to_twin", "tick"):
        assert 0.0 < result["latency_ms"][name]["p50"] <= result["latency_ms"][name]["p99"]
    folder = Path(result["trial_dir"])
    assert folder.parent == tmp_path
    assert {"log.jsonl", "result.json", "trajectory.png"} <= {path.name for path in folder.iterdir()}
    assert {child.pid for child in psutil.Process().children(recursive=True)} <= before
