"""What a page draws of a finished trial: path, speed, contacts and walls, as one file (docs/study.md)."""

from bisect import bisect_right
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.contacts import contact_starts
from mrnav_server.core.metrics import trial_motions
from mrnav_server.core.vessel import VesselMap
from mrnav_server.study.trial_record import TrialRecord
from mrnav_server.vision.vessel_outline import walls_px

TRAJECTORY_NAME = "trajectory.json"
SCHEMA_VERSION = 1


def write_trajectory(
    folder: Path, record: TrialRecord, clearance_um: FloatArray, vessel: VesselMap
) -> dict[str, Any]:
    """Write ``trajectory.json`` into a trial's folder; return its fields.

    Args:
        folder: The trial's folder.
        record: The trial.
        clearance_um: Gap to the wall at every track, shape (n,).
        vessel: Its vessel model.
    """
    motions = trial_motions(record.t_s, record.vessel_px * vessel.um_per_px, record.go_s, record.end_s)
    inside = record.inside
    touched = contact_starts(record.t_s[inside], clearance_um[inside])
    known = record.t_s.tolist()
    header = record.header
    fields: dict[str, Any] = {
        "schema": SCHEMA_VERSION,
        "id": record.id,
        "simulated": record.simulated,
        "vessel": vessel.name,
        "size_px": vessel.size_px,
        "um_per_px": vessel.um_per_px,
        "robot_radius_px": vessel.robot_radius_px,
        "walls_px": walls_px(vessel),
        "start_px": header.start_px,
        "area_px": header.area_px,
        "area_epsilon_um": header.area_epsilon_um,
        "parts": [
            {
                "t_s": np.round(motion.t_s - record.go_s, 3).tolist(),
                "x_px": np.round(motion.xy_um[:, 0] / vessel.um_per_px, 2).tolist(),
                "y_px": np.round(motion.xy_um[:, 1] / vessel.um_per_px, 2).tolist(),
                "speed_um_per_s": np.round(motion.speed_um_per_s, 1).tolist(),
                "mode": [record.modes[max(0, bisect_right(known, t) - 1)] for t in motion.t_s.tolist()],
            }
            for motion in motions
        ],
        "contacts": [
            {"t_s": round(t_s - record.go_s, 3), "x_px": x_px, "y_px": y_px}
            for t_s, (x_px, y_px) in zip(
                record.t_s[inside][touched].tolist(), record.vessel_px[inside][touched].tolist(), strict=True
            )
        ],
    }
    (folder / TRAJECTORY_NAME).write_bytes(orjson.dumps(fields) + b"\n")
    return fields
