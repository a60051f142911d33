"""``mrnav study report``: a study's report from its trials' logs."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from mrnav_server.core.errors import ConfigError
from mrnav_server.loops.trial_log import OperatorKind


def study_report(
    folder: Annotated[Path, typer.Argument(help="A study's folder, or any folder of trials.")],
    out: Annotated[Path | None, typer.Option(help="Folder of the report; FOLDER/report if left out.")] = None,
    operators: Annotated[
        OperatorKind | None, typer.Option(help="Whose trials, where the folder holds both; never pooled.")
    ] = None,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object as the last line.")
    ] = False,
) -> None:
    """Write report.html and report.pdf, figures as SVG and PNG, tables as CSV and LaTeX."""
    from mrnav_server.study.study_data import read_study
    from mrnav_server.study.study_report import write_study_report

    to = out or folder / ("report" if operators is None else f"report-{operators}")
    say = Console(stderr=True)
    with Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), console=say
    ) as progress:
        reading, writing = (progress.add_task(name, total=None) for name in ("trials", "files"))
        study = read_study(
            folder,
            operators,
            on_trial=lambda done, total: progress.update(reading, completed=done, total=total),
        )
        try:
            written = write_study_report(
                study, to, lambda done, total: progress.update(writing, completed=done, total=total)
            )
        except OSError as error:
            raise ConfigError(f"--out: {error.filename or to} cannot be written ({error.strerror})") from None
    if json_output:
        found = {
            "html": str(written.html),
            "pdf": str(written.pdf),
            "files": [str(path) for path in written.files],
            "trials": len(study.trials),
            "left_out": len(study.left_out),
            "operators": len(study.operators),
            "operator_kind": study.operator_kind,
            "simulated": study.simulated,
        }
        typer.echo(json.dumps(found))
        return
    say.print(f"{len(study.trials)} trials of {len(study.operators)} {study.people} ({study.origin})")
    say.print(f"report: {written.html} and {written.pdf}", soft_wrap=True)
