"""`mrnav map`: vessel models."""

from pathlib import Path
from typing import Annotated

import typer

from mrnav_server.cli.map_import import import_model
from mrnav_server.cli.map_show import show
from mrnav_server.core.errors import ConfigError

models = typer.Typer(no_args_is_help=True, help="Vessel models.")


@models.command()
def generate(
    name: Annotated[str, typer.Argument(help="bifurcation, serpentine, network or random.")],
    seed: Annotated[int | None, typer.Option(min=0, help="Which random network.")] = None,
    out: Annotated[Path | None, typer.Option(help="The model's folder; ./NAME if left out.")] = None,
) -> None:
    """Draw a synthetic vessel model and write its mask.png and model.json."""
    from mrnav_server.training.random_vessels import generate_random
    from mrnav_server.training.vessels import generate as draw_model

    if name == "random":
        if seed is None:
            raise ConfigError("random networks are told apart by their seed: add --seed N")
        folder = out if out is not None else Path(f"random-{seed}")
        model = generate_random(seed, folder)
    elif seed is not None:
        raise ConfigError(f"{name} is always the same: leave out --seed, or name random")
    else:
        folder = out if out is not None else Path(name)
        model = draw_model(name, folder)
    typer.echo(f"{model.name}: {model.size_px} x {model.size_px} px of {model.um_per_px:g} µm in {folder}")


models.command("import")(import_model)
models.command()(show)
