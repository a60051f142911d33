"""The follower on the simulated rig, with lag, delay and noise, by way of its benchmark."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]


def benchmark(*options: str) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "follower.py"), *options],
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=110,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    figures: dict[str, Any] = json.loads(done.stdout)
    return figures


@pytest.mark.parametrize(
    ("options", "cross_track_rms_um"),
    [
        (["--tasks", "8", "--policy"], 30.0),
        (["--tasks", "8", "--seed", "2", "--friction", "0.1"], 40.0),
        (["--tasks", "8", "--seed", "3", "--friction", "0.3"], 30.0),
        (["--tasks", "8", "--seed", "4", "--carry"], 15.0),
    ],
    ids=["policy", "slippery", "rough", "learnt"],
)
def test_every_robot_reaches_its_target_and_touches_nothing(
    options: list[str], cross_track_rms_um: float
) -> None:
    figures = benchmark(*options)
    assert figures["reached"] == 1.0
    assert figures["contacts"] == 0
    assert figures["lifted"] == 0
    assert figures["final_distance_um"]["max"] < 120.0
    assert figures["cross_track_um"]["rms"] < cross_track_rms_um
    assert figures["speed_along_path_um_per_s"] > 1500.0
