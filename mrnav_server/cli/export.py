"""``mrnav export`` and ``mrnav study import``: trials as CSV, Parquet and MCAP, and back."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from mrnav_server.core.errors import ConfigError
from mrnav_server.loops.trial_log import OperatorKind


def export(
    source: Annotated[Path, typer.Argument(help="A trial's folder, a folder of trials, or a study's.")],
    form: Annotated[
        Literal["csv", "parquet", "mcap", "all"],
        typer.Option(
            "--format", help="mcap opens in Foxglove, one file a trial; the others: a table a topic."
        ),
    ] = "all",
    out: Annotated[Path | None, typer.Option(help="Folder of the export; SOURCE/export if left out.")] = None,
    operators: Annotated[
        OperatorKind | None, typer.Option(help="Whose trials, where the folder holds both; never pooled.")
    ] = None,
    film: Annotated[bool, typer.Option(help="Put the trials' films into MCAP.")] = True,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object as the last line.")
    ] = False,
) -> None:
    """Export trials as tables and MCAP, with a README that says what every column means."""
    from mrnav_server.study.export import FORMATS, export_trials

    formats = FORMATS if form == "all" else (form,)
    with _progress() as on_trial:
        try:
            done = export_trials(source, out, formats, operators, film=film, on_trial=on_trial)
        except OSError as error:
            raise ConfigError(
                f"--out: {error.filename or out} cannot be written ({error.strerror})"
            ) from None
    if json_output:
        found = {
            "folder": str(done.folder),
            "trials": len(done.trials),
            "operator_kind": done.operator_kind,
            "simulated": done.simulated,
            "counts": done.counts,
            "left_out": [{"trial": trial, "why": why} for trial, why in done.left_out],
            "files": [str(path) for path in done.files],
        }
        typer.echo(json.dumps(found))
        return
    say = Console(stderr=True, soft_wrap=True, highlight=False)
    for trial, why in done.left_out:
        say.print(f"[yellow]left out:[/] {trial}: {why}", markup=True)
    say.print(f"{len(done.trials)} trials, {sum(done.counts.values())} rows ({done.origin})")
    say.print(f"export: {done.folder}; what the columns mean: {done.folder / 'README.md'}")


def study_import(
    source: Annotated[
        Path, typer.Argument(help="An export, an .mcap file of one, or another study's folder.")
    ],
    into: Annotated[Path, typer.Argument(help="The study's folder that takes the trials; made if missing.")],
    results: Annotated[
        bool, typer.Option(help="Measure each trial, for the page of results; reports need it not.")
    ] = True,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object as the last line.")
    ] = False,
) -> None:
    """Take exported trials, or another study's, into a study's folder; nothing is overwritten."""
    from mrnav_server.study.import_trials import import_trials

    with _progress() as on_trial:
        done = import_trials(source, into, results=results, on_trial=on_trial)
    if json_output:
        found = {
            "folder": str(done.folder),
            "trials": done.trials,
            "present": done.present,
            "changed": done.changed,
            "unmeasured": [{"trial": trial, "why": why} for trial, why in done.unmeasured],
        }
        typer.echo(json.dumps(found))
        return
    say = Console(stderr=True, soft_wrap=True, highlight=False)
    for trial in done.changed:
        say.print(f"[yellow]{trial}:[/] not as it was recorded: the export was edited")
    for trial, why in done.unmeasured:
        say.print(f"[yellow]{trial}:[/] no result: {why}")
    say.print(f"{len(done.trials)} trials imported into {into}, {len(done.present)} were there already")


@contextmanager
def _progress() -> Iterator[Callable[[int, int], None]]:
    """Show on stderr how many trials are done."""
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("trials", total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)
