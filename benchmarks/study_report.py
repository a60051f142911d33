"""How long a study's report takes, and how much memory: ``mrnav bench study_report --json``.

Run from a checkout. Twelve made-up operators, three vessel models, two repetitions, two conditions, in logs
as long as real ones; or the study that ``--folder`` names. The command runs as a process of its own, so that
its time and memory hold all that it imports. Prints one JSON object.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from mrnav_server.vision.model_store import find_model, model_names
from mrnav_server.vision.vessel_model import load_vessel_model
from tests.study.fabricated_study import Fabricator, Way

STEPS_PER_FRAME = 12


def made_up(folder: Path, operators: int, repetitions: int) -> None:
    """Write a study whose ways lead from the first suggested area to the last."""
    ways = []
    for name in model_names():
        vessel = load_vessel_model(find_model(name))
        ways.append(Way(vessel, vessel.suggested_areas[0], vessel.suggested_areas[-1]))
    Fabricator(folder / "trials", steps_per_frame=STEPS_PER_FRAME).study(ways, operators, repetitions)


def measured(folder: Path, out: Path) -> dict[str, Any]:
    """Write a study's report in a process; return what it took."""
    command = [sys.executable, "-m", "mrnav_server.cli.main", "study", "report", str(folder)]
    began_s = time.perf_counter()
    done = subprocess.run(
        [*command, "--out", str(out), "--json"], stdout=subprocess.PIPE, text=True, check=True
    )
    took_s = time.perf_counter() - began_s
    found = json.loads(done.stdout.splitlines()[-1])
    logs = sum(log.stat().st_size for log in folder.rglob("log.jsonl"))
    return {
        "trials": found["trials"],
        "logs_mb": round(logs / 1e6, 1),
        "wall_s": round(took_s, 1),
        "cpu_s": round(resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime, 1),
        "peak_memory_mb": round(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e3),
        "html_mb": round(Path(found["html"]).stat().st_size / 1e6, 2),
        "pdf_mb": round(Path(found["pdf"]).stat().st_size / 1e6, 2),
    }


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--operators", type=int, default=12)
    parser.add_argument("--repetitions", type=int, default=2)
    parser.add_argument("--folder", type=Path, help="a study to report, instead of a made-up one")
    parser.add_argument("--json", action="store_true", help="accepted; it is always printed")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.folder or Path(scratch) / "study"
        if options.folder is None:
            made_up(folder, options.operators, options.repetitions)
        print(json.dumps(measured(folder, Path(scratch) / "report")))


if __name__ == "__main__":
    main()
