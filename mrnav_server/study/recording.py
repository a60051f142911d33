"""A trial's log with all that a replay begins with."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import Calibration
from mrnav_server.loops.state_image import restored
from mrnav_server.loops.trial_log import LOG_NAME, LogLine, TrialHeader, read_header, read_log
from mrnav_server.settings import Settings

_BEGINNING = ("settings", "state")


@dataclass(frozen=True)
class Recording:
    """What was recorded.

    Attributes:
        header: The log's first line.
        settings: In force, without the tokens; what was not known then is as it is by default.
        told: The settings as they were recorded.
        calibration: In force.
        state: Image of the control loop at the beginning (loops/state_image.py).
        lines: All lines that follow.
    """

    header: TrialHeader
    settings: Settings
    told: Mapping[str, Any]
    calibration: Calibration
    state: Mapping[str, Any]
    lines: list[LogLine]


def read_recording(folder: Path) -> Recording:
    """Read a trial's log.

    Raises:
        ConfigError: If it is no trial, or one that was recorded without what a replay needs.
    """
    log = folder / LOG_NAME
    if not log.is_file():
        raise ConfigError(f"{folder} is no trial: {LOG_NAME} is missing")
    lines = list(read_log(log))
    if tuple(line.topic for line in lines[:2]) != _BEGINNING:
        raise ConfigError(f"trial {folder.name} was recorded without the state that a replay begins with")
    settings, state = lines[0].data, lines[1].data
    if "missing" in state:
        raise ConfigError(f"trial {folder.name} cannot be replayed: {state['missing']}")
    calibration: Calibration = restored(state["calibration"])
    return Recording(
        read_header(log), _settings(settings), settings, calibration, state["control"], lines[2:]
    )


def _settings(values: Mapping[str, Any]) -> Settings:
    try:
        return Settings.model_validate(values)
    except ValidationError as error:
        places = ", ".join(".".join(map(str, each["loc"])) for each in error.errors())
        raise ConfigError(f"this version does not know the recorded settings: {places}") from None
