"""``mrnav tlx``: the questionnaires of many trials as one table."""

from pathlib import Path
from typing import Annotated

import typer

from mrnav_server.core.errors import ConfigError


def tlx(
    trials: Annotated[Path, typer.Argument(help="Folder of trials.")],
    out: Annotated[Path | None, typer.Option(help="CSV file; standard output if left out.")] = None,
) -> None:
    """Write NASA-TLX ratings, weights and scores as CSV, one row a trial. Only people answer it."""
    from mrnav_server.loops.tlx_record import tlx_csv

    if not trials.is_dir():
        raise ConfigError(f"{trials} is no folder of trials: give the one that recording.root names")
    text = tlx_csv(trials)
    if out is None:
        typer.echo(text, nl=False)
        return
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"--out: {out} cannot be written ({error.strerror})") from None
    typer.echo(f"{len(text.splitlines()) - 1} questionnaires are in {out}")
