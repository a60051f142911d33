"""Simulated operators with and without autonomy, over real sockets: five metrics and the hand-over.

Run from a checkout: ``mrnav bench operators``. Each trial has a server and an operator of its own, in virtual
time in one process, or with ``--real-time`` as processes. Finished trials are kept in a folder, and left out
when it is run again. Prints one JSON object. All simulated: it exercises the software, and is no evidence
about people.
"""

import argparse
import json
import math
import multiprocessing
import os
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from benchmarks._operators_summary import summary, summary_table
from mrnav_server.cli.real_trial import run_as_processes
from mrnav_server.cli.simulated_trial import SimulatedTrial
from mrnav_server.cli.virtual_trial import run_in_this_process
from mrnav_server.core.errors import MrnavError
from mrnav_server.core.vessel import VesselMap
from mrnav_server.sim.operator import Condition
from mrnav_server.study.trial_handover import trial_handover
from mrnav_server.study.trial_record import read_trial_record
from mrnav_server.vision.model_store import find_model, model_names
from mrnav_server.vision.vessel_model import load_vessel_model


@dataclass(frozen=True, slots=True)
class Variant:
    """Settings under another name; only trials with autonomy tell variants apart."""

    name: str
    env: dict[str, str]


@dataclass(frozen=True, slots=True)
class Task:
    """One trial."""

    variant: Variant
    condition: Condition
    model: str
    operator: int
    repetition: int
    epsilon_um: float

    @property
    def name(self) -> str:
        """What its result is kept under."""
        way = f"with-{self.variant.name}" if self.condition == "with_autonomy" else "without"
        return f"{way}-{self.model}-{self.operator:02d}-{self.repetition}-{self.epsilon_um:.0f}"


def parse_variant(text: str) -> Variant:
    """Read ``name`` or ``name:section.key=value,section.key=value``.

    Raises:
        argparse.ArgumentTypeError: If it is neither.
    """
    name, _, settings = text.partition(":")
    env = {}
    for setting in filter(None, settings.split(",")):
        key, equals, value = setting.partition("=")
        section, dot, field = key.partition(".")
        if not (equals and dot and field):
            raise argparse.ArgumentTypeError(f"{setting!r}: write section.key=value")
        env[f"MRNAV_{section}__{field.replace('.', '__')}".upper()] = value
    if not name.replace("-", "").replace("_", "").isalnum():
        raise argparse.ArgumentTypeError(f"{name!r}: a name is letters, digits, - and _")
    return Variant(name, env)


def run_trial(task: Task, folder: Path, *, real_time: bool) -> dict[str, Any]:
    """Run one trial in a folder; return its figures, or why there are none."""
    trial = SimulatedTrial(
        operator=task.operator,
        repetition=task.repetition,
        practice=task.repetition,
        condition=task.condition,
        model=task.model,
        epsilon_um=task.epsilon_um,
        code=f"SIM{task.operator}",
        notes=f"benchmark, simulated operator {task.operator}, variant {task.variant.name}",
        variables=task.variant.env if task.condition == "with_autonomy" else {},
    )
    result: dict[str, Any] = {"simulated": True, "task": asdict(task), "completed": False, "reason": ""}
    began_s = time.monotonic()
    try:
        led = (run_as_processes if real_time else run_in_this_process)(trial, folder)
        result |= led | _judged(led.pop("ended"), load_vessel_model(find_model(task.model)))
    except (MrnavError, OSError) as error:
        result["reason"] = str(error)
    return result | {"real_time": real_time, "wall_s": round(time.monotonic() - began_s, 1)}


def _judged(ended: dict[str, Any], vessel: VesselMap) -> dict[str, Any]:
    found = figures(Path(ended["folder"]), vessel) if "metrics" in ended else {}
    return found | {
        "collisions_in_auto": ended["collisions_in_auto"],
        "latency_ms": ended["latency_ms"],
        "metrics": ended.get("metrics"),
    }


def figures(folder: Path, vessel: VesselMap) -> dict[str, Any]:
    """Return what the trial's log says of the hand-over; without one, of the way into the critical area."""
    found = trial_handover(folder, read_trial_record(folder), vessel)
    return {"handover": _finite(asdict(found)) if found else None}


def _finite(values: dict[str, Any]) -> dict[str, Any]:
    return {
        name: _finite(value)
        if isinstance(value, dict)
        else (None if isinstance(value, float) and not math.isfinite(value) else value)
        for name, value in values.items()
    }


def finish(task: Task, folder: Path, *, real_time: bool) -> dict[str, Any]:
    """Return a task's result: the one that is kept, or that of a new trial."""
    kept = folder / f"{task.name}.json"
    if kept.exists():
        old: dict[str, Any] = json.loads(kept.read_text())
        if old["completed"] and old["task"] == asdict(task) and old.get("real_time", True) == real_time:
            return old
    with tempfile.TemporaryDirectory(prefix="mrnav-operators-") as scratch:
        result = run_trial(task, Path(scratch), real_time=real_time)
    part = kept.with_suffix(".part")
    part.write_text(json.dumps(result))
    part.replace(kept)
    return result


def main() -> None:
    """Run all trials that are not kept yet, and summarize."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--operators", type=int, default=12)
    parser.add_argument("--repetitions", type=int, default=2)
    parser.add_argument("--models", nargs="+", default=model_names())
    parser.add_argument("--epsilon-um", type=float, default=2500.0, help="radius of the critical area")
    parser.add_argument("--parallel", type=int, default=max(1, (os.cpu_count() or 2) // 2))
    parser.add_argument("--folder", type=Path, default=Path("runs/operators"), help="results of the trials")
    parser.add_argument(
        "--variant",
        type=parse_variant,
        action="append",
        help="name:section.key=value,... for trials with autonomy; may be repeated",
    )
    parser.add_argument("--real-time", action="store_true", help="server and operator as processes")
    parser.add_argument("--json", action="store_true", help="no table")
    options = parser.parse_args()
    variants = options.variant or [Variant("default", {})]
    baseline = Variant("default", {})
    conditions: list[tuple[Condition, list[Variant]]] = [
        ("without_autonomy", [baseline]),
        ("with_autonomy", variants),
    ]
    tasks = [
        Task(variant, condition, model, operator, repetition, options.epsilon_um)
        for repetition in range(options.repetitions)
        for operator in range(options.operators)
        for model in options.models
        for condition, those in conditions
        for variant in those
    ]
    options.folder.mkdir(parents=True, exist_ok=True)
    say = Console(stderr=True, highlight=False)
    columns = (TextColumn("trials (simulated)"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    results = []
    # Processes: a thread that computes would hold up another one's heartbeat.
    apart = multiprocessing.get_context("spawn")
    with Progress(*columns, console=say) as progress, ProcessPoolExecutor(options.parallel, apart) as pool:
        bar = progress.add_task("", total=len(tasks))
        running = {
            pool.submit(finish, task, options.folder, real_time=options.real_time): task for task in tasks
        }
        for done in as_completed(running):
            result = done.result()
            results.append(result)
            progress.advance(bar)
            if not result["completed"]:
                progress.print(f"{running[done].name}: {result['reason']}", markup=False)
    found = summary(results) | {"parallel": options.parallel, "cpu_cores": os.cpu_count()}
    if not options.json:
        say.print(summary_table(found))
    print(json.dumps(found))


if __name__ == "__main__":
    main()
