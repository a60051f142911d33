"""What the benchmark of simulated operators makes of its trials."""

import argparse
import io
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from benchmarks import operators
from benchmarks._operators_summary import METRICS, summary, summary_table
from benchmarks.operators import Task, Variant, parse_variant
from mrnav_server.cli.simulated_trial import ROOM_UM, far_site
from mrnav_server.core.frames import VesselPoint
from mrnav_server.vision.vessel_model import vessel_map


def trial(operator: int, condition: str, **values: float) -> dict[str, Any]:
    metrics: dict[str, Any] = {key: 1.0 for part, key, _ in METRICS.values() if part == "metrics"}
    handover: dict[str, Any] = {key: 1.0 for part, key, _ in METRICS.values() if part == "handover"}
    handover["smoothness"] = {"value": None}
    return {
        "completed": True,
        "reason": "",
        "task": {"operator": operator, "condition": condition, "variant": {"name": "default"}},
        "metrics": metrics | values,
        "handover": handover,
        "collisions_in_auto": 0,
        "latency_ms": {"tick": {"p99": 12.0}},
    }


def test_trials_of_one_operator_are_averaged_before_operators_are_compared() -> None:
    trials = [
        trial(0, "without_autonomy", completion_s=10.0),
        trial(0, "without_autonomy", completion_s=20.0),
        trial(1, "without_autonomy", completion_s=17.0),
        trial(0, "with_autonomy", completion_s=12.0),
        trial(1, "with_autonomy", completion_s=18.0),
    ]
    found = summary(trials)
    assert found["simulated"] is True
    assert found["conditions"]["without"]["toc_s"]["per_operator"] == [15.0, 17.0]
    assert found["conditions"]["without"]["toc_s"]["sd"] == pytest.approx(2.0**0.5, abs=1e-4)
    assert found["improved"]["with default"]["toc_s"] == {
        "better": 1,
        "worse": 1,
        "same": 0,
        "operators": 2,
    }
    assert found["improved"]["with default"]["c"]["same"] == 2


def test_higher_is_better_for_speed_alone() -> None:
    trials = [
        trial(0, "without_autonomy"),
        trial(0, "with_autonomy", average_speed_um_per_s=2.0, straightness=2.0, contacts=2.0),
    ]
    improved = summary(trials)["improved"]["with default"]
    assert improved["va_um_per_s"]["better"] == 1
    assert improved["g"]["worse"] == 1
    assert improved["c"]["worse"] == 1


def test_what_failed_or_is_not_defined_counts_for_nothing() -> None:
    failed = trial(1, "with_autonomy", completion_s=1000.0) | {"completed": False, "reason": "no robot"}
    found = summary([trial(0, "with_autonomy"), failed])
    assert (found["failed"], found["failures"]) == (1, ["no robot"])
    assert found["conditions"]["with default"]["operators"] == 1
    assert found["conditions"]["with default"]["handover_s"]["mean"] is None
    page = Console(file=io.StringIO(), width=120)
    page.print(summary_table(found))
    assert isinstance(page.file, io.StringIO)
    assert "Simulated operators and rig" in page.file.getvalue()


def test_a_variant_is_a_name_and_settings_as_variables() -> None:
    assert parse_variant("plain") == Variant("plain", {})
    assert parse_variant("paper:handover.style=paper,hand.gain=0.05") == Variant(
        "paper", {"MRNAV_HANDOVER__STYLE": "paper", "MRNAV_HAND__GAIN": "0.05"}
    )
    for wrong in ("paper:style", "paper:handover=1", "a b:c.d=1"):
        with pytest.raises(argparse.ArgumentTypeError):
            parse_variant(wrong)


def test_a_finished_trial_is_kept_and_a_failed_one_is_run_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs: list[Task] = []
    task = Task(Variant("default", {}), "with_autonomy", "network", 3, 1, 2500.0)

    def run(task: Task, _: Path, *, real_time: bool) -> dict[str, Any]:
        runs.append(task)
        done = len(runs) > 1
        return {"completed": done, "task": asdict(task), "real_time": real_time, "run": len(runs)}

    monkeypatch.setattr(operators, "run_trial", run)
    assert [operators.finish(task, tmp_path, real_time=False)["run"] for _ in range(4)] == [1, 2, 2, 2]
    other = Task(Variant("default", {"MRNAV_HAND__GAIN": "0.05"}), "with_autonomy", "network", 3, 1, 2500.0)
    assert operators.finish(other, tmp_path, real_time=False)["run"] == 3
    assert operators.finish(other, tmp_path, real_time=True)["run"] == 4


def test_the_site_is_far_and_has_room() -> None:
    mask = np.zeros((900, 900), dtype=np.uint8)
    mask[200:400, 20:880] = 255
    vessel = vessel_map("channel", mask)
    site = far_site(vessel, VesselPoint(100.0, 300.0))
    assert site.x_px > 750.0
    assert vessel.clearance_um(site) >= ROOM_UM
