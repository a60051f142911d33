"""``mrnav sweep``: many trainings, on this machine or on a Ray cluster, and a leaderboard."""

import json
import os
from collections import Counter
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from mrnav_server.training.leaderboard import Row, Spread
    from mrnav_server.training.sweep import Events, Runner

_INTERRUPTED = 130


def sweep(
    spec: Annotated[
        Path, typer.Argument(help="JSON or TOML with models, presets, algos, seeds, set, pairs.")
    ],
    out: Annotated[Path | None, typer.Option(help="Results; runs/ and the file's name if left out.")] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes at a time; one per processor if left out.")
    ] = None,
    ray: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Ray cluster to run on: host:port, or auto.")
    ] = None,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on the last line.")
    ] = False,
) -> None:
    """Train every combination that a file lists; the same command goes on where it was interrupted."""
    from mrnav_server.training.leaderboard import leaderboard, write_leaderboard
    from mrnav_server.training.sweep import check, expand, read_sweep, run_sweep
    from mrnav_server.training.sweep_job import read_result

    jobs = expand(read_sweep(spec))
    check(jobs)
    runner = _runner(workers, ray)
    folder = (out if out is not None else Path("runs") / spec.stem).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    counts = Counter[str]()
    try:
        with closing(run_sweep(jobs, folder, runner)) as events:
            _show(events, len(jobs), counts)
    except KeyboardInterrupt:
        done = counts["done"] + counts["skipped"]
        typer.echo(f"interrupted: {done} of {len(jobs)} jobs are done; the same command goes on", err=True)
        raise typer.Exit(_INTERRUPTED) from None
    rows = leaderboard(result for job in jobs if (result := read_result(folder / job.name)) is not None)
    write_leaderboard(rows, folder)
    if json_output:
        answer = {"out": str(folder), "jobs": len(jobs), "failed": counts["failed"]}
        answer |= {"done": counts["done"], "skipped": counts["skipped"], "lost": counts["lost"]}
        typer.echo(json.dumps(answer | {"leaderboard": [row.flat() for row in rows]}))
    else:
        from rich.console import Console

        Console().print(_table(rows))
        typer.echo(f"{len(jobs) - counts['failed']} of {len(jobs)} jobs are done; everything is in {folder}")
    if counts["failed"]:
        raise typer.Exit(1)


def _runner(workers: int | None, address: str | None) -> "Runner":
    if address is None:
        from mrnav_server.training.sweep_pool import run_on_processes

        return partial(run_on_processes, workers=workers or os.cpu_count() or 1)
    from mrnav_server.training.sweep_ray import connect, run_on_ray

    connect(address)
    return run_on_ray


def _show(events: "Events", total: int, counts: Counter[str]) -> None:
    """Count the events, with a bar and a line for whatever goes wrong."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True)) as bars:
        bar = bars.add_task(f"{total} jobs", total=total)
        for event in events:
            counts[event.kind] += 1
            done, failed = counts["done"] + counts["skipped"], counts["failed"]
            text = f"{done} done, {failed} failed, {total - done - failed} remaining"
            bars.update(bar, completed=done + failed, description=text)
            if event.text:
                line = f"{event.kind}: {event.job.title} ({event.job.name}): {event.text}"
                bars.console.print(escape(line), highlight=False, soft_wrap=True)


def _table(rows: "list[Row]") -> "Table":
    """Draw the leaderboard; what all rows have in common stands under it."""
    from rich.table import Table

    settings = [{**row.setting, "model": Path(row.setting["model"]).name} for row in rows]
    common = {k: v for k, v in (settings[0].items() if settings else ()) if all(s[k] == v for s in settings)}
    differing = [key for key in (settings[0] if settings else ()) if key not in common]
    table = Table(
        title="Leaderboard (simulated): mean ± standard deviation over the seeds",
        caption=", ".join(f"{key} {value}" for key, value in common.items()),
    )
    for name in (*differing, "seeds", "greedy %", "sampled %", "SPL", "hits", "CPU s"):
        table.add_column(name, overflow="fold", min_width=min(len(name), 10))
    for row, setting in zip(rows, settings, strict=True):
        table.add_row(
            *(str(setting[key]) for key in differing),
            str(len(row.seeds)),
            _shown(row.figures["success_greedy"], 1, 100.0),
            _shown(row.figures["success_sampled"], 1, 100.0),
            _shown(row.figures["spl_greedy"], 3),
            _shown(row.figures["wall_hits_greedy"], 2),
            _shown(row.figures["cpu_s"], 0),
        )
    return table


def _shown(spread: "Spread", digits: int, scale: float = 1.0) -> str:
    mean = f"{scale * spread.mean:.{digits}f}"
    return mean if spread.deviation is None else f"{mean} ± {scale * spread.deviation:.{digits}f}"
