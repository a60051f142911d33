"""One trial's result and picture, from its log and the vessel model alone (docs/study.md)."""

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from mrnav_server.autonomy.grid_graph import GridGraph
from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.metrics import Trial, TrialMetrics, trial_metrics
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.trial_log import TrialHeader
from mrnav_server.study.trajectory_plot import trajectory_figure
from mrnav_server.study.trajectory_record import write_trajectory
from mrnav_server.study.trial_record import TrialRecord, read_trial_record

RESULT_NAME = "result.json"
PICTURE_NAME = "trajectory.png"
DIRECTIONS = {
    "average_speed_um_per_s": "higher is faster",
    "completion_s": "lower is faster",
    "straightness": "lower is straighter",
    "smoothness": "lower is smoother",
    "contacts": "lower is safer",
    "log_dimensionless_jerk": "higher is smoother",
    "spectral_arc_length": "higher is smoother",
    "path_length_share": "higher is more direct",
}
_GEODESIC_REACH = 5


def write_trial_report(folder: Path, vessel: VesselMap) -> dict[str, Any]:
    """Write ``result.json``, ``trajectory.json`` and ``trajectory.png`` into a trial's folder.

    Args:
        folder: The trial's folder.
        vessel: The vessel model that the trial's header names.

    Returns:
        The result.

    Raises:
        ConfigError: If the log is not readable.
        RefusedError: ``no_tracks``, or ``other_vessel`` if the model is not the trial's.
    """
    record = read_trial_record(folder)
    if record.header.vessel_sha256 != vessel.digest:
        raise RefusedError(
            "other_vessel",
            f"trial {folder.name} was made with another mask of {record.header.vessel} than the one given",
        )
    clearance_um = record.clearance_um(vessel)
    metrics = measured(record, clearance_um, vessel, route_graph(vessel))
    result = result_fields(record, metrics)
    write_trajectory(folder, record, clearance_um, vessel)
    (folder / RESULT_NAME).write_bytes(orjson.dumps(result, option=orjson.OPT_INDENT_2) + b"\n")
    trajectory_figure(record, clearance_um, vessel).savefig(folder / PICTURE_NAME, dpi=120)
    return result


def measured(
    record: TrialRecord, clearance_um: FloatArray, vessel: VesselMap, routes: GridGraph
) -> TrialMetrics:
    """Return a recorded trial's metrics.

    Args:
        record: The trial.
        clearance_um: Gap to the wall at every track, shape (n,).
        vessel: Its vessel model.
        routes: ``route_graph`` of it.
    """
    return trial_metrics(
        Trial(
            t_s=record.t_s,
            xy_um=record.vessel_px * vessel.um_per_px,
            clearance_um=clearance_um,
            go_s=record.go_s,
            end_s=record.end_s,
            reached=record.reached,
            sigma_um=_median(record.sigma_um),
            geodesic_um=geodesic_um(record.header, routes),
        )
    )


def result_fields(record: TrialRecord, metrics: TrialMetrics) -> dict[str, Any]:
    """Return a trial's result, ready for JSON: what its motion does not define is null."""
    # orjson writes NaN as null, at any depth.
    values: dict[str, Any] = orjson.loads(orjson.dumps(asdict(metrics)))
    header = record.header
    return {
        "id": record.id,
        "participant": header.participant,
        "condition": header.condition,
        "operator_kind": header.operator_kind,
        "simulated": record.simulated,
        "vessel": header.vessel,
        "reached": record.reached,
        "metrics": values,
        "direction": DIRECTIONS,
    }


def route_graph(vessel: VesselMap) -> GridGraph:
    """Return the graph that a vessel's shortest paths are found in; it costs most at its first path."""
    return GridGraph(vessel, reach=_GEODESIC_REACH)


def geodesic_um(header: TrialHeader, routes: GridGraph) -> float:
    """Return the length of the shortest path from start to critical area; NaN if there is none."""
    if header.start_px is None or header.area_px is None:
        return math.nan
    try:
        path_px = routes.path(VesselPoint(*header.start_px), VesselPoint(*header.area_px))
    except RefusedError:
        return math.nan
    return float(np.hypot(*np.diff(path_px, axis=0).T).sum()) * header.um_per_px


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else math.nan
