"""How a recorded trial was handed over; without autonomy, how the critical area was entered."""

import math
from pathlib import Path

import numpy as np

from mrnav_server.core.handover_metrics import HandoverMetrics, handover_metrics
from mrnav_server.core.metrics import trial_motions
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.trial_log import LOG_NAME, read_log
from mrnav_server.study.trial_record import TrialRecord


def trial_handover(folder: Path, record: TrialRecord, vessel: VesselMap) -> HandoverMetrics | None:
    """Return how control passed to the operator for the last time.

    Without a hand-over in its log, the same window begins where the robot enters the critical area.

    Args:
        folder: The trial's folder.
        record: What was read from it.
        vessel: Its vessel model.

    Returns:
        None if there was neither.
    """
    sent_s, sent_um, grips_s = [], [], []
    handed_s = math.nan
    for line in read_log(folder / LOG_NAME):
        match line.topic:
            case "command":
                sent_s.append(line.data["sent_s"])
                sent_um.append(line.data["target_um"])
            case "hand" if line.data["clutch"]:
                grips_s.append(line.data["received_s"])
            case "mode" if (line.data["before"], line.data["mode"]) == ("AUTO", "MANUAL"):
                handed_s = line.t_s
    switch_s = entered_s(record, vessel) if math.isnan(handed_s) else handed_s
    if math.isnan(switch_s):
        return None
    return handover_metrics(
        trial_motions(record.t_s, record.vessel_px * vessel.um_per_px, record.go_s, record.end_s),
        switch_s,
        np.array(sent_s),
        np.array(sent_um, dtype=np.float64).reshape(len(sent_um), -1),
        grip_s=next((t_s for t_s in grips_s if t_s >= handed_s), math.nan),
        end_s=record.end_s,
    )


def entered_s(record: TrialRecord, vessel: VesselMap) -> float:
    """Return when the robot first was in the critical area; NaN if never."""
    header = record.header
    if header.area_px is None or header.area_epsilon_um is None:
        return math.nan
    away_um = np.hypot(*(record.vessel_px - np.array(header.area_px)).T) * vessel.um_per_px
    inside = np.flatnonzero((away_um <= header.area_epsilon_um) & record.inside)
    return float(record.t_s[inside[0]]) if inside.size else math.nan
