"""``mrnav serve --study``: a study taken up where it was left."""

from pathlib import Path

import typer

from mrnav_server.core.errors import ConfigError
from mrnav_server.study.study_folder import StudyFolder


def led_study(folder: Path) -> StudyFolder:
    """Open a study to lead people through it; say what was interrupted.

    Raises:
        ConfigError: If it is none, or one of simulated operators.
    """
    study = StudyFolder(folder)
    if study.plan.operator_kind == "simulated":
        raise ConfigError(
            f"{folder} is a study of simulated operators: `mrnav study simulate` goes on with it"
        )
    for step in study.recover():
        typer.echo(f"{step.id} was interrupted and will be done again", err=True)
    return study


def variables(study: StudyFolder) -> dict[str, str]:
    """Return the settings that a study makes: where its trials go, and the next step's vessel."""
    step = study.next_step
    found = {"MRNAV_RECORDING__ROOT": str(study.trials.absolute())}
    return found | ({"MRNAV_RIG__VESSEL": step.model} if step is not None else {})
