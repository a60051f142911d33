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
    names: Annotated[
        list[str] | None,
        typer.Argument(help="Benchmarks; all if left out. After the name of a single one, its own options."),
    ] = None,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object as the last line.")
    ] = False,
) -> None:
    """Run benchmarks one after the other; each measures figures that the documentation states."""
    known = sorted(path.stem for path in (_CHECKOUT / "benchmarks").glob("[a-z]*.py"))
    if not known:
        raise ConfigError("there are no benchmarks beside this package: run mrnav bench from a checkout")
    names, options = _split(names or [])
    unknown = sorted(set(names) - set(known))
    if unknown:
        raise ConfigError(f"no such benchmark: {', '.join(unknown)} (there are {', '.join(known)})")
    if options and len(names) != 1:
        raise ConfigError(f"{options[0]} belongs to one benchmark: name that one alone")
    say = Console(stderr=True)
    results: dict[str, Any] = {}
    for name in names or known:
        say.rule(name)
        done = subprocess.run(
            [sys.executable, "-m", f"benchmarks.{name}", *options],
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
        # The single one that was asked for is the answer; of several each has its name.
        typer.echo(json.dumps(results[names[0]] if len(names) == 1 else results))


def _split(words: list[str]) -> tuple[list[str], list[str]]:
    """Return the benchmarks' names, and what follows from the first option on."""
    first = next((at for at, word in enumerate(words) if word.startswith("-")), len(words))
    return words[:first], words[first:]
