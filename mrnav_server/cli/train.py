"""`mrnav train`: train a policy for a vessel model."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

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
    preset: Annotated[str, typer.Option(help="best, paper+, paper or a2c.")] = "best",
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Where the policy goes; the model's folder if left out.")
    ] = None,
    pairs: Annotated[int, typer.Option(min=1, help="Random pairs of each evaluation.")] = 500,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on the last line.")
    ] = False,
) -> None:
    """Train a navigation policy and write policy.pt, manifest.json and card.md."""
    from rich.console import Console
    from rich.progress import Progress

    from mrnav_server.training.train import train as run_training
    from mrnav_server.vision.model_store import find_model

    folder = find_model(model)
    with Progress(console=Console(stderr=True)) as bars:
        result = run_training(folder, preset, seed, out, _Bars(bars).show, pairs)
    if json_output:
        answer = asdict(result)
        answer["folder"] = str(result.folder)
        del answer["curve"]
        typer.echo(json.dumps(answer))
    else:
        typer.echo(result.greedy.summary())
        typer.echo(result.sampled.summary())
        typer.echo(f"{result.identity.name} is in {result.folder} ({result.cpu_s:.0f} s of processor time)")


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
