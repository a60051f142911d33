"""A study on disk: its plan, and an append-only record of what was done (docs/study.md)."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import orjson

from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.loops.trial_log import read_trial
from mrnav_server.study.plan import Step, StudyPlan, parse_plan

PLAN_NAME = "plan.json"
PROGRESS_NAME = "progress.jsonl"
TRIALS_NAME = "trials"

StepStatus = Literal["waiting", "started", "done", "interrupted"]


def _now_wall() -> float:
    return datetime.now(UTC).timestamp()


@dataclass(frozen=True, slots=True)
class Progress:
    """What became of a step.

    Attributes:
        status: Interrupted steps are done again.
        trial: The trial that it is about; None without one.
        interrupted: How often it was interrupted.
    """

    status: StepStatus = "waiting"
    trial: str | None = None
    interrupted: int = 0


class StudyFolder:
    """A study that one process at a time leads.

    Args:
        folder: Holds a plan.
        wall_clock: Unix time in seconds, a label.

    Attributes:
        folder: The study's folder.
        plan: What is to be done.

    Raises:
        ConfigError: If plan or record cannot be read.
    """

    def __init__(self, folder: Path, wall_clock: Callable[[], float] = _now_wall) -> None:
        self.folder = folder
        self._wall_clock = wall_clock
        file = folder / PLAN_NAME
        try:
            self.plan: StudyPlan = parse_plan(orjson.loads(file.read_bytes()), str(file))
        except FileNotFoundError:
            raise ConfigError(f"{folder} is no study: make one with `mrnav study new {folder}`") from None
        except (OSError, orjson.JSONDecodeError) as error:
            raise ConfigError(f"{file} cannot be read ({error})") from None
        self._progress = dict.fromkeys((step.id for step in self.plan.steps), Progress())
        self._read()

    @classmethod
    def create(cls, folder: Path, plan: StudyPlan) -> "StudyFolder":
        """Write a new study.

        Raises:
            ConfigError: If the folder holds another study, or cannot be written.
        """
        file = folder / PLAN_NAME
        if file.exists():
            raise ConfigError(f"{folder} holds a study already: name another folder")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            part = file.with_suffix(".part")
            part.write_bytes(orjson.dumps(plan.fields(), option=orjson.OPT_INDENT_2) + b"\n")
            part.replace(file)
        except OSError as error:
            raise ConfigError(f"{folder} cannot be written ({error.strerror})") from None
        return cls(folder)

    @property
    def trials(self) -> Path:
        """Folder of the trials."""
        return self.folder / TRIALS_NAME

    @property
    def steps(self) -> tuple[Step, ...]:
        """What is to be done, in order."""
        return self.plan.steps

    @property
    def training_s(self) -> float:
        """Length of a training period in s."""
        return self.plan.training_s

    @property
    def next_step(self) -> Step | None:
        """The first step that is not done; None once all are."""
        return next((step for step in self.plan.steps if self.progress(step).status != "done"), None)

    def progress(self, step: Step) -> Progress:
        """Return what became of a step so far."""
        return self._progress[step.id]

    def recover(self) -> list[Step]:
        """Mark what a crash left open as interrupted, and return it; call it once, before leading."""
        left = [step for step in self.plan.steps if self._left_open(step)]
        for step in left:
            self.interrupt(step)
        return left

    def begin(self, step: Step, trial: str | None = None) -> None:
        """Note that a step was begun."""
        self._note(step, "started", trial)

    def finish(self, step: Step, trial: str | None = None) -> None:
        """Note that a step is done, with the trial that is its result."""
        self._note(step, "done", trial or self.progress(step).trial)

    def interrupt(self, step: Step) -> None:
        """Note that a step must be done again; its trial stays, and is no result."""
        self._note(step, "interrupted", self.progress(step).trial)

    def block_trial(self, step: Step) -> str | None:
        """Return the last finished trial of a step's block: the one that its questionnaire belongs to."""
        done = [
            self.progress(each).trial
            for each in self.plan.steps
            if (each.code, each.block, each.kind) == (step.code, step.block, "trial")
            and self.progress(each).status == "done"
        ]
        return done[-1] if done else None

    def _left_open(self, step: Step) -> bool:
        """Tell whether a step was begun and not finished, or its trial's log was never closed."""
        progress = self.progress(step)
        if progress.status != "done" or progress.trial is None or step.kind != "trial":
            return progress.status == "started"
        try:
            return read_trial(self.trials, progress.trial).status != "ended"
        except (ConfigError, RefusedError):
            return True  # no result without its log

    def _note(self, step: Step, status: StepStatus, trial: str | None) -> None:
        line = orjson.dumps(
            {"step": step.id, "status": status, "trial": trial, "t_wall": self._wall_clock()},
            option=orjson.OPT_APPEND_NEWLINE,
        )
        file = os.open(self.folder / PROGRESS_NAME, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        try:
            os.write(file, line)
            os.fsync(file)
        finally:
            os.close(file)
        self._take(step.id, status, trial)

    def _take(self, step_id: str, status: StepStatus, trial: str | None) -> None:
        before = self._progress[step_id]
        self._progress[step_id] = Progress(status, trial, before.interrupted + (status == "interrupted"))

    def _read(self) -> None:
        file = self.folder / PROGRESS_NAME
        if not file.exists():
            return
        content = file.read_bytes()
        if content and not content.endswith(b"\n"):
            # A crash may leave the last line unfinished; the next one must begin on a line of its own.
            content = content[: content.rfind(b"\n") + 1]
            os.truncate(file, len(content))
        for number, line in enumerate(content.splitlines(), start=1):
            try:
                entry = orjson.loads(line)
                self._take(entry["step"], entry["status"], entry["trial"])
            except (orjson.JSONDecodeError, KeyError, TypeError) as error:
                raise ConfigError(f"{file}, line {number}: not a line of this plan ({error!r})") from None
