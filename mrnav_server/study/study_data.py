"""A recorded study as a report reads it: its finished trials, measured from their logs."""

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mrnav_server.autonomy.grid_graph import GridGraph
from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.core.handover_metrics import HandoverMetrics
from mrnav_server.core.metrics import TrialMetrics, trial_motions
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.tlx_record import TlxAnswers, read_tlx
from mrnav_server.loops.trial_log import LOG_NAME, OperatorKind, TrialHeader, TrialInfo, list_trials
from mrnav_server.study.study_folder import PLAN_NAME, TRIALS_NAME, StudyFolder
from mrnav_server.study.trial_handover import trial_handover
from mrnav_server.study.trial_record import read_trial_record
from mrnav_server.study.trial_report import measured, route_graph
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model

_SAME_PLACE_UM = 1000.0


@dataclass(frozen=True)
class StudyTrial:
    """One finished trial.

    Attributes:
        id: Its id.
        header: Its log's first line.
        task: Vessel model and place to go to, by name.
        metrics: Its metrics.
        handover: How it was handed over; None if it was not, and the critical area was not entered.
        answers: What the participant answered after it; None without a questionnaire.
        path_um: Filtered path in the vessel's grid, shape (n, 2).
        log_sha256: Digest of its log.
    """

    id: str
    header: TrialHeader
    task: str
    metrics: TrialMetrics
    handover: HandoverMetrics | None
    answers: TlxAnswers | None
    path_um: FloatArray
    log_sha256: str

    @property
    def reached(self) -> bool:
        """Whether the target was reached."""
        return not math.isnan(self.metrics.completion_s)


@dataclass(frozen=True)
class Study:
    """A study's finished trials, all of one kind.

    Attributes:
        folder: Where it was read from.
        trials: Oldest first.
        left_out: Other trials' ids, and why they are no results.
        vessels: The vessel models by name.
    """

    folder: Path
    trials: tuple[StudyTrial, ...]
    left_out: tuple[tuple[str, str], ...]
    vessels: dict[str, VesselMap]

    @property
    def operator_kind(self) -> OperatorKind:
        """Of all trials."""
        return self.trials[0].header.operator_kind

    @property
    def simulated(self) -> bool:
        """Whether operators or rig were simulated."""
        return self.operator_kind == "simulated" or self.trials[0].header.simulated_rig

    @property
    def operators(self) -> tuple[str, ...]:
        """Their codes, sorted."""
        return tuple(sorted({trial.header.participant for trial in self.trials}))

    @property
    def people(self) -> str:
        """What the operators are called; a simulated one is never a participant."""
        return "simulated operators" if self.operator_kind == "simulated" else "participants"

    @property
    def origin(self) -> str:
        """What a reader must be told of where the figures come from."""
        if self.operator_kind == "simulated":
            return "simulated operators on a simulated rig: no evidence about people"
        return f"participants on {'a simulated rig' if self.simulated else 'hardware'}"

    @property
    def mark(self) -> str:
        """What is written across every figure; "" for people on hardware."""
        if self.operator_kind == "simulated":
            return "simulated"
        return "simulated rig" if self.simulated else ""


def read_study(
    folder: Path,
    operators: OperatorKind | None = None,
    find_vessel: Callable[[str], VesselMap] | None = None,
    on_trial: Callable[[int, int], None] = lambda done, total: None,
) -> Study:
    """Read and measure a study's finished trials.

    Args:
        folder: The study's folder, or any folder of trials.
        operators: Which kind's trials to read; needed where a folder holds both.
        find_vessel: Gives a vessel model by its name; the installed ones if left out.
        on_trial: Told how many trials of how many are measured.

    Raises:
        ConfigError: If there is nothing to report, or human and simulated would be pooled.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder} is no folder: name a study's folder, or one that holds trials")
    root = folder / TRIALS_NAME if (folder / TRIALS_NAME).is_dir() else folder
    infos, left_out = _finished(folder, list_trials(root))
    if operators is not None:
        infos = [info for info in infos if info.header.operator_kind == operators]
    if not infos:
        said = f" of {operators} operators" if operators else ""
        raise ConfigError(f"{root} holds no finished trial{said}: nothing to report")
    _refuse_pooling(infos)
    find_vessel = find_vessel or _bundled
    vessels = {name: find_vessel(name) for name in sorted({info.header.vessel for info in infos})}
    routes = {name: route_graph(vessel) for name, vessel in vessels.items()}
    tasks = _Tasks()
    trials = []
    for done, info in enumerate(infos, start=1):
        name = info.header.vessel
        try:
            trials.append(
                _study_trial(root / info.id, info, vessels[name], routes[name], tasks.name(info.header))
            )
        except RefusedError as error:
            left_out.append((info.id, str(error)))
        on_trial(done, len(infos))
    if len({trial.header.condition for trial in trials}) != 2:
        raise ConfigError(f"{root}: trials of both conditions are needed, with and without autonomy")
    return Study(folder, tuple(trials), tuple(left_out), vessels)


def _bundled(name: str) -> VesselMap:
    return load_vessel_model(find_model(name))


def _study_trial(
    folder: Path, info: TrialInfo, vessel: VesselMap, routes: GridGraph, task: str
) -> StudyTrial:
    record = read_trial_record(folder)
    if info.header.vessel_sha256 != vessel.digest:
        raise RefusedError("other_vessel", f"made with another mask of {vessel.name} than the one at hand")
    questionnaire = read_tlx(folder)
    motions = trial_motions(record.t_s, record.vessel_px * vessel.um_per_px, record.go_s, record.end_s)
    return StudyTrial(
        id=info.id,
        header=info.header,
        task=task,
        metrics=measured(record, record.clearance_um(vessel), vessel, routes),
        handover=trial_handover(folder, record, vessel),
        answers=questionnaire.answers if questionnaire else None,
        path_um=np.concatenate([motion.xy_um for motion in motions] or [np.empty((0, 2))]),
        log_sha256=hashlib.sha256((folder / LOG_NAME).read_bytes()).hexdigest(),
    )


class _Tasks:
    """Names of the tasks: the vessel model's, numbered where its trials went to different places."""

    def __init__(self) -> None:
        self._places_px: dict[str, list[tuple[float, float] | None]] = {}

    def name(self, header: TrialHeader) -> str:
        places_px = self._places_px.setdefault(header.vessel, [])
        number = next((n for n, place_px in enumerate(places_px) if _same(header, place_px)), len(places_px))
        if number == len(places_px):
            places_px.append(header.area_px)
        return header.vessel if number == 0 else f"{header.vessel}, place {number + 1}"


def _same(header: TrialHeader, place_px: tuple[float, float] | None) -> bool:
    if header.area_px is None or place_px is None:
        return header.area_px is place_px
    return math.dist(header.area_px, place_px) * header.um_per_px <= _SAME_PLACE_UM


def _finished(folder: Path, infos: list[TrialInfo]) -> tuple[list[TrialInfo], list[tuple[str, str]]]:
    """Return the trials that are results, and the others with the reason why not."""
    results = _results(folder)
    finished: list[TrialInfo] = []
    left_out: list[tuple[str, str]] = []
    for info in infos:
        if info.status != "ended":
            left_out.append((info.id, info.status))
        elif results is not None and info.id not in results:
            left_out.append((info.id, "not a result of the plan: training, or done again"))
        else:
            finished.append(info)
    return finished, left_out


def _results(folder: Path) -> set[str | None] | None:
    """Return the trials that a plan's steps ended with; None without a plan."""
    if not (folder / PLAN_NAME).is_file():
        return None
    study = StudyFolder(folder)
    progress = [study.progress(step) for step in study.plan.steps if step.kind == "trial"]
    return {each.trial for each in progress if each.status == "done"}


def _refuse_pooling(infos: list[TrialInfo]) -> None:
    kinds = [info.header.operator_kind for info in infos]
    if len(set(kinds)) > 1:
        raise ConfigError(
            f"{kinds.count('human')} trials are of people and {kinds.count('simulated')} of simulated"
            " operators, which are never pooled: choose with --operators human or --operators simulated"
        )
    if len({info.header.simulated_rig for info in infos}) > 1:
        raise ConfigError(
            "some trials were done on hardware and some on the simulated rig, which are never pooled:"
            " keep them in folders of their own"
        )
