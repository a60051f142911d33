"""``mrnav bench``: measure the published figures again, from a checkout."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from mrnav_server.core.errors import ConfigError

_CHECKOUT = Path(__file__).resolve().parents[2]


def bench(
    names: Annotated[list[str] | None, typer.Argument(help="Benchmarks; all if left out.")] = None,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object as the last line.")
    ] = False,
) -> None:
    """Run benchmarks one after the other; each measures figures that the documentation states."""
    known = sorted(path.stem for path in (_CHECKOUT / "benchmarks").glob("[a-z]*.py"))
    if not known:
        raise ConfigError("there are no benchmarks beside this package: run mrnav bench from a checkout")
    unknown = sorted(set(names or ()) - set(known))
    if unknown:
        raise ConfigError(f"no such benchmark: {', '.join(unknown)} (there are {', '.join(known)})")
    say = Console(stderr=True)
    results: dict[str, Any] = {}
    for name in names or known:
        say.rule(name)
        done = subprocess.run(
            [sys.executable, "-m", f"benchmarks.{name}"],
            cwd=_CHECKOUT,
            stdout=subprocess.PIPE,
            text=True,
            check=False,
        )
        if done.returncode != 0:
            raise typer.Exit(done.returncode)
        results[name] = json.loads(done.stdout.strip().splitlines()[-1])
        say.print_json(data=results[name])
    if json_output:
        typer.echo(json.dumps(results))
