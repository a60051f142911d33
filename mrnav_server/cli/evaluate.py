"""`mrnav evaluate`: measure a policy on random start-target pairs."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

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
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on the last line.")
    ] = False,
) -> None:
    """Evaluate a policy: success with its 95 % interval, SPL, wall hits and steps (simulated)."""
    from mrnav_server.training.evaluate import evaluate as run_evaluation
    from mrnav_server.vision.model_store import find_model
    from mrnav_server.vision.vessel_model import load_vessel_model

    folder = find_model(model)
    vessel = load_vessel_model(folder)
    chosen = _find_policy(policy, folder, vessel)
    result = run_evaluation(chosen, vessel, pairs, "greedy" if greedy else "sample", seed)
    typer.echo(json.dumps(asdict(result)) if json_output else result.summary())


def _find_policy(policy: str | None, folder: Path, vessel: "VesselMap") -> "Policy":
    if policy == "geodesic":
        from mrnav_server.autonomy.geodesic_policy import GeodesicPolicy

        return GeodesicPolicy(vessel)
    from mrnav_server.autonomy.torchscript import load_policy

    return load_policy(Path(policy) if policy is not None else folder, vessel)
