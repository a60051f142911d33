"""`mrnav train`: train a policy for a vessel model."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from mrnav_server.core.errors import ConfigError

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from mrnav_server.training.progress import Report

STAGES = {
    "plan": "shortest paths",
    "clone": "cloning the planner",
    "reinforce": "reinforcement learning",
    "evaluate": "evaluation",
}


def train(
    model: Annotated[str, typer.Argument(help="Vessel model: a name or a folder.")],
    preset: Annotated[str, typer.Option(help="best, paper+ or paper.")] = "best",
    algo: Annotated[
        Literal["ppo", "a2c"], typer.Option(help="Reinforcement learning by PPO or A2C.")
    ] = "ppo",
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    assignments: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Change a hyper-parameter; may be repeated."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Where the policy goes; the model's folder if left out.")
    ] = None,
    resume: Annotated[
        Path | None, typer.Option(help="Go on with the interrupted training whose output folder this is.")
    ] = None,
    pairs: Annotated[int, typer.Option(min=1, help="Random pairs of each evaluation.")] = 500,
    tensorboard: Annotated[
        bool, typer.Option("--tensorboard", help="Write TensorBoard's files too.")
    ] = False,
    progress_lines: Annotated[
        bool, typer.Option("--progress", help="Print progress as JSON, a line each, in place of bars.")
    ] = False,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on the last line.")
    ] = False,
) -> None:
    """Train a navigation policy; write policy.pt, manifest.json, card.md, monitor.csv and checkpoint.pt.

    With --resume, preset, algorithm, seed and settings are those of the interrupted training.
    """
    from rich.console import Console
    from rich.progress import Progress

    from mrnav_server.training.train import resume as resume_training
    from mrnav_server.training.train import train as run_training
    from mrnav_server.vision.model_store import find_model

    if resume is not None and (assignments or out is not None):
        raise ConfigError("--resume goes on as it began, in its own folder: leave out --set and --out")
    folder = find_model(model)
    with Progress(console=Console(stderr=True), disable=progress_lines) as bars:
        show = _print_line if progress_lines else _Bars(bars).show
        if resume is not None:
            result = resume_training(folder, resume, show, pairs, tensorboard=tensorboard)
        else:
            result = run_training(
                *(folder, preset, seed, out, show, pairs),
                algorithm=algo,
                settings=assignments or (),
                tensorboard=tensorboard,
            )
    typer.echo(result.greedy.summary())
    typer.echo(result.sampled.summary())
    typer.echo(f"{result.identity.name} is in {result.folder} ({result.cpu_s:.0f} s of processor time)")
    if json_output:
        typer.echo(json.dumps(result.record()))


def _print_line(report: "Report") -> None:
    typer.echo(json.dumps(asdict(report)))


class _Bars:
    """One progress bar per stage, with the success rate beside it."""

    def __init__(self, bars: "Progress") -> None:
        self._bars = bars
        self._tasks: dict[str, TaskID] = {}

    def show(self, report: "Report") -> None:
        if report.stage not in self._tasks:
            self._tasks[report.stage] = self._bars.add_task(STAGES[report.stage], total=1.0)
        text = STAGES[report.stage]
        if report.success is not None:
            text += f", success {report.success:.1%} (simulated)"
        elif report.loss is not None:
            text += f", loss {report.loss:.3f}"
        self._bars.update(self._tasks[report.stage], completed=report.done, description=text)
