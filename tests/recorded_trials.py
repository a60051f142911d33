"""Trials on disk as the rig records them, made in no time: a robot goes along a shipped vessel."""

import asyncio
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from mrnav_server.autonomy.grid_graph import GridGraph
from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.records import Track, TrackState
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.recorder import Recorder, RecorderConfig
from mrnav_server.loops.trial_fields import track_fields
from mrnav_server.loops.trial_log import Condition, OperatorKind, TrialHeader
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model

BEGIN_S, GO_S, REACHED_S, END_S = 50.0, 51.0, 63.0, 64.0
HANDOVER_S = 59.0


@cache
def shipped_vessel() -> VesselMap:
    return load_vessel_model(find_model("bifurcation"))


@cache
def way_px() -> FloatArray:
    """Return the shortest way between two suggested areas, shape (n, 2)."""
    start, target = shipped_vessel().suggested_areas[:2]
    return np.asarray(GridGraph(shipped_vessel(), reach=5).path(start, target), dtype=np.float64)


@dataclass(frozen=True)
class RecordedTrial:
    """Who did what; ``sway_px`` to and fro across the way makes wall contacts."""

    participant: str = "P01"
    condition: Condition = "with_autonomy"
    operator_kind: OperatorKind = "human"
    simulated_rig: bool = True
    reached: bool = True
    sway_px: float = 0.0
    notes: str = ""

    def header(self) -> TrialHeader:
        vessel, way = shipped_vessel(), way_px()
        return TrialHeader(
            participant=self.participant,
            condition=self.condition,
            operator_kind=self.operator_kind,
            simulated_rig=self.simulated_rig,
            software_version="0.1.0",
            configuration_sha256="c0",
            vessel=vessel.name,
            vessel_sha256=vessel.digest,
            um_per_px=vessel.um_per_px,
            calibration={},
            start_px=(float(way[0, 0]), float(way[0, 1])),
            area_id="area-1",
            area_px=(float(way[-1, 0]), float(way[-1, 1])),
            area_epsilon_um=500.0,
            notes=self.notes,
        )

    def tracks(self) -> Iterator[Track]:
        """Return what the tracker saw: a rest, one minimum-jerk motion, a rest; noise of 3 µm."""
        way = way_px()
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
        rng = np.random.default_rng(4)
        for frame in range(round((END_S - BEGIN_S) * 30)):
            now_s = BEGIN_S + frame / 30
            u = min(max((now_s - GO_S) / (REACHED_S - GO_S), 0.0), 1.0)
            share = along[-1] * (10 * u**3 - 15 * u**4 + 6 * u**5)
            place = np.array([np.interp(share, along, way[:, 0]), np.interp(share, along, way[:, 1])])
            place += rng.normal(0.0, 0.3, 2) + self.sway_px * np.sin(12.0 * u) * np.sin(np.pi * u)
            yield Track(
                now_s, frame, TrackState.TRACKING, None, VesselPoint(*place.tolist()), 0.9, 3.0, frame
            )

    def record(self, root: Path, *, close: bool = True) -> Path:
        """Write the log; return the trial's folder."""
        now_s = BEGIN_S
        recorder = Recorder(root, lambda: now_s, RecorderConfig(min_free_mb=0.0))
        trial_id = recorder.start_trial(self.header())
        autonomy = self.condition == "with_autonomy"
        recorder.record("mode", {"mode": "AUTO" if autonomy else "MANUAL", "reason": ""})
        for track in self.tracks():
            now_s = track.taken_s
            if track.frame_number == round((GO_S - BEGIN_S) * 30):
                recorder.record("trial", {"mark": "go", "t_s": GO_S})
            if autonomy and track.frame_number == round((HANDOVER_S - BEGIN_S) * 30):
                recorder.record("mode", {"mode": "MANUAL", "reason": ""})
            recorder.record("track", track_fields(track))
        if self.reached:
            recorder.record("trial", {"mark": "reached", "t_s": REACHED_S})
        if close:
            recorder.record("trial", {"mark": "end"})
            asyncio.run(recorder.end_trial())
        return root / trial_id
