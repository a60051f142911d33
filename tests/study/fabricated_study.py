"""Studies made up for tests: trials written by the real recorder, along real ways through a vessel."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np

from mrnav_server.autonomy.grid_graph import GridGraph
from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.tlx import KEYS, Choice
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.recorder import Recorder, RecorderConfig
from mrnav_server.loops.tlx_record import TlxAnswers, keep_tlx
from mrnav_server.loops.trial_log import Condition, OperatorKind, TrialHeader
from mrnav_server.vision.vessel_model import vessel_map

CONDITIONS: tuple[Condition, ...] = ("with_autonomy", "without_autonomy")
_SPEED_UM_PER_S: dict[Condition, float] = {"with_autonomy": 2300.0, "without_autonomy": 1700.0}
_WANDER_UM: dict[Condition, float] = {"with_autonomy": 60.0, "without_autonomy": 160.0}


def small_vessel(name: str = "bend") -> VesselMap:
    """A quarter of a ring, 10 mm long."""
    mask = np.zeros((500, 500), dtype=np.uint8)
    cv2.ellipse(mask, (60, 440), (310, 310), 0, 270, 360, 255, 160)
    return vessel_map(name, mask)


@dataclass(frozen=True)
class Way:
    """A way through a vessel: start, critical area, and the path between, in vessel pixels."""

    vessel: VesselMap
    start: VesselPoint
    area: VesselPoint

    def path_px(self) -> FloatArray:
        graph = GridGraph(self.vessel, clearance_weight=8.0, clearance_px=40.0)
        path = graph.path(self.start, self.area)
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
        even = np.linspace(0.0, along[-1], 600)
        path = np.stack([np.interp(even, along, axis) for axis in path.T], axis=1)
        kernel = np.hanning(61) / np.hanning(61).sum()
        smooth = [np.convolve(np.pad(axis, 30, "edge"), kernel, "valid") for axis in path.T]
        return np.stack(smooth, axis=1)


def small_way() -> Way:
    return Way(small_vessel(), VesselPoint(90.0, 130.0), VesselPoint(370.0, 420.0))


class Fabricator:
    """Writes one trial after the other.

    Args:
        root: Folder of the trials.
        seed: Everything is drawn from it.
        steps_per_frame: Lines of a size as the control loop writes them, for logs as long as real ones.
    """

    def __init__(self, root: Path, seed: int = 0, steps_per_frame: int = 0) -> None:
        self._steps_per_frame = steps_per_frame
        self._random = np.random.default_rng(seed)
        self._now_s = 100.0
        self._recorder = Recorder(
            root,
            lambda: self._now_s,
            RecorderConfig(min_free_mb=0.0),
            lambda: datetime(2026, 11, 22, 12, 0, tzinfo=UTC) + timedelta(seconds=self._now_s),
        )

    def study(
        self,
        ways: Sequence[Way],
        operators: int = 3,
        repetitions: int = 1,
        kind: OperatorKind = "simulated",
        code: str = "SIM",
    ) -> list[Path]:
        paths_px = [way.path_px() for way in ways]
        return [
            self.trial(way, path_px, f"{code}{who + 1:02d}", condition, kind, skill=1.0 + 0.1 * (who % 4))
            for who in range(operators)
            for _ in range(repetitions)
            for way, path_px in zip(ways, paths_px, strict=True)
            for condition in CONDITIONS
        ]

    def trial(
        self,
        way: Way,
        path_px: FloatArray,
        code: str,
        condition: Condition,
        kind: OperatorKind = "simulated",
        *,
        simulated_rig: bool = True,
        reached: bool = True,
        skill: float = 1.0,
    ) -> Path:
        """Record a trial: 1 s of rest, the way in one go, 1 s at its end."""
        vessel, record = way.vessel, self._recorder.record
        self._recorder.start_trial(_header(way, code, condition, kind, simulated_rig))
        steps_um = np.hypot(*np.diff(path_px, axis=0).T) * vessel.um_per_px
        along_um = np.concatenate([[0.0], np.cumsum(steps_um)])
        speed = _SPEED_UM_PER_S[condition] * skill * float(self._random.normal(1.0, 0.04))
        duration_s = float(along_um[-1]) / speed
        autonomous = condition == "with_autonomy"
        began_s = self._now_s
        record("trial", {"mark": "start", "t_s": began_s})
        before, frames = "DISARMED", round((duration_s + 2.0) * 30)
        wander_um = self._wander_um(frames, _WANDER_UM[condition])
        for frame in range(frames):
            self._now_s = began_s + frame / 30.0
            done = min(max((self._now_s - began_s - 1.0) / duration_s, 0.0), 1.0)
            if frame == 30:
                record("trial", {"mark": "go", "t_s": self._now_s})
            mode = "AUTO" if autonomous and done < 0.75 else "MANUAL"
            if mode != before:
                record("mode", {"before": before, "mode": mode, "reason": ""})
                before = mode
            # Ease in and out, as a person would.
            share = done - np.sin(2.0 * np.pi * done) / (2.0 * np.pi) * 0.3
            at_um = share * along_um[-1]
            place = np.array([np.interp(at_um, along_um, axis) for axis in path_px.T])
            place += wander_um[frame] / vessel.um_per_px * np.sin(np.pi * share)
            seen = place + self._random.normal(0.0, 0.3, 2)
            for step in range(self._steps_per_frame):
                record("step", {"now_s": self._now_s, "step": step, "reason": "x" * 200})
            record("command", {"sent_s": self._now_s, "target_um": [*(place * 10.0), 0.0], "mode": mode})
            record(
                "hand",
                {"received_s": self._now_s, "clutch": mode == "MANUAL" and done < 1.0, "new_pose": True},
            )
            record(
                "track",
                {
                    "taken_s": self._now_s,
                    "state": "tracking",
                    "vessel": seen.tolist(),
                    "sigma_um": 3.0,
                },
            )
        if reached:
            record("trial", {"mark": "reached", "t_s": self._now_s - 1.0})
        record("trial", {"mark": "end"})
        folder = asyncio.run(self._recorder.end_trial())
        assert folder is not None
        self._now_s += 5.0
        return folder

    def _wander_um(self, frames: int, size_um: float) -> FloatArray:
        """Return a slow way off the path and back, shape (frames, 2)."""
        t = np.arange(frames) / 30.0
        phase = self._random.uniform(0.0, 2.0 * np.pi, (3, 2))
        rate_hz = self._random.uniform(0.1, 0.5, (3, 2))
        wave = np.sin(2.0 * np.pi * rate_hz[:, None] * t[None, :, None] + phase[:, None])
        return np.asarray(wave.sum(axis=0) * size_um, dtype=np.float64)


def answer(folder: Path, mark: int) -> None:
    """Answer a trial's questionnaire: effort at a mark, the others lower, the first of every pair chosen."""
    ratings = {key: max(mark - 5 * rank, 0) for rank, key in enumerate(reversed(KEYS))}
    choices = tuple(Choice(left, right, left) for left, right in combinations(KEYS, 2))
    keep_tlx(folder.parent, folder.name, TlxAnswers(ratings, choices), 0.0)


def _header(
    way: Way, code: str, condition: Condition, kind: OperatorKind, simulated_rig: bool
) -> TrialHeader:
    vessel = way.vessel
    return TrialHeader(
        participant=code,
        condition=condition,
        operator_kind=kind,
        simulated_rig=simulated_rig,
        software_version="1.2.3",
        configuration_sha256="c0" * 32,
        vessel=vessel.name,
        vessel_sha256=vessel.digest,
        um_per_px=vessel.um_per_px,
        calibration={},
        start_px=(way.start.x_px, way.start.y_px),
        area_id="area-1",
        area_px=(way.area.x_px, way.area.y_px),
        area_epsilon_um=2500.0,
        policy_sha256="90" * 32,
        seeds={"sim": 7},
    )
