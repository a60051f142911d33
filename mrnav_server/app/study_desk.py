"""Leads the experimenter through a study: training period, trial, questionnaire, next."""

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, Protocol

from mrnav_server.app.rig_port import Trials
from mrnav_server.core.errors import RefusedError
from mrnav_server.loops.tlx_record import read_tlx
from mrnav_server.loops.trial_log import Condition, read_trial, trial_folder


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


class StudyDesk:
    """Begins and ends a study's steps; the record on disk is all that it knows, so a crash loses nothing.

    Args:
        study: Plan and record.
        vessel: The vessel model that this server runs with, as the settings name it.
        trials: Begins and ends trials.
        clock: Monotonic time in seconds.
    """

    def __init__(self, study: LedStudy, vessel: str, trials: Trials, clock: Callable[[], float]) -> None:
        self._study = study
        self._vessel = vessel
        self._trials = trials
        self._clock = clock
        self._began_s = 0.0
        self._busy = asyncio.Lock()

    def state(self) -> dict[str, Any]:
        """Describe where the study stands and what the experimenter does next."""
        study, step = self._study, self._study.next_step
        done = sum(study.progress(each).status == "done" for each in study.steps)
        found: dict[str, Any] = {"steps": len(study.steps), "done": done, "step": None, "doing": False}
        if step is None:
            return found | {"say": "All is done: mrnav study report writes the report."}
        progress = study.progress(step)
        doing = progress.status == "started"
        found |= {
            "step": _fields(step),
            "doing": doing,
            "again": progress.status == "interrupted",
            "trial": study.block_trial(step) if step.kind == "questionnaire" else progress.trial,
            "say": self._doing(step) if doing else self._asking(step),
        }
        if doing and step.kind == "training":
            found["left_s"] = max(0.0, round(study.training_s - (self._clock() - self._began_s), 1))
        return found

    async def next(self) -> dict[str, Any]:
        """Begin the next step.

        Raises:
            RefusedError: While one is under way, at the study's end, or with the wrong vessel.
        """
        async with self._busy:
            study, step = self._study, self._study.next_step
            if step is None:
                raise RefusedError("study_done", "every step of the plan is done")
            if study.progress(step).status == "started":
                raise RefusedError("step_running", f"{step.id} is under way: finish or interrupt it first")
            if step.kind != "questionnaire" and step.model != self._vessel:
                raise RefusedError("other_vessel", self._asking(step))
            trial: str | None = None
            if step.kind == "trial":
                notes = f"study step {step.id}"
                trial = self._trials.start(step.code, step.condition, "human", notes)["id"]
            self._began_s = self._clock()
            await asyncio.to_thread(study.begin, step, trial)
            return self.state()

    async def finish(self) -> dict[str, Any]:
        """End the step that is under way; its trial is a result.

        Raises:
            RefusedError: Without one, or if its questionnaire is not answered.
        """
        async with self._busy:
            step = self._under_way()
            if step.kind == "questionnaire":
                await self._require_answers(step)
            # Noted first: the trial's report takes seconds, and a log that was never closed is no result.
            await asyncio.to_thread(self._study.finish, step)
            if step.kind == "trial":
                await self._end_trial(step)
            return self.state()

    async def interrupt(self) -> dict[str, Any]:
        """Give up the step that is under way; it is done again, and its trial is no result.

        Raises:
            RefusedError: Without one.
        """
        async with self._busy:
            step = self._under_way()
            await asyncio.to_thread(self._study.interrupt, step)
            if step.kind == "trial":
                await self._end_trial(step)
            return self.state()

    def _under_way(self) -> StudyStep:
        step = self._study.next_step
        if step is None or self._study.progress(step).status != "started":
            raise RefusedError("no_step", "no step is under way: begin the next one")
        return step

    async def _end_trial(self, step: StudyStep) -> None:
        """End a step's trial; one that was ended elsewhere stays as it is."""
        trial = self._study.progress(step).trial
        if trial is None:
            raise RefusedError("no_such_trial", f"{step.id} has no trial: interrupt it")
        if (await asyncio.to_thread(read_trial, self._study.trials, trial)).status == "running":
            await self._trials.end(trial)

    async def _require_answers(self, step: StudyStep) -> None:
        trial = self._study.block_trial(step)
        if trial is None:
            raise RefusedError(
                "no_such_trial", f"no trial of {step.code} is there to ask about: interrupt it"
            )
        if await asyncio.to_thread(read_tlx, trial_folder(self._study.trials, trial)) is None:
            raise RefusedError("no_tlx", f"the questionnaire is not answered yet: /tlx?trial={trial}")

    def _asking(self, step: StudyStep) -> str:
        """Return what the experimenter prepares."""
        if step.kind == "questionnaire":
            return f"Ask {step.code} to sit down for the questionnaire."
        if step.model != self._vessel:
            return (
                f"Put vessel {step.model} under the microscope, end this server and start it again with"
                " the same --study: it takes up the study there."
            )
        how = step.condition.replace("_", " ")
        if step.kind == "training":
            return f"Let {step.code} train {how} for {self._study.training_s / 60.0:g} min."
        return f"Mark the critical area; then {step.code} does trial {step.repetition} {how}."

    def _doing(self, step: StudyStep) -> str:
        if step.kind == "questionnaire":
            return f"{step.code} answers the questionnaire; then finish."
        if step.kind == "training":
            return f"{step.code} trains; then finish."
        return f"{step.code} does the trial; finish it at the target, or interrupt it."


def _fields(step: StudyStep) -> dict[str, Any]:
    return {
        "id": step.id,
        "code": step.code,
        "kind": step.kind,
        "block": step.block,
        "condition": step.condition,
        "model": step.model,
        "repetition": step.repetition,
    }
