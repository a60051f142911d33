"""Takes exported or foreign trials into a study's folder, each whole or not at all."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import orjson

from mrnav_server.core.errors import ConfigError, MrnavError
from mrnav_server.loops.tlx_record import TLX_NAME, read_tlx
from mrnav_server.loops.trial_log import (
    LOG_NAME,
    OperatorKind,
    TrialInfo,
    list_trials,
    read_log,
    read_trial,
    trial_folder,
)
from mrnav_server.study.export import STUDY_FILES, refuse_mixture, vessel_of
from mrnav_server.study.import_source import SourceTrial, read_source
from mrnav_server.study.study_folder import PLAN_NAME, TRIALS_NAME
from mrnav_server.study.trial_report import write_trial_report

_STAGING = ".import"


@dataclass
class Import:
    """What was imported.

    Attributes:
        folder: The study's folder.
        trials: Ids of the new trials.
        present: Ids of those that were there already, the same.
        changed: Ids of those whose log is not as it was recorded: somebody edited the export.
        unmeasured: Ids of those without a result, and why.
    """

    folder: Path
    trials: list[str] = field(default_factory=list)
    present: list[str] = field(default_factory=list)
    changed: list[str] = field(default_factory=list)
    unmeasured: list[tuple[str, str]] = field(default_factory=list)


def import_trials(
    source: Path,
    into: Path,
    *,
    results: bool = True,
    on_trial: Callable[[int, int], None] = lambda done, total: None,
) -> Import:
    """Take trials into ``into/trials``; nothing that is there is overwritten.

    Args:
        source: An export, an MCAP file of one, or another study's folder.
        into: The study's folder; made if it is not there.
        results: Whether to measure each trial, as the server does when one ends.
        on_trial: Told how many trials of how many are done.

    Raises:
        ConfigError: If something is wrong with the source, another trial has an id already, or kinds would
            be pooled. Nothing is imported then.
    """
    root, staging = into / TRIALS_NAME, into / _STAGING
    if not source.exists():
        raise ConfigError(f"{source} is not there: name an export, an .mcap file, or a study's folder")
    old = list_trials(root)
    _refuse_other_plan(source, into, old)
    found = Import(into)
    shutil.rmtree(staging, ignore_errors=True)
    try:
        staging.mkdir(parents=True)
        new = [info for trial in read_source(source) if (info := _staged(trial, staging, root, found))]
        refuse_mixture({_kind(info) for info in (*old, *new)}, f"import into another folder than {into}")
        for done, info in enumerate(new, start=1):
            if results:
                _measure(staging / info.id, info, found)
            on_trial(done, len(new))
        root.mkdir(exist_ok=True)
        for info in new:
            (staging / info.id).rename(root / info.id)
            found.trials.append(info.id)
        for name in STUDY_FILES:
            if (source / name).is_file() and not (into / name).exists():
                shutil.copyfile(source / name, into / name)
    except OSError as error:
        raise ConfigError(f"{error.filename or into} cannot be written or read ({error.strerror})") from None
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return found


def _staged(trial: SourceTrial, staging: Path, root: Path, found: Import) -> TrialInfo | None:
    """Write a trial beside the others and check it; None if it is among them already."""
    here = root / trial.id / LOG_NAME
    if here.is_file():
        if here.read_bytes() != trial.log:
            raise ConfigError(
                f"{root} holds another trial {trial.id}: it is never overwritten; import into another folder"
            )
        found.present.append(trial.id)
        return None
    folder = staging / Path(trial.id).name
    if trial.folder is not None:
        shutil.copytree(trial.folder, folder)
    else:
        folder.mkdir()
        (folder / LOG_NAME).write_bytes(trial.log)
        if trial.tlx is not None:
            (folder / TLX_NAME).write_text(trial.tlx)
    try:
        info = read_trial(staging, trial.id)
        if _said_id(trial) != trial.id:
            raise ConfigError("its header names another trial")
        for _ in read_log(trial_folder(staging, trial.id) / LOG_NAME):
            pass
        read_tlx(folder)
    except MrnavError as error:
        raise ConfigError(f"trial {trial.id[:64]} cannot be imported: {error}") from None
    if not trial.exact:
        found.changed.append(trial.id)
    return info


def _said_id(trial: SourceTrial) -> str:
    header: dict[str, str] = orjson.loads(trial.log.partition(b"\n")[0])
    return header["id"]


def _measure(folder: Path, info: TrialInfo, found: Import) -> None:
    vessel = vessel_of(info)
    if info.status != "ended":
        found.unmeasured.append((info.id, f"its status is {info.status}"))
    elif vessel is None:
        why = f"the vessel model {info.header.vessel} is not at hand with the mask of then"
        found.unmeasured.append((info.id, why))
    else:
        try:
            write_trial_report(folder, vessel)
        except MrnavError as error:
            found.unmeasured.append((info.id, str(error)))


def _kind(info: TrialInfo) -> tuple[OperatorKind, bool]:
    return info.header.operator_kind, info.header.simulated_rig


def _refuse_other_plan(source: Path, into: Path, old: list[TrialInfo]) -> None:
    """Refuse to mix a study that has a plan with other trials: a report would leave some of them out."""
    theirs, ours = source / PLAN_NAME, into / PLAN_NAME
    if not theirs.is_file() and not ours.is_file():
        return
    same = theirs.is_file() and ours.is_file() and theirs.read_bytes() == ours.read_bytes()
    if not same and (ours.is_file() or old):
        raise ConfigError(
            f"{into} holds {'a study with another plan' if ours.is_file() else 'trials without a plan'}:"
            " import into a new folder"
        )
