"""`mrnav evaluate`: measure a policy on random start-target pairs."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mrnav_server.core.errors import ConfigError

if TYPE_CHECKING:
    from mrnav_server.autonomy.policy import Policy
    from mrnav_server.core.vessel import VesselMap


def evaluate(
    model: Annotated[str, typer.Argument(help="Vessel model: a name or a folder.")],
    policy: Annotated[
        str | None, typer.Option(help="A policy's folder, or geodesic; the model's own policy if left out.")
    ] = None,
    pairs: Annotated[int, typer.Option(min=1, help="Number of random pairs.")] = 500,
    greedy: Annotated[
        bool, typer.Option("--greedy/--sample", help="Best action, or drawn as published.")
    ] = True,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the pairs and of the draws.")] = 0,
    noise_px: Annotated[
        float, typer.Option(min=0.0, max=100.0, help="Noise on the seen position, in pixels.")
    ] = 0.0,
    delay: Annotated[
        int, typer.Option(min=0, max=100, help="The policy sees the position of so many steps ago.")
    ] = 0,
    scale: Annotated[
        float, typer.Option(min=0.1, max=10.0, help="Length of a move over what it should be.")
    ] = 1.0,
    robustness: Annotated[
        bool, typer.Option("--robustness", help="The table: noise, delay and scale, greedy and sampled.")
    ] = False,
    failures: Annotated[
        Path | None, typer.Option(help="Draw the failed pairs over the vessel into this PNG.")
    ] = None,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on the last line.")
    ] = False,
) -> None:
    """Evaluate a policy: success with its 95 % interval, SPL, wall hits and steps (simulated)."""
    from mrnav_server.training.evaluate import Task
    from mrnav_server.training.robustness import markdown
    from mrnav_server.training.robustness import robustness as run_robustness
    from mrnav_server.training.rollout import Disturbance, Trace
    from mrnav_server.vision.model_store import find_model
    from mrnav_server.vision.vessel_model import load_vessel_model

    world = Disturbance(noise_px, delay, scale)
    if robustness and not (world.none and failures is None):
        raise ConfigError("--robustness is a table of its own: leave out noise, delay, scale and failures")
    folder = find_model(model)
    vessel = load_vessel_model(folder)
    chosen = _find_policy(policy, folder, vessel)
    task = Task.draw(vessel, pairs, seed)
    mode: Any = "greedy" if greedy else "sample"
    if robustness:
        rows = run_robustness(chosen, task)
        typer.echo(markdown(rows), err=json_output)
        answer = next(row for row in rows if row.mode == mode).record()
        answer["rows"] = [row.record() for row in rows]
    else:
        trace = Trace() if failures is not None else None
        result, runs = task.run(chosen, mode, world, trace=trace)
        answer = result.record()
        typer.echo(result.summary(), err=json_output)
        if failures is not None and trace is not None:
            from mrnav_server.training.failures import failures_figure

            failures_figure(task, result, runs, trace).savefig(failures, dpi=110)
            typer.echo(f"{(~runs.arrived).sum()} failed pairs are drawn in {failures}", err=json_output)
    if json_output:
        typer.echo(json.dumps(answer))


def _find_policy(policy: str | None, folder: Path, vessel: "VesselMap") -> "Policy":
    if policy == "geodesic":
        from mrnav_server.autonomy.geodesic_policy import GeodesicPolicy

        return GeodesicPolicy(vessel)
    from mrnav_server.autonomy.torchscript import load_policy

    return load_policy(Path(policy) if policy is not None else folder, vessel)
