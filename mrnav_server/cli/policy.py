"""`mrnav policy`: policies from elsewhere."""

import json
from pathlib import Path
from typing import Annotated

import typer

policies = typer.Typer(no_args_is_help=True, help="Policies.")


@policies.callback()
def _group() -> None:
    """Policies."""


@policies.command("import")
def import_policy(
    sb3: Annotated[
        Path,
        typer.Option(help="PPO or A2C model saved by Stable-Baselines3; loading it runs code that it holds."),
    ],
    model: Annotated[str, typer.Option(help="Vessel model that it was trained on: a name or a folder.")],
    out: Annotated[Path, typer.Option(help="Where the policy goes.")],
    pairs: Annotated[int, typer.Option(min=1, help="Random pairs of each evaluation.")] = 500,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on the last line.")
    ] = False,
) -> None:
    """Turn a policy of Stable-Baselines3 into policy.pt, manifest.json and card.md."""
    from mrnav_server.training.sb3_import import import_sb3
    from mrnav_server.vision.model_store import find_model

    identity, greedy, sampled = import_sb3(sb3, find_model(model), out, pairs)
    typer.echo(greedy.summary())
    typer.echo(sampled.summary())
    typer.echo(f"{identity.name} is in {out}; its answers equal the original's")
    if json_output:
        typer.echo(json.dumps(greedy.record() | {"folder": str(out), "sampled": sampled.record()}))
