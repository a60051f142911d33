"""Simulated operators with and without autonomy, over real sockets: five metrics and the hand-over.

Run from a checkout: ``mrnav bench operators``. Each trial has a server and an operator of its own,
as processes in real time. Finished trials are kept in a folder, and left out when it is run again. Prints one
JSON object. All simulated: it exercises the software, and is no evidence about people.
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

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from benchmarks._operators_summary import summary, summary_table
from mrnav_server.autonomy.grid_graph import GridGraph
from mrnav_server.cli.children import Child, mrnav_child
from mrnav_server.cli.console import TrialFailedError, TwinConsole
from mrnav_server.cli.trial_steps import ARMED_S, SEATED_S, ask_auto, insist, wait_ready, wait_tracking
from mrnav_server.client.rest import Rest
from mrnav_server.core.errors import MrnavError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.handover_metrics import handover_metrics
from mrnav_server.core.metrics import trial_motions
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.trial_log import LOG_NAME, read_log
from mrnav_server.study.trial_record import TrialRecord, read_trial_record
from mrnav_server.vision.model_store import find_model, model_names
from mrnav_server.vision.vessel_model import load_vessel_model

WAY_UM = 27_000.0
"""The target lies about so far along the vessel, or as far as there is."""
ROOM_UM = 300.0
TRIAL_S = 100.0
REPORT_S = 150.0
AUTO_ASKS = 4
TARGET = {"MRNAV_TRIAL__TARGET_UM": "200.0", "MRNAV_TRIAL__DWELL_S": "0.2"}


@dataclass(frozen=True, slots=True)
class Variant:
    """Settings under another name; only trials with autonomy tell variants apart."""

    name: str
    env: dict[str, str]


@dataclass(frozen=True, slots=True)
class Task:
    """One trial."""

    variant: Variant
    condition: str
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


def far_site(vessel: VesselMap, start: VesselPoint) -> VesselPoint:
    """Return the roomy place whose way from the start is nearest to 27 mm."""
    graph = GridGraph(vessel, cell_px=8)
    way_um = graph.distances_px(start) * vessel.um_per_px
    places = [VesselPoint(float(x), float(y)) for x, y in graph.nodes_px]
    roomy = [
        i for i in np.flatnonzero(np.isfinite(way_um)).tolist() if vessel.clearance_um(places[i]) >= ROOM_UM
    ]
    return places[min(roomy, key=lambda i: abs(float(way_um[i]) - WAY_UM))]


def run_trial(task: Task, folder: Path) -> dict[str, Any]:
    """Run one trial in a folder; return its figures, or why there are none."""
    # The same operator meets the same friction in both conditions.
    chance = np.random.default_rng([task.operator, task.repetition, 77])
    env = {
        "MRNAV_SERVER__HOST": "127.0.0.1",
        "MRNAV_SERVER__PORT": "0",
        "MRNAV_SERVER__HAND_PORT": "0",
        "MRNAV_RIG__VESSEL": task.model,
        "MRNAV_RECORDING__ROOT": str(folder),
        "MRNAV_SIM__SEED": str(100 * task.operator + task.repetition),
        "MRNAV_SIM__FRICTION": f"{0.2 * math.exp(chance.normal(0.0, 0.05)):.4f}",
        **TARGET,
        **(task.variant.env if task.condition == "with_autonomy" else {}),
    }
    result: dict[str, Any] = {"simulated": True, "task": asdict(task), "completed": False, "reason": ""}
    ready_file = folder / "ready.json"
    began_s = time.monotonic()
    try:
        with mrnav_child(
            "the server", ["serve", "--ready-file", str(ready_file)], env, folder / "serve"
        ) as server:
            result |= _drive(task, folder, wait_ready(ready_file, server), server)
    except (MrnavError, OSError) as error:
        result["reason"] = str(error)
    return result | {"wall_s": round(time.monotonic() - began_s, 1)}


def _drive(task: Task, folder: Path, ready: dict[str, Any], server: Child) -> dict[str, Any]:
    url, token = f"http://127.0.0.1:{ready['port']}", ready["operator_token"]
    rest = Rest(url, token, timeout_s=REPORT_S)
    vessel = load_vessel_model(find_model(task.model))
    site = far_site(vessel, VesselPoint(*wait_tracking(rest)["robot_vessel_px"]))
    center = {"frame": "vessel", "x": site.x_px, "y": site.y_px}
    area = rest.post("/api/v1/critical-areas", {"center": center, "epsilon_um": task.epsilon_um})["id"]
    sit = ["operator", "--port", str(ready["hand_port"]), "--url", url, "--condition", task.condition]
    sit += ["--seed", str(task.operator), "--trial", str(task.repetition), "--area", area, "--json"]
    said = folder / "operator"
    with mrnav_child("the operator", sit, {"MRNAV_SERVER__OPERATOR_TOKEN": token}, said) as operator:

        def alive() -> None:
            server.check()
            operator.check()

        with TwinConsole(url, token, alive) as twin:
            console = Rest(url, token, twin.snapshot["session"])
            console.post("/api/v1/lease", {"client": "benchmark"})
            twin.until(lambda s: bool(s["lease"]["hand"]), SEATED_S, "the operator's hand link")
            trial = console.post(
                "/api/v1/trials",
                {
                    "participant": f"SIM{task.operator}",
                    "condition": task.condition,
                    "operator_kind": "simulated",
                    "notes": f"benchmark, simulated operator {task.operator}, variant {task.variant.name}",
                },
            )
            reason = _perform(task, console, twin, area)
            if twin.state["mode"] in ("MANUAL", "HOLD", "AUTO"):
                console.post("/api/v1/mode", {"ask": "disarm"})
        ended = rest.post(f"/api/v1/trials/{trial['id']}/end", {})
    found = figures(Path(ended["folder"]), vessel) if "metrics" in ended else {}
    return found | {
        "completed": not reason and "metrics" in ended,
        "reason": reason or ended.get("report_error", ""),
        "collisions_in_auto": ended["collisions_in_auto"],
        "latency_ms": ended["latency_ms"],
        "operator": _last_json(said),
        "metrics": ended.get("metrics"),
    }


def _perform(task: Task, rest: Rest, twin: TwinConsole, area: str) -> str:
    """Let the trial happen; return why it failed, or ""."""
    insist(rest, twin, "arm")
    twin.until(lambda s: s["mode"] in ("MANUAL", "HOLD"), ARMED_S, "arming")

    def happened(name: str, mark: str | None = None) -> bool:
        return any(e["event"] == name and e.get("mark") == mark for e in twin.events)

    try:
        asks = AUTO_ASKS if task.condition == "with_autonomy" else 0
        for _ in range(asks):
            ask_auto(rest, twin, area)
            twin.until(lambda s: s["mode"] == "AUTO" or happened("handover"), ARMED_S, "AUTO")
            twin.until(lambda s: s["mode"] != "AUTO", TRIAL_S, "autonomy")
            if happened("handover") or twin.state["mode"] != "HOLD":
                break
            twin.wait(1.0)
        if asks and not happened("handover"):
            return f"autonomy ended in {twin.state['mode']}: {twin.state['reason']}"
        twin.until(
            lambda s: happened("trial", "reached") or s["mode"] in ("FAULT", "STOP"), TRIAL_S, "the target"
        )
        if not happened("trial", "reached"):
            return f"{twin.state['mode']}: {twin.state['reason']}"
        twin.wait(1.0)
    except TrialFailedError as error:
        return str(error)
    return ""


def figures(folder: Path, vessel: VesselMap) -> dict[str, Any]:
    """Return what the trial's log says of the hand-over; without one, of the way into the critical area."""
    record = read_trial_record(folder)
    sent_s, sent_um, clutch, handed_s = [], [], [], math.nan
    for line in read_log(folder / LOG_NAME):
        if line.topic == "command":
            sent_s.append(line.data["sent_s"])
            sent_um.append(line.data["target_um"])
        elif line.topic == "hand":
            clutch.append((line.data["received_s"], line.data["clutch"]))
        elif line.topic == "mode" and (line.data["before"], line.data["mode"]) == ("AUTO", "MANUAL"):
            handed_s = line.t_s
    switch_s = _entered_s(record, vessel) if math.isnan(handed_s) else handed_s
    grips_s = [t_s for t_s, closed in clutch if closed and t_s >= handed_s]
    motions = trial_motions(record.t_s, record.vessel_px * vessel.um_per_px, record.go_s, record.end_s)
    found = handover_metrics(
        motions,
        switch_s,
        np.array(sent_s),
        np.array(sent_um),
        grip_s=grips_s[0] if grips_s else math.nan,
        end_s=record.end_s,
    )
    return {"handover": _finite(asdict(found))}


def _entered_s(record: TrialRecord, vessel: VesselMap) -> float:
    header = record.header
    if header.area_px is None or header.area_epsilon_um is None:
        return math.nan
    away_um = np.hypot(*(record.vessel_px - np.array(header.area_px)).T) * vessel.um_per_px
    inside = np.flatnonzero((away_um <= header.area_epsilon_um) & record.inside)
    return float(record.t_s[inside[0]]) if inside.size else math.nan


def _finite(values: dict[str, Any]) -> dict[str, Any]:
    return {
        name: _finite(value)
        if isinstance(value, dict)
        else (None if isinstance(value, float) and not math.isfinite(value) else value)
        for name, value in values.items()
    }


def _last_json(file: Path) -> dict[str, Any] | None:
    lines = [line for line in file.read_text(errors="replace").splitlines() if line.startswith("{")]
    last: dict[str, Any] | None = json.loads(lines[-1]) if lines else None
    return last


def finish(task: Task, folder: Path) -> dict[str, Any]:
    """Return a task's result: the one that is kept, or that of a new trial."""
    kept = folder / f"{task.name}.json"
    if kept.exists():
        old: dict[str, Any] = json.loads(kept.read_text())
        if old["completed"] and old["task"] == asdict(task):
            return old
    with tempfile.TemporaryDirectory(prefix="mrnav-operators-") as scratch:
        result = run_trial(task, Path(scratch))
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
    parser.add_argument("--json", action="store_true", help="no table")
    options = parser.parse_args()
    variants = options.variant or [Variant("default", {})]
    baseline = Variant("default", {})
    tasks = [
        Task(variant, condition, model, operator, repetition, options.epsilon_um)
        for repetition in range(options.repetitions)
        for operator in range(options.operators)
        for model in options.models
        for condition, those in (("without_autonomy", [baseline]), ("with_autonomy", variants))
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
        running = {pool.submit(finish, task, options.folder): task for task in tasks}
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
