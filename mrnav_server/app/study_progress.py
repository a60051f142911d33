"""A study as its leader sees it: what a plan and its record offer, and how far everybody is."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, Protocol

from mrnav_server.loops.trial_log import Condition


class StudyStep(Protocol):
    """One thing to do, as the plan has it."""

    @property
    def id(self) -> str:
        """Its name."""

    @property
    def code(self) -> str:
        """Who does it."""

    @property
    def kind(self) -> Literal["training", "trial", "questionnaire"]:
        """What it is."""

    @property
    def block(self) -> int:
        """First or second condition."""

    @property
    def condition(self) -> Condition:
        """With or without autonomy."""

    @property
    def model(self) -> str:
        """Vessel model."""

    @property
    def repetition(self) -> int | None:
        """From 1, for a trial."""


class StepProgress(Protocol):
    """What became of a step."""

    @property
    def status(self) -> Literal["waiting", "started", "done", "interrupted"]:
        """How far it is."""

    @property
    def trial(self) -> str | None:
        """Its trial."""

    @property
    def interrupted(self) -> int:
        """How often it was interrupted."""


class LedStudy(Protocol):
    """A plan and the record of what was done, on disk."""

    @property
    def trials(self) -> Path:
        """Folder of the trials."""

    @property
    def steps(self) -> Sequence[StudyStep]:
        """All of them, in order."""

    @property
    def training_s(self) -> float:
        """Length of a training period in s."""

    @property
    def next_step(self) -> StudyStep | None:
        """The first step that is not done."""

    def progress(self, step: Any) -> StepProgress:  # noqa: ANN401 - a step of this very study
        """Return what became of a step."""

    def block_trial(self, step: Any) -> str | None:  # noqa: ANN401 - see above
        """Return the trial that a questionnaire belongs to."""

    def begin(self, step: Any, trial: str | None = None) -> None:  # noqa: ANN401 - see above
        """Note that a step was begun."""

    def finish(self, step: Any, trial: str | None = None) -> None:  # noqa: ANN401 - see above
        """Note that a step is done."""

    def interrupt(self, step: Any) -> None:  # noqa: ANN401 - see above
        """Note that a step must be done again."""


def participants(study: LedStudy) -> list[dict[str, Any]]:
    """Return everybody in the order of coming, with how many of their steps are done and were interrupted."""
    found: dict[str, dict[str, Any]] = {}
    for step in study.steps:
        row = found.setdefault(step.code, {"code": step.code, "steps": 0, "done": 0, "interrupted": 0})
        progress = study.progress(step)
        row["steps"] += 1
        row["done"] += progress.status == "done"
        row["interrupted"] += progress.interrupted
    return list(found.values())


def own_steps(study: LedStudy, step: StudyStep | None) -> list[dict[str, Any]]:
    """Return the steps of the one whose turn it is, with what became of them; of the last one at the end."""
    code = (step or study.steps[-1]).code
    return [
        step_fields(each)
        | {"status": study.progress(each).status, "interrupted": study.progress(each).interrupted}
        for each in study.steps
        if each.code == code
    ]


def step_fields(step: StudyStep) -> dict[str, Any]:
    """Return a step, ready for JSON."""
    return {
        "id": step.id,
        "code": step.code,
        "kind": step.kind,
        "block": step.block,
        "condition": step.condition,
        "model": step.model,
        "repetition": step.repetition,
    }
