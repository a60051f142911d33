"""What the demonstration reports: a tally of the twin's states, the result as JSON and as a table."""

import os
from dataclasses import dataclass
from typing import Any

from rich.table import Table

from mrnav_server.cli.console import State, TwinConsole

_METRICS = {
    "toc_s": "completion_s",
    "va_um_per_s": "average_speed_um_per_s",
    "g": "straightness",
    "s": "smoothness",
    "spl": "path_length_share",
}
_ROWS = (
    ("average speed Va", "va_um_per_s", 0, "µm/s, higher"),
    ("time of completion TOC", "toc_s", 2, "s, lower"),
    ("geometric curvature G", "g", 2, "log10 of 1/µm, lower"),
    ("smoothness S", "s", 2, "lower is smoother"),
    ("collisions C", "collisions", 0, "count, lower"),
    ("path efficiency SPL", "spl", 2, "0 to 1, higher"),
    ("robot to the centre", "final_distance_um", 0, "µm"),
)
_LATENCIES = ("hand_to_command", "frame_to_twin", "tick")


@dataclass
class Tally:
    """What must be noted of every state of a trial.

    Attributes:
        drove: Whether AUTO was seen.
        handed_over: Whether MANUAL followed it.
        gripped: Whether the operator's clutch was closed after that.
        robot_lost: Whether the tracker had to search for the robot.
    """

    drove: bool = False
    handed_over: bool = False
    gripped: bool = False
    robot_lost: bool = False

    def note(self, state: State) -> None:
        """Take one state."""
        self.drove = self.drove or state["mode"] == "AUTO"
        if self.drove and state["mode"] == "MANUAL":
            self.handed_over = True
            self.gripped = self.gripped or state["clutch"]
        self.robot_lost = self.robot_lost or state["track"]["state"] == "searching"


def empty_result(model: str, seed: int, root: str) -> dict[str, Any]:
    """Return the result of a trial that has not begun; ``root`` is where its folder will be."""
    names = ("final_distance_um", "toc_s", "va_um_per_s", "g", "s", "collisions", "robot_lost", "spl")
    return {
        "completed": False,
        "reason": "",
        "mode_history": [],
        **dict.fromkeys(names),
        "latency_ms": {},
        "trial_dir": root,
        "seed": seed,
        "model": model,
        "simulated": True,
        "handover_by": None,
        "collisions_in_auto": None,
        "cpu_cores": os.cpu_count(),
    }


def note_states(twin: TwinConsole, tally: Tally, result: dict[str, Any]) -> None:
    """Note what the twin has shown."""
    result["mode_history"] = list(twin.modes)
    result["robot_lost"] = tally.robot_lost
    result["handover_by"] = next((e["by"] for e in reversed(twin.events) if e["event"] == "handover"), None)


def note_end(ended: dict[str, Any], result: dict[str, Any]) -> None:
    """Note the marks, latencies and metrics with which the server ended the trial."""
    for name in ("final_distance_um", "collisions", "collisions_in_auto"):
        result[name] = ended[name]
    result["latency_ms"] = {name: ended["latency_ms"][name] for name in _LATENCIES}
    metrics = ended.get("metrics", {})
    for name, metric in _METRICS.items():
        value = metrics.get(metric)
        result[name] = value["value"] if isinstance(value, dict) else value


def result_table(result: dict[str, Any]) -> Table:
    """Return the figures for people; every one of them is simulated."""
    table = Table(title="One semi-autonomous trial (simulated rig, simulated operator)", title_justify="left")
    table.add_column("simulated")
    table.add_column("value", justify="right")
    table.add_column("unit, better")
    for label, name, digits, unit in _ROWS:
        value = result[name]
        table.add_row(label, "–" if value is None else f"{value:.{digits}f}", unit)
    for name, value in result["latency_ms"].items():
        table.add_row(f"latency {name}", f"{value['p50']} / {value['p99']}", "ms, p50 / p99")
    return table
