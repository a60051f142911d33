"""``mrnav figure``: the figures of the learning results, one command each (all simulated)."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import typer

from mrnav_server.core.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PRESETS = ("paper", "paper+")
_JSON_HELP = "Print one JSON object on the last line."
_OUT_HELP = "The picture."


def trajectories(
    models: Annotated[list[str], typer.Argument(help="Vessel models: names or folders.")],
    sets: Annotated[int, typer.Option(min=1, max=20, help="Random tasks a model.")] = 3,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the tasks and of the rig.")] = 0,
    out: Annotated[Path, typer.Option(help=_OUT_HELP)] = Path("trajectories.png"),
    json_output: Annotated[bool, typer.Option("--json", help=_JSON_HELP)] = False,
) -> None:
    """Draw random tasks in the grid and on the simulated rig, with the deviation from the planned path."""
    from mrnav_server.loops.priority import compute_in_calling_threads
    from mrnav_server.training.trajectories import run_trajectories, trajectories_figure
    from mrnav_server.vision.model_store import find_model

    compute_in_calling_threads()
    driven = [run_trajectories(find_model(model), sets, seed) for model in models]
    for each in driven:
        mean_um, largest_um = each.deviation_um
        record = each.record()
        typer.echo(
            f"{record['model']} (simulated): {record['arrived']} of {sets} arrived,"
            f" {record['contacts']} wall contacts, driven off planned path {mean_um:.1f} µm in the mean,"
            f" {largest_um:.1f} µm at most",
            err=json_output,
        )
    _save(trajectories_figure(driven), out)
    if json_output:
        typer.echo(json.dumps({"models": [each.record() for each in driven], "figure": str(out)}))


def curves(
    folders: Annotated[list[Path] | None, typer.Argument(help="Folders of training runs.")] = None,
    run: Annotated[
        list[str] | None, typer.Option(help="Train on this model first; may be given more than once.")
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="With --run: seeds of each preset and algorithm.")] = 3,
    steps: Annotated[
        int | None, typer.Option(min=1, help="With --run: steps; the preset's if left out.")
    ] = None,
    runs: Annotated[Path, typer.Option(help="With --run: where the training runs go.")] = Path("runs/curves"),
    out: Annotated[Path, typer.Option(help=_OUT_HELP)] = Path("curves.png"),
    json_output: Annotated[bool, typer.Option("--json", help=_JSON_HELP)] = False,
) -> None:
    """Draw PPO against A2C, on the presets paper and paper+, as mean and spread over seeds."""
    from mrnav_server.training.curve_runs import best_per_1000, train_for_curves
    from mrnav_server.training.curves import curves_figure, read_run
    from mrnav_server.training.presets import Algorithm

    wanted = list(folders or ())
    for model in run or ():
        for preset in _PRESETS:
            for algo in get_args(Algorithm):
                for seed in range(seeds):
                    wanted.append(train_for_curves(model, preset, algo, seed, steps, runs))
                    typer.echo(f"{wanted[-1]} is trained", err=True)
    if not wanted:
        raise ConfigError("name folders of training runs, or train some with --run MODEL")
    found = [read_run(folder) for folder in wanted]
    best = best_per_1000({each.model for each in found})
    _save(curves_figure(found, best), out)
    if json_output:
        rows = [each.record() for each in found]
        typer.echo(json.dumps({"runs": rows, "best_per_1000": best, "figure": str(out)}))


def discount(
    models: Annotated[list[str], typer.Argument(help="Vessel models: names or folders.")],
    pairs: Annotated[int, typer.Option(min=1, help="Random pairs a model.")] = 500,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the pairs.")] = 0,
    out: Annotated[Path, typer.Option(help=_OUT_HELP)] = Path("discount.png"),
    json_output: Annotated[bool, typer.Option("--json", help=_JSON_HELP)] = False,
) -> None:
    """Draw for how many random pairs the way to the target pays more than waiting, over the discount."""
    from mrnav_server.training.discount import DISCOUNTS, discount_figure, shares_that_pay
    from mrnav_server.vision.model_store import find_model
    from mrnav_server.vision.vessel_model import load_vessel_model

    vessels = [load_vessel_model(find_model(model)) for model in models]
    shares = {vessel.name: shares_that_pay(vessel, pairs, seed) for vessel in vessels}
    for name, row in shares.items():
        words = ", ".join(f"γ {each:g}: {share:.1%}" for each, share in zip(DISCOUNTS, row, strict=True))
        typer.echo(f"{name} (simulated): {words}", err=json_output)
    _save(discount_figure(shares, pairs), out)
    if json_output:
        typer.echo(json.dumps({"discounts": DISCOUNTS, "shares": shares, "figure": str(out)}))


def _save(figure: "Figure", out: Path) -> None:
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=90)
    typer.echo(f"drawn in {out}", err=True)
