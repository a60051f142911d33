"""``mrnav replay``: a recorded trial through the same deciders, compared exactly."""

import os
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import orjson
import typer
from rich.console import Console
from rich.markup import escape


def replay(
    trial: Annotated[Path, typer.Argument(help="A trial's folder.")],
    video: Annotated[
        bool, typer.Option("--video", help="Track the recorded film, too, and compare.")
    ] = False,
    settings_file: Annotated[
        Path | None,
        typer.Option("--settings", help="Replay by these settings (TOML) instead of the recorded ones."),
    ] = None,
    calibration_file: Annotated[
        Path | None,
        typer.Option("--calibration", help="Replay by this calibration instead of the recorded one."),
    ] = None,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object as the last line.")
    ] = False,
) -> None:
    """Feed a trial's recorded inputs through the deciders; ends with 1 and names the first difference."""
    from mrnav_server.settings import load_settings
    from mrnav_server.study.replay import replay_trial
    from mrnav_server.study.replay_film import replay_film

    settings = load_settings(settings_file, os.environ) if settings_file is not None else None
    result = replay_trial(trial, settings, calibration_file)
    fields = result.fields()
    film = replay_film(trial) if video else None
    if film is not None:
        fields["video"] = asdict(film)
    if json_output:
        typer.echo(orjson.dumps(fields).decode())
    else:
        console = Console()
        origin = "simulated" if result.simulated else "measured"
        found = ", ".join(f"{count} {name}" for name, count in result.counts.items())
        console.print(f"Trial {escape(result.id)} ({origin}): {found} are exactly as recorded")
        if result.difference is not None:
            console.print(f"[bold red]first difference:[/] {escape(str(result.difference))}")
        for reason in result.changed:
            console.print(f"changed since: {escape(reason)}")
        if film is not None:
            console.print(f"film: {escape(str(film))}")
    if not result.exact:
        raise typer.Exit(1)
