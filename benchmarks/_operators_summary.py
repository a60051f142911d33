"""What the simulated operators' trials come to: means per operator, their spread, and directions."""

from typing import Any

import numpy as np
from rich.table import Table

METRICS = {
    "va_um_per_s": ("metrics", "average_speed_um_per_s", 1),
    "toc_s": ("metrics", "completion_s", -1),
    "g": ("metrics", "straightness", -1),
    "s": ("metrics", "smoothness", -1),
    "c": ("metrics", "contacts", -1),
    "handover_s": ("handover", "smoothness", -1),
    "handover_peak_jerk_mm_per_s3": ("handover", "peak_jerk_um_per_s3", -1),
    "handover_standstill_s": ("handover", "standstill_s", -1),
    "handover_jump_um": ("handover", "jump_um", -1),
    "take_over_s": ("handover", "take_over_s", -1),
}
"""Where a trial's result holds each metric, and +1 where higher is better."""
LATE_MS = 25.0
"""A trial whose 99th percentile of the tick (10 ms) is longer ran on a machine that was too busy."""
_SCALE = {"handover_peak_jerk_mm_per_s3": 1e-3}


def value_of(result: dict[str, Any], name: str) -> float:
    """Return one metric of a trial; NaN where its motion does not define it."""
    part, key, _ = METRICS[name]
    value = (result[part] or {}).get(key)
    if isinstance(value, dict):
        value = value["value"]
    return float("nan") if value is None else float(value) * _SCALE.get(name, 1.0)


def summary(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Return means and spread over operators, and how many improve, for every variant.

    A trial that failed counts for nothing but the number of failures. Trials of one operator are averaged
    first: they are no independent samples.
    """
    good = [r for r in results if r["completed"]]
    groups: dict[str, list[dict[str, Any]]] = {}
    for result in good:
        groups.setdefault(_group(result), []).append(result)
    without = _by_operator(groups.get("without", []))
    found: dict[str, Any] = {
        "simulated": True,
        "note": "simulated operators: they exercise the software and are no evidence about people",
        "trials": len(results),
        "failed": len(results) - len(good),
        "failures": sorted({str(r["reason"]) for r in results if not r["completed"]}),
        "conditions": {},
        "improved": {},
    }
    for group, trials in sorted(groups.items()):
        each = _by_operator(trials)
        found["conditions"][group] = _described(each) | {
            "trials": len(trials),
            "contacts_in_auto": sum(r["collisions_in_auto"] for r in trials),
            "tick_p99_ms_worst": max(r["latency_ms"]["tick"]["p99"] for r in trials),
            "trials_with_late_ticks": sum(r["latency_ms"]["tick"]["p99"] > LATE_MS for r in trials),
        }
        if group != "without":
            found["improved"][group] = {name: _improved(without, each, name) for name in METRICS}
    return found


def summary_table(found: dict[str, Any]) -> Table:
    """Return the summary for people."""
    table = Table(
        title="Simulated operators and rig: mean ± spread between operators (↑ higher, ↓ lower is better)",
        title_justify="left",
    )
    table.add_column("simulated")
    for group, entry in found["conditions"].items():
        table.add_column(f"{group}, {entry['operators']} operators", justify="right")
    for name, (_, _, sign) in METRICS.items():
        cells = [f"{name} {'↑' if sign > 0 else '↓'}"]
        for group, entry in found["conditions"].items():
            mean, spread = entry[name]["mean"], entry[name]["sd"]
            cell = "–" if mean is None else f"{mean:.2f} ± {spread:.2f}"
            if mean is not None and group in found["improved"]:
                cell += ", {better} of {operators} better".format(**found["improved"][group][name])
            cells.append(cell)
        table.add_row(*cells)
    return table


def _group(result: dict[str, Any]) -> str:
    task = result["task"]
    return "without" if task["condition"] == "without_autonomy" else f"with {task['variant']['name']}"


def _by_operator(trials: list[dict[str, Any]]) -> dict[int, dict[str, float]]:
    """Return each operator's mean of each metric over its trials; NaN where no trial defines it."""
    operators = sorted({int(r["task"]["operator"]) for r in trials})
    means: dict[int, dict[str, float]] = {}
    for operator in operators:
        own = [r for r in trials if r["task"]["operator"] == operator]
        means[operator] = {name: _mean([value_of(r, name) for r in own]) for name in METRICS}
    return means


def _mean(values: list[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if known else float("nan")


def _described(each: dict[int, dict[str, float]]) -> dict[str, Any]:
    described: dict[str, Any] = {"operators": len(each)}
    for name in METRICS:
        known = [means[name] for means in each.values() if np.isfinite(means[name])]
        described[name] = {
            "mean": round(float(np.mean(known)), 4) if known else None,
            "sd": round(float(np.std(known, ddof=1)), 4) if len(known) > 1 else 0.0,
            "per_operator": [round(value, 4) for value in known],
        }
    return described


def _improved(
    without: dict[int, dict[str, float]], each: dict[int, dict[str, float]], name: str
) -> dict[str, int]:
    """Count the operators whose own mean is better, worse or the same with autonomy."""
    sign = METRICS[name][2]
    gains = [sign * (each[o][name] - without[o][name]) for o in each.keys() & without.keys()]
    known = [gain for gain in gains if np.isfinite(gain)]
    return {
        "better": sum(gain > 0 for gain in known),
        "worse": sum(gain < 0 for gain in known),
        "same": sum(gain == 0 for gain in known),
        "operators": len(known),
    }
