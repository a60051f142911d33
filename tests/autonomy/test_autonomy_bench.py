"""The benchmark of autonomy: the whole simulated rig, in simulated time."""

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_both_laws_are_measured_on_the_same_tasks(tmp_path: Path) -> None:
    options = ["--tasks", "2", "--seed", "1", "--model", "bifurcation", "--workers", "1"]
    laws = ["--law", "policy", "--law", "direct", "--outcomes", str(tmp_path / "outcomes.jsonl")]
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.autonomy", *options, *laws],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=150,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert figures["simulated"] is True
    path, direct = figures["policy"]["bifurcation"], figures["direct"]["bifurcation"]
    assert (path["tasks"], path["arrived"], path["contacts"], path["lost"]) == (2, 2, 0, 0)
    assert path["speed_um_per_s"] > 1800.0
    assert path["cross_track_um"]["rms"] < 50.0 < direct["cross_track_um"]["rms"]
    outcomes = [json.loads(line) for line in (tmp_path / "outcomes.jsonl").read_text().splitlines()]
    tasks = {
        law: [outcome["task"] for outcome in outcomes if outcome["law"] == law]
        for law in ("policy", "direct")
    }
    assert tasks["policy"] == tasks["direct"]
    assert [task["friction"] for task in tasks["policy"]] == [0.1, 0.2]
    assert all(outcome["source"] == "policy" for outcome in outcomes)
