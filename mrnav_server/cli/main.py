"""The ``mrnav`` command. Each command imports what is heavy when it runs."""

import sys
from typing import Annotated

import typer
from rich.console import Console

from mrnav_server import __version__
from mrnav_server.cli.bench import bench
from mrnav_server.cli.calibrate import calibrate
from mrnav_server.cli.demo import demo
from mrnav_server.cli.doctor import doctor
from mrnav_server.cli.emulate import emulate
from mrnav_server.cli.evaluate import evaluate
from mrnav_server.cli.export import export
from mrnav_server.cli.figure import curves, discount, trajectories
from mrnav_server.cli.map import models
from mrnav_server.cli.measure import measure
from mrnav_server.cli.metrics import metrics
from mrnav_server.cli.operator import operator
from mrnav_server.cli.policy import policies
from mrnav_server.cli.register import register
from mrnav_server.cli.replay import replay
from mrnav_server.cli.report import report
from mrnav_server.cli.serve import serve
from mrnav_server.cli.stats import stats
from mrnav_server.cli.stop import stop
from mrnav_server.cli.study import studies
from mrnav_server.cli.sweep import sweep
from mrnav_server.cli.tls import tls
from mrnav_server.cli.tlx import tlx
from mrnav_server.cli.track import track
from mrnav_server.cli.train import train
from mrnav_server.core.errors import ConfigError, MrnavError

_EXTRAS = {
    "gymnasium": "train",
    "matplotlib": "study",
    "pyarrow": "export",
    "mcap": "export",
    "skimage": "vessels",
    "cryptography": "tls",
}
"""Packages that only some commands need, and the extra that brings them."""

app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False, add_completion=False)
for command in (serve, stop, demo, operator, doctor, train, sweep, evaluate, report, register, track, stats):
    app.command()(command)
# What follows a benchmark's name are its own options.
app.command(context_settings={"ignore_unknown_options": True})(bench)
app.command()(export)
app.command()(metrics)
app.command()(replay)
app.command()(tls)
app.command()(tlx)
app.add_typer(models, name="map")
app.add_typer(policies, name="policy")
app.add_typer(calibrate, name="calibrate")
app.add_typer(emulate, name="emulate")
app.add_typer(measure, name="measure")
app.add_typer(studies, name="study")
figures = typer.Typer(no_args_is_help=True, help="The figures of the learning results (simulated).")
for figure in (curves, trajectories, discount):
    figures.command()(figure)
app.add_typer(figures, name="figure")


def show_version(wanted: bool) -> None:
    """Print the version and end, if that is wanted."""
    if wanted:
        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def options(
    _: Annotated[
        bool, typer.Option("--version", callback=show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Semi-autonomous navigation of magnetic micro-robots."""


def main() -> None:
    """Run the command that the arguments name; errors made on purpose are told in one line."""
    try:
        app()
    except ConfigError as error:
        sys.exit(_told(error, 2))
    except MrnavError as error:
        sys.exit(_told(error, 1))
    except ModuleNotFoundError as error:
        name = (error.name or "").partition(".")[0]
        extra = _EXTRAS.get(name)
        if extra is None:
            raise
        sys.exit(_told(ConfigError(f"this needs {name}: pip install 'mrnav-server[{extra}]'"), 2))


def _told(error: MrnavError, code: int) -> int:
    Console(stderr=True, soft_wrap=True).print(f"[bold red]error:[/] {_plain(error)}", highlight=False)
    return code


def _plain(error: MrnavError) -> str:
    return " ".join(str(error).split()).replace("[", r"\[")


if __name__ == "__main__":
    main()
