"""``mrnav study simulate``: a whole study of simulated operators, faster than real time."""

import json
import os
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mrnav_server.cli.study_plan import named_models
from mrnav_server.core.errors import ConfigError

if TYPE_CHECKING:
    from mrnav_server.cli.study_job import StudyJob
    from mrnav_server.study.plan import StudyPlan
    from mrnav_server.study.study_folder import StudyFolder
    from mrnav_server.training.sweep import Event, Events

_INTERRUPTED = 130


def simulate(
    folder: Annotated[Path, typer.Argument(help="The study's folder; the same command goes on.")],
    operators: Annotated[int, typer.Option("--participants", help="How many simulated operators.")] = 12,
    trials: Annotated[int, typer.Option(help="Trials of each model in each condition.")] = 2,
    seed: Annotated[int, typer.Option(help="Of the order, and of who the operators are.")] = 0,
    models: Annotated[
        list[str] | None, typer.Option(help="Vessel models, with commas or repeated; all if left out.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes at a time; one per processor if left out.")
    ] = None,
    ray: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Ray cluster to run on: host:port, or auto.")
    ] = None,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on the last line.")
    ] = False,
) -> None:
    """Run simulated operators through the real sockets in virtual time; no evidence about people."""
    from mrnav_server.study.plan import new_plan

    study = _study(folder, new_plan(operators, named_models(models), trials, seed, "simulated", 0.0))
    try:
        failed = _run(study, workers, ray)
    except KeyboardInterrupt:
        typer.echo("interrupted; the same command goes on", err=True)
        raise typer.Exit(_INTERRUPTED) from None
    steps = study.plan.steps
    done = sum(study.progress(step).status == "done" for step in steps)
    if json_output:
        typer.echo(
            json.dumps(
                {
                    "simulated": True,
                    "folder": str(folder),
                    "trials": len(steps),
                    "done": done,
                    "failed": failed,
                }
            )
        )
    else:
        typer.echo(f"{done} of {len(steps)} trials are done (simulated operators, no evidence about people)")
        typer.echo(f"  mrnav study report {folder}")
    if failed:
        raise typer.Exit(1)


def _study(folder: Path, plan: "StudyPlan") -> "StudyFolder":
    """Begin a study, or go on with the one that is there.

    Raises:
        ConfigError: If the folder holds another one.
    """
    from mrnav_server.study.study_folder import PLAN_NAME, StudyFolder

    if not (folder / PLAN_NAME).exists():
        return StudyFolder.create(folder, plan)
    study = StudyFolder(folder)
    if study.plan != plan:
        raise ConfigError(f"{folder} holds a study with other numbers: give the same ones, or another folder")
    return study


def _run(study: "StudyFolder", workers: int | None, ray: str | None) -> int:
    """Do what is left, with a bar; return how many parts failed."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from mrnav_server.cli.study_job import JOBS_NAME, jobs_of

    out = (study.folder / JOBS_NAME).absolute()
    jobs = jobs_of(study)
    for job in jobs:
        _harvest(study, job, out)
    study.recover()
    left = [job for job in jobs if any(study.progress(s).status != "done" for s in job.steps(study.plan))]
    columns = TextColumn("trials (simulated)"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    steps, failed = study.plan.steps, 0
    with Progress(*columns, console=Console(stderr=True)) as bars:
        bar = bars.add_task("", total=len(steps))

        def show() -> None:
            bars.update(bar, completed=sum(study.progress(step).status == "done" for step in steps))

        show()
        with closing(_events(left, out, workers, ray)) as events:
            for event in events:
                failed += event.kind == "failed"
                for line in _note(study, event, out):
                    bars.console.print(line, markup=False, highlight=False, soft_wrap=True)
                show()
    return failed


def _events(jobs: "list[StudyJob]", out: Path, workers: int | None, ray: str | None) -> "Events":
    from mrnav_server.cli.study_job import run_study_job

    if ray is None:
        from mrnav_server.training.sweep_pool import run_on_processes

        return run_on_processes(jobs, out, workers or os.cpu_count() or 1, run_study_job)
    from mrnav_server.training.sweep_ray import connect, run_on_ray

    connect(ray)
    return run_on_ray(jobs, out, run_study_job)


def _note(study: "StudyFolder", event: "Event", out: Path) -> list[str]:
    """Keep what an event means for the study; return what to tell."""
    from mrnav_server.cli.study_job import StudyJob

    job = StudyJob(**event.job.spec())
    told = _harvest(study, job, out)
    if event.kind == "started":
        for step in job.steps(study.plan):
            if study.progress(step).status != "done":
                study.begin(step)
    if event.kind in ("lost", "failed"):
        told.append(f"{event.kind}: {job.title}: {event.text}")
        for step in job.steps(study.plan):
            if study.progress(step).status == "started":
                study.interrupt(step)
    return told


def _harvest(study: "StudyFolder", job: "StudyJob", out: Path) -> list[str]:
    """Note the trials that a job has finished; return what went wrong in them."""
    from mrnav_server.cli.study_job import finished_trial

    told = []
    for step in job.steps(study.plan):
        found = finished_trial(out / job.name, step)
        if found is not None and study.progress(step).status != "done":
            study.finish(step, found["trial"])
            if not found["completed"]:
                told.append(f"{step.id}: {found['trial']}: {found['reason']}")
    return told
