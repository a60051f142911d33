"""Leads the experimenter through a study: training period, trial, questionnaire, next."""

import asyncio
from collections.abc import Callable
from typing import Any

from mrnav_server.app.rig_port import Trials
from mrnav_server.app.study_progress import LedStudy, StudyStep, own_steps, participants, step_fields
from mrnav_server.core.errors import RefusedError
from mrnav_server.loops.tlx_record import read_tlx
from mrnav_server.loops.trial_log import read_trial, trial_folder


class StudyDesk:
    """Begins and ends a study's steps; the record on disk is all that it knows, so a crash loses nothing.

    Args:
        study: Plan and record.
        vessel: The vessel model that this server runs with, as the settings name it.
        trials: Begins and ends trials.
        has_target: Tells whether a critical area is marked.
        clock: Monotonic time in seconds.
    """

    def __init__(
        self,
        study: LedStudy,
        vessel: str,
        trials: Trials,
        has_target: Callable[[], bool],
        clock: Callable[[], float],
    ) -> None:
        self._study = study
        self._vessel = vessel
        self._trials = trials
        self._has_target = has_target
        self._clock = clock
        self._began_s = 0.0
        self._busy = asyncio.Lock()

    async def state(self) -> dict[str, Any]:
        """Describe where the study stands, what the experimenter does next, and what hinders it."""
        study, step = self._study, self._study.next_step
        found: dict[str, Any] = {
            "steps": len(study.steps),
            "done": sum(study.progress(each).status == "done" for each in study.steps),
            "participants": participants(study),
            "own": own_steps(study, step),
            "vessel": self._vessel,
            "step": None,
            "doing": False,
            "refusal": "",
            "other_vessel": None,
        }
        if step is None:
            return found | {"say": "All is done. mrnav study report writes the report."}
        progress = study.progress(step)
        doing = progress.status == "started"
        found |= {
            "step": step_fields(step),
            "doing": doing,
            "again": progress.status == "interrupted",
            "trial": study.block_trial(step) if step.kind == "questionnaire" else progress.trial,
            "say": self._doing(step) if doing else self._asking(step),
            "refusal": "" if doing else self._refusal(step)[1],
            "other_vessel": None if doing or not self._needs_other_vessel(step) else step.model,
        }
        if doing and step.kind == "training":
            found["left_s"] = max(0.0, round(study.training_s - (self._clock() - self._began_s), 1))
        if step.kind == "questionnaire":
            found["answered"] = await self._answered(step)
        return found

    def results(self) -> frozenset[str]:
        """Return the trials that are results; all others were interrupted, or still run."""
        done = (self._study.progress(step) for step in self._study.steps if step.kind == "trial")
        return frozenset(each.trial for each in done if each.status == "done" and each.trial is not None)

    def require_own_trials(self) -> None:
        """Refuse trials that the plan does not know: their participant or condition would be anybody's.

        Raises:
            RefusedError: Always.
        """
        step = self._study.next_step
        due = f"{step.id} is due" if step is not None else "every step of the plan is done"
        raise RefusedError(
            "study_leads", f"this server leads a study ({due}): begin its trials as steps of the study"
        )

    @property
    def under_way(self) -> bool:
        """Whether a step is under way."""
        step = self._study.next_step
        return step is not None and self._study.progress(step).status == "started"

    def next_vessel(self) -> str:
        """Return the vessel model that the next step needs in the place of the one in use.

        Raises:
            RefusedError: If it needs no other one.
        """
        step = self._study.next_step
        if step is None or not self._needs_other_vessel(step):
            raise RefusedError("same_vessel", "the next step needs no other vessel")
        return step.model

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
            code, why = self._refusal(step)
            if code:
                raise RefusedError(code, why)
            trial: str | None = None
            if step.kind == "trial":
                notes = f"study step {step.id}"
                trial = self._trials.start(step.code, step.condition, "human", notes)["id"]
            self._began_s = self._clock()
            await asyncio.to_thread(study.begin, step, trial)
            return await self.state()

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
            return await self.state()

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
            return await self.state()

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
        if not await self._answered(step):
            raise RefusedError("no_tlx", f"the questionnaire is not answered yet: /tlx?trial={trial}")

    async def _answered(self, step: StudyStep) -> bool:
        """Tell whether a questionnaire is answered."""
        trial = self._study.block_trial(step)
        if trial is None:
            return False
        return await asyncio.to_thread(read_tlx, trial_folder(self._study.trials, trial)) is not None

    def _refusal(self, step: StudyStep) -> tuple[str, str]:
        """Return why a step cannot begin yet, as a code and in plain words; twice "" if it can."""
        if self._needs_other_vessel(step):
            return "other_vessel", f"This server goes by vessel {self._vessel}; {step.model} is needed."
        if step.kind == "trial" and not self._has_target():
            return "no_area", "Mark the critical area on the picture first: a trial needs a target."
        return "", ""

    def _needs_other_vessel(self, step: StudyStep) -> bool:
        return step.kind != "questionnaire" and step.model != self._vessel

    def _asking(self, step: StudyStep) -> str:
        """Return what the experimenter prepares."""
        if step.kind == "questionnaire":
            return f"Ask {step.code} to sit down for the questionnaire."
        if self._needs_other_vessel(step):
            return f"Put vessel {step.model} under the microscope."
        how = step.condition.replace("_", " ")
        if step.kind == "training":
            return f"Let {step.code} train {how} for {self._study.training_s / 60.0:g} min."
        return f"{step.code} does trial {step.repetition} {how}."

    def _doing(self, step: StudyStep) -> str:
        if step.kind == "questionnaire":
            return f"{step.code} answers the questionnaire."
        if step.kind == "training":
            return f"{step.code} trains {step.condition.replace('_', ' ')}."
        return f"{step.code} does the trial. End it at the target, or give it up."
