"""How well autonomy drives: laws side by side on the whole simulated rig.

Run from a checkout: ``mrnav bench autonomy --tasks 10``. Prints one JSON object, by law and vessel model.
Each task has a start and a critical area of its own, the same for every law; friction 0.1, 0.2 and 0.3 take
turns. All figures are simulated.
"""

import argparse
import json
import multiprocessing
import os
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress

from benchmarks._autonomy_rig import (
    CONDITIONS,
    EPSILON_UM,
    LATENCY_MS,
    LAWS,
    OFFSET_ERROR_UM,
    Bench,
    Law,
    Outcome,
    Task,
)
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.shortest import shortest_ways
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model

MODELS = ("bifurcation", "serpentine", "network")
START_CLEARANCE_UM = 50.0
LEAST_TASK_UM = 300.0
LONG_UM = 2000.0
"""Speed is taken over tasks longer than this: short ones are all start and stop."""
Job = tuple[Law, Task, float]

_benches: dict[tuple[str, Law], Bench] = {}


def random_tasks(model: str, count: int, seed: int, offset_error_um: float) -> list[tuple[Task, float]]:
    """Draw tasks on a model, with the length of the shortest way of each, in µm."""
    vessel = load_vessel_model(find_model(model))
    random = np.random.default_rng([seed, *model.encode()])
    y, x = np.nonzero(vessel.free)
    tasks: list[Task] = []
    while len(tasks) < count:
        i, j = random.integers(0, len(x), 2)
        start, target = VesselPoint(float(x[i]), float(y[i])), VesselPoint(float(x[j]), float(y[j]))
        near = start.distance_px(target) * vessel.um_per_px < LEAST_TASK_UM
        if near or vessel.clearance_um(start) < START_CLEARANCE_UM:
            continue
        number = len(tasks)
        condition = CONDITIONS[number % len(CONDITIONS)]
        tasks.append(Task(model, 1000 * seed + number, start, target, *condition, offset_error_um))
    return list(zip(tasks, _geodesics_um(vessel, tasks), strict=True))


def run(
    laws: list[Law], tasks: list[tuple[Task, float]], workers: int, tell: Callable[[Outcome], None]
) -> list[Outcome]:
    """Drive every task under every law, in processes of their own; each outcome is told as it comes."""
    # Tasks of one model and law follow each other, so that a worker seldom loads another one.
    jobs: list[Job] = [(law, task, way_um) for law in laws for task, way_um in tasks]
    context = multiprocessing.get_context("spawn")
    console = Console(stderr=True)
    outcomes: list[Outcome] = []
    with (
        Progress(console=console, disable=not console.is_terminal) as progress,
        ProcessPoolExecutor(workers, context, initializer=_begin_worker) as pool,
    ):
        bar = progress.add_task("tasks (simulated)", total=len(jobs))
        for done in as_completed([pool.submit(_drive, job) for job in jobs]):
            outcomes.append(done.result())
            tell(outcomes[-1])
            progress.advance(bar)
    return outcomes


def summary(outcomes: list[Outcome]) -> dict[str, dict[str, dict[str, Any]]]:
    """Return the figures by law and model."""
    geodesic_s = {(o.task.model, o.task.number): o.arrival_s for o in outcomes if _is_baseline(o)}
    result: dict[str, dict[str, dict[str, Any]]] = {}
    for law in LAWS:
        mine = [o for o in outcomes if o.law == law]
        for model in dict.fromkeys(o.task.model for o in mine):
            of_model = [o for o in mine if o.task.model == model]
            result.setdefault(law, {})[model] = _figures(of_model, geodesic_s)
    return result


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tasks", type=int, default=10, help="on each vessel model")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--model", action="append", choices=MODELS, help="all if left out")
    parser.add_argument("--law", action="append", choices=LAWS, help="all if left out")
    parser.add_argument("--offset-error-um", type=float, default=OFFSET_ERROR_UM)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--outcomes", type=Path, help="write every task's outcome there, as JSON Lines")
    options = parser.parse_args()
    tasks = [
        pair
        for model in options.model or MODELS
        for pair in random_tasks(model, options.tasks, options.seed, options.offset_error_um)
    ]
    with options.outcomes.open("w") if options.outcomes else nullcontext() as file:

        def tell(outcome: Outcome) -> None:
            if file is not None:
                file.write(json.dumps(_line(outcome)) + "\n")
                file.flush()

        outcomes = run(options.law or list(LAWS), tasks, options.workers, tell)
    conditions = {
        "epsilon_um": EPSILON_UM,
        "offset_error_um": options.offset_error_um,
        "camera_latency_ms": LATENCY_MS,
        "friction_and_height": CONDITIONS,
        "seed": options.seed,
    }
    print(json.dumps({"simulated": True, "conditions": conditions, **summary(outcomes)}))
    sys.stdout.flush()


def _begin_worker() -> None:
    import cv2
    import torch

    torch.set_num_threads(1)
    cv2.setNumThreads(1)


def _drive(job: Job) -> Outcome:
    law, task, way_um = job
    key = (task.model, law)
    if key not in _benches:
        for bench in _benches.values():
            bench.close()
        _benches.clear()
        _benches[key] = Bench(*key)
    return _benches[key].drive(task, way_um)


def _geodesics_um(vessel: VesselMap, tasks: list[Task]) -> list[float]:
    """Return the lengths of the shortest ways to the areas' rims."""
    start_px = np.array([(task.start.x_px, task.start.y_px) for task in tasks])
    target_px = np.array([(task.target.x_px, task.target.y_px) for task in tasks])
    lengths_px, _ = shortest_ways(vessel, start_px, target_px)
    return [max(float(length) * vessel.um_per_px - EPSILON_UM, 0.0) for length in lengths_px]


def _is_baseline(outcome: Outcome) -> bool:
    return outcome.law == "geodesic" and outcome.arrived


def _figures(outcomes: list[Outcome], geodesic_s: dict[tuple[str, int], float]) -> dict[str, Any]:
    arrived = [o for o in outcomes if o.arrived]
    long = [o for o in arrived if o.geodesic_um > LONG_UM]
    paired = [(o, geodesic_s[o.task.model, o.task.number]) for o in arrived
              if (o.task.model, o.task.number) in geodesic_s]  # fmt: skip
    cross = np.array([c for o in outcomes for c in o.cross_track_um])
    return {
        "tasks": len(outcomes),
        "arrived": len(arrived),
        "passed_through": sum(o.touched for o in outcomes),
        "contacts": sum(o.contacts for o in outcomes),
        "tasks_with_contact": sum(o.contacts > 0 for o in outcomes),
        "lost": sum(o.lost for o in outcomes),
        "at_first_approach": sum(o.arrived and o.replans == 0 for o in outcomes),
        "speed_um_per_s": _ratio(sum(o.geodesic_um for o in long), sum(o.arrival_s for o in long), 0),
        "time_ratio": _ratio(sum(o.arrival_s for o, _ in paired), sum(s for _, s in paired), 3),
        "cross_track_um": {
            "rms": round(float(np.sqrt(np.mean(cross**2))), 1) if cross.size else None,
            "p99": round(float(np.percentile(cross, 99)), 1) if cross.size else None,
        },
    }


def _ratio(above: float, below: float, digits: int) -> float | None:
    return round(above / below, digits) if below > 0.0 else None


def _line(outcome: Outcome) -> dict[str, Any]:
    fields = asdict(outcome)
    cross = np.array(outcome.cross_track_um)
    fields["cross_track_um"] = round(float(np.sqrt(np.mean(cross**2))), 1) if cross.size else None
    fields["cross_track_max_um"] = round(float(cross.max()), 1) if cross.size else None
    return fields


if __name__ == "__main__":
    main()
