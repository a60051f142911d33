"""How long a 10-minute trial takes to export, to open and to import: ``mrnav bench export --json``.

Run from a checkout. The trial is made up, and simulated: 100 steps and commands, 60 hand samples and 30
tracks a second, with lines as the server writes them. ``open_all_s`` is all tables, ``open_track_s`` the
tracks alone; ``open_log_s`` is what pandas takes for the log itself. Prints one JSON object.
"""

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import polars as pl
from mcap.reader import make_reader

from mrnav_server.loops.trial_log import header_line, log_line
from mrnav_server.study.export import FORMATS, export_trials
from mrnav_server.study.import_trials import import_trials
from tests.recorded_trials import RecordedTrial

TRIAL_ID = "20261123-101500-001-SIM01"
REPEATS = 5


def made_up(folder: Path, duration_s: float) -> int:
    """Write a trial as long as asked; return how many lines it has."""
    header = replace(RecordedTrial("SIM01", operator_kind="simulated").header(), notes="made up")
    lines = [header_line(TRIAL_ID, header)]

    def add(t_s: float, topic: str, data: dict[str, Any]) -> None:
        lines.append(log_line(len(lines), t_s, 1.79e9 + t_s, topic, data))

    add(50.0, "trial", {"event": "trial", "mark": "start", "id": TRIAL_ID})
    for tick in range(round(duration_s * 100)):
        t_s = 50.0 + tick / 100
        place = [9120.0 + t_s / 7, 8949.99 + t_s / 3, 13125.655]
        tip = {"tip_taken_s": t_s - 0.001, "tip_um": place, "tip_moving": True}
        add(t_s, "step", {"now_s": t_s, "by": "tick", **tip})
        add(
            t_s,
            "command",
            {
                "sent_s": t_s,
                "setpoint_um": place,
                "asked_um": place,
                "asked_um_per_s": 2211.0 + t_s / 9,
                "target_um": place,
                "speed_um_per_s": 2211.0 + t_s / 9,
                "ahead_ms": 22.71,
                "mode": "AUTO",
            },
        )
        if tick % 5 < 3:
            pose = {"p_m": [t_s / 11, 0.1, t_s / 13], "clutch": True, "valid": True, "new_pose": True}
            add(t_s, "hand", {"seq": tick, "sender_s": t_s, "received_s": t_s, **pose})
        if tick % 10 in (0, 3, 6):
            seen = {"image": [741.34 + t_s / 3, 530.0], "vessel": [812.01, 795.01 - t_s / 3]}
            sure = {"confidence": 1.0, "sigma_um": 0.5659, "good_frames": 41}
            add(t_s, "track", {"frame": tick, "taken_s": t_s, "state": "tracking", **seen, **sure})
    add(50.0 + duration_s, "closed", {"status": "ended", "lost_lines": 0})
    folder.mkdir(parents=True)
    (folder / "log.jsonl").write_bytes(b"".join(lines))
    return len(lines) - 1


def timed(action: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the median of how long something takes, in s."""
    took_s = []
    for _ in range(repeats):
        began_s = time.perf_counter()
        action()
        took_s.append(time.perf_counter() - began_s)
    return round(statistics.median(took_s), 3)


def open_all(read: Callable[[Path], object], files: list[Path]) -> None:
    """Read every table."""
    for file in files:
        read(file)


def open_mcap(folder: Path) -> int:
    """Read a whole MCAP file; return its messages."""
    with next(folder.glob("*.mcap")).open("rb") as stream:
        return sum(1 for _ in make_reader(stream).iter_messages())


def figures(folder: Path, duration_s: float) -> dict[str, Any]:
    """Measure everything."""
    trial = folder / TRIAL_ID
    lines = made_up(trial, duration_s)
    log = trial / "log.jsonl"
    found: dict[str, Any] = {
        "simulated": True,
        "duration_s": duration_s,
        "lines": lines,
        "log_mb": round(log.stat().st_size / 1e6, 1),
        "open_log_s": timed(partial(pd.read_json, log, lines=True), 1),
    }
    readers: dict[str, dict[str, Callable[[Path], object]]] = {
        "csv": {"pandas": pd.read_csv, "polars": pl.read_csv},
        "parquet": {"pandas": pd.read_parquet, "polars": pl.read_parquet},
    }
    for form in FORMATS:
        out = folder / "out"
        export_s = timed(partial(export_trials, trial, out, (form,)), 1)
        files = sorted((out / form).iterdir())
        measured: dict[str, Any] = {
            "export_s": export_s,
            "size_mb": round(sum(file.stat().st_size for file in files) / 1e6, 1),
        }
        for name, read in readers.get(form, {}).items():
            measured[name] = {
                "open_all_s": timed(partial(open_all, read, files)),
                "open_track_s": timed(partial(read, out / form / f"track.{form}")),
            }
        if form == "mcap":
            measured["open_all_s"] = timed(partial(open_mcap, out / form), 1)
        into = folder / f"back-{form}"
        measured["import_s"] = timed(partial(import_trials, out / form, into, results=False), 1)
        measured["exact"] = (into / "trials" / TRIAL_ID / "log.jsonl").read_bytes() == log.read_bytes()
        found[form] = measured
    return found


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration-s", type=float, default=600.0)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(figures(Path(folder), asked.duration_s)))


if __name__ == "__main__":
    main()
