"""Part of a simulated study, done in a process of its own: one operator's trials on one vessel model.

Every finished trial leaves a file beside it, so that an interrupted part goes on with its next trial.
"""

import json
import shutil
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mrnav_server.cli.simulated_trial import SimulatedTrial
from mrnav_server.cli.virtual_trial import run_in_this_process
from mrnav_server.loops.priority import compute_in_calling_threads
from mrnav_server.study.plan import Step, StudyPlan
from mrnav_server.study.study_folder import StudyFolder
from mrnav_server.training.sweep_job import ERROR_FILE, RESULT_FILE

EPSILON_UM = 2500.0
"""Radius of the critical area."""
JOBS_NAME = "jobs"


@dataclass(frozen=True, slots=True)
class StudyJob:
    """One operator's trials on one vessel model.

    Attributes:
        study: The study's folder, absolute.
        code: The operator's code.
        model: The vessel model.
    """

    study: str
    code: str
    model: str

    def spec(self) -> dict[str, Any]:
        """Return all that its process must know."""
        return {"study": self.study, "code": self.code, "model": self.model}

    @property
    def name(self) -> str:
        """Name of its folder."""
        return f"{self.code}-{Path(self.model).name}"

    @property
    def title(self) -> str:
        """It in a few words."""
        return f"simulated operator {self.code}, {Path(self.model).name}"

    def steps(self, plan: StudyPlan) -> list[Step]:
        """Return what it does, in order."""
        return [step for step in plan.steps if (step.code, step.model) == (self.code, self.model)]


def jobs_of(study: StudyFolder) -> list[StudyJob]:
    """Return the parts of a study, operators innermost: those who work at once are different ones."""
    plan, place = study.plan, str(study.folder.absolute())
    return [StudyJob(place, code, model) for model in plan.models for code in plan.codes]


def finished_trial(folder: Path, step: Step) -> dict[str, Any] | None:
    """Return what a job's folder knows of a step's trial; None if it is not finished."""
    try:
        found: dict[str, Any] = json.loads((folder / f"{step.id}.json").read_text())
    except FileNotFoundError:
        return None
    return found


def run_study_job(spec: dict[str, Any], folder: Path) -> None:
    """Do a job's trials that are not finished, and leave the result, or the error, in its folder."""
    compute_in_calling_threads()
    job = StudyJob(**spec)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / ERROR_FILE).unlink(missing_ok=True)
    try:
        study = StudyFolder(Path(job.study))
        trials = {step.id: _trial(study, step, folder) for step in job.steps(study.plan)}
    except Exception:  # noqa: BLE001 - whatever ends a job is told, and the other jobs go on
        _write(folder / ERROR_FILE, traceback.format_exc())
        return
    _write(folder / RESULT_FILE, json.dumps({"spec": spec, "trials": trials}, indent=2))


def simulated_trial(plan: StudyPlan, step: Step) -> SimulatedTrial:
    """Return the trial of a step: who it is, and how often the operator did one before."""
    assert step.repetition is not None
    return SimulatedTrial(
        operator=1000 * plan.seed + plan.codes.index(step.code),
        repetition=step.repetition - 1,
        practice=plan.trials_before(step),
        condition=step.condition,
        model=step.model,
        epsilon_um=EPSILON_UM,
        code=step.code,
        notes=f"simulated study, seed {plan.seed}, step {step.id}",
    )


def _trial(study: StudyFolder, step: Step, folder: Path) -> dict[str, Any]:
    found = finished_trial(folder, step)
    if found is not None:
        return found
    root = folder / "running"
    shutil.rmtree(root, ignore_errors=True)
    # The server counts on from what it finds: no two trials of the study get the same id.
    (root / f"00000000-000000-{study.plan.steps.index(step):03d}-none").mkdir(parents=True)
    led = run_in_this_process(simulated_trial(study.plan, step), root)
    left = Path(led["ended"]["folder"])
    study.trials.mkdir(exist_ok=True)
    left.rename(study.trials / left.name)
    shutil.rmtree(root)
    found = {"trial": left.name, "completed": led["completed"], "reason": led["reason"]}
    _write(folder / f"{step.id}.json", json.dumps(found))
    return found


def _write(path: Path, text: str) -> None:
    """Write a file so that it is there whole or not at all."""
    draft = path.with_suffix(".draft")
    draft.write_text(text + "\n")
    draft.replace(path)
