"""`mrnav map`: vessel models."""

from pathlib import Path
from typing import Annotated

import typer


def generate(
    name: Annotated[str, typer.Argument(help="bifurcation, serpentine or network.")],
    out: Annotated[Path | None, typer.Option(help="The model's folder; ./NAME if left out.")] = None,
) -> None:
    """Draw a synthetic vessel model and write its mask.png and model.json."""
    from mrnav_server.training.vessels import generate as draw_model

    folder = out if out is not None else Path(name)
    model = draw_model(name, folder)
    typer.echo(f"{name}: {model.size_px} x {model.size_px} px of {model.um_per_px:g} µm in {folder}")
