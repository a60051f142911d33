"""Results of a sweep by setting: mean and spread over the seeds."""

import csv
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, stdev
from typing import Any

JSON_FILE = "leaderboard.json"
CSV_FILE = "leaderboard.csv"
_FIGURES = {
    "success_greedy": ("success",),
    "success_sampled": ("sampled", "success"),
    "spl_greedy": ("spl",),
    "spl_sampled": ("sampled", "spl"),
    "wall_hits_greedy": ("wall_hits",),
    "cpu_s": ("cpu_s",),
}


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean and sample standard deviation; the latter is None for a single value."""

    mean: float
    deviation: float | None


@dataclass(frozen=True, slots=True)
class Row:
    """One setting.

    Attributes:
        setting: ``model``, ``preset``, ``algo`` and the hyper-parameters that were set.
        seeds: Seeds that are done, sorted.
        figures: By name: success, SPL and wall hits a pair in the simulated grid world, processor time in s.
    """

    setting: dict[str, Any]
    seeds: tuple[int, ...]
    figures: dict[str, Spread]

    def flat(self) -> dict[str, Any]:
        """Return the row as plain values."""
        row = {**self.setting, "simulated": True, "seeds": " ".join(str(seed) for seed in self.seeds)}
        for name, spread in self.figures.items():
            row[name] = spread.mean
            row[f"{name}_spread"] = spread.deviation
        return row


def leaderboard(results: Iterable[dict[str, Any]]) -> list[Row]:
    """Return one row per setting, by model and then best first: greedy success, sampled success, SPL.

    Args:
        results: As `training.sweep_job.read_result` returns them.
    """
    groups: dict[str, list[dict[str, Any]]] = {}
    for result in results:
        spec = {key: value for key, value in result["spec"].items() if key != "seed"}
        groups.setdefault(json.dumps(spec, sort_keys=True), []).append(result)
    rows = [_row(group) for group in groups.values()]
    return sorted(rows, key=_rank)


def write_leaderboard(rows: list[Row], out: Path) -> None:
    """Write ``leaderboard.json`` and ``leaderboard.csv``."""
    flat = [row.flat() for row in rows]
    (out / JSON_FILE).write_text(json.dumps(flat, indent=2) + "\n")
    columns = list(dict.fromkeys(key for row in flat for key in row))
    with (out / CSV_FILE).open("w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(flat)


def _row(results: list[dict[str, Any]]) -> Row:
    spec = results[0]["spec"]
    setting = {"model": spec["model"], "preset": spec["preset"], "algo": spec["algo"], **spec["set"]}
    figures = {name: _spread([_at(result, path) for result in results]) for name, path in _FIGURES.items()}
    return Row(setting, tuple(sorted(result["spec"]["seed"] for result in results)), figures)


def _rank(row: Row) -> tuple[Any, ...]:
    best_first = (-row.figures[name].mean for name in ("success_greedy", "success_sampled", "spl_greedy"))
    return row.setting["model"], *best_first


def _at(result: Any, path: tuple[str, ...]) -> float:  # noqa: ANN401 - JSON
    for key in path:
        result = result[key]
    return float(result)


def _spread(values: list[float]) -> Spread:
    return Spread(fmean(values), stdev(values) if len(values) > 1 else None)
