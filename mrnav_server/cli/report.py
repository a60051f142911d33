"""``mrnav report``: metrics and picture of one recorded trial."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from mrnav_server.core.errors import ConfigError, RefusedError


def report(
    trial: Annotated[Path, typer.Argument(help="A trial's folder.")],
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object as the last line.")
    ] = False,
) -> None:
    """Compute a trial's metrics and draw its trajectory, from its log alone."""
    from mrnav_server.core.metric_flags import FLAGS
    from mrnav_server.loops.trial_log import LOG_NAME, read_header
    from mrnav_server.study.trial_report import PICTURE_NAME, write_trial_report
    from mrnav_server.vision.model_store import find_model
    from mrnav_server.vision.vessel_model import load_vessel_model

    log = trial / LOG_NAME
    if not log.is_file():
        raise ConfigError(f"{trial} is no trial: {LOG_NAME} is missing")
    vessel = load_vessel_model(find_model(read_header(log).vessel))
    try:
        result = write_trial_report(trial, vessel)
    except RefusedError as error:
        raise ConfigError(str(error)) from None
    if json_output:
        typer.echo(json.dumps(result))
        return
    origin = "simulated" if result["simulated"] else "measured"
    table = Table(title=f"Trial {result['id']} ({origin})", title_justify="left")
    for column in ("metric", origin, "direction"):
        table.add_column(column)
    for name, value in result["metrics"].items():
        if name == "flags":
            continue
        shown = value["value"] if isinstance(value, dict) else value
        text = "–" if shown is None else f"{shown:.4g}" if isinstance(shown, float) else str(shown)
        table.add_row(name, text, result["direction"].get(name, ""))
    Console().print(table)
    for flag in result["metrics"]["flags"]:
        Console().print(f"[yellow]{flag}:[/] {FLAGS[flag]}", highlight=False)
    Console().print(f"picture: {trial / PICTURE_NAME}")
