"""Exports trials: CSV, Parquet and MCAP, of one trial, a folder of trials, or a study."""

import shutil
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Literal

from mrnav_server import __version__
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.trial_log import LOG_NAME, OperatorKind, TrialInfo, list_trials, read_trial
from mrnav_server.loops.video_recorder import VIDEO_NAME
from mrnav_server.study.export_dictionary import write_dictionary
from mrnav_server.study.export_foxglove import Drawing
from mrnav_server.study.export_mcap import write_mcap
from mrnav_server.study.export_rows import TrialRows, trial_rows
from mrnav_server.study.export_tables import TableFormat, TableWriter
from mrnav_server.study.study_folder import PLAN_NAME, PROGRESS_NAME, TRIALS_NAME, StudyFolder
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model

ExportFormat = Literal["csv", "parquet", "mcap"]
FORMATS: tuple[ExportFormat, ...] = ("csv", "parquet", "mcap")
STUDY_FILES = (PLAN_NAME, PROGRESS_NAME)
"""Of a study, beside its trials; demographics stay where they are."""
_TABLE_FORMATS: tuple[TableFormat, ...] = ("csv", "parquet")
_PART_SUFFIX = ".part"


@dataclass
class Export:
    """What was exported.

    Attributes:
        folder: Where to.
        operator_kind: Whose trials.
        simulated: Whether operators or rig were simulated.
        origin: The same in words.
        trials: Their ids.
        counts: Rows by topic, of all trials.
        left_out: Trials that could not be read, and why.
        files: All files.
    """

    folder: Path
    operator_kind: OperatorKind
    simulated: bool
    origin: str
    trials: list[str] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    left_out: list[tuple[str, str]] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)


def export_trials(
    source: Path,
    out: Path | None = None,
    formats: tuple[ExportFormat, ...] = FORMATS,
    operators: OperatorKind | None = None,
    *,
    film: bool = True,
    on_trial: Callable[[int, int], None] = lambda done, total: None,
) -> Export:
    """Export a trial, a folder of trials, or a study.

    Args:
        source: Its folder.
        out: Folder of the export; ``export`` within ``source`` if left out.
        formats: What to write.
        operators: Whose trials, where the folder holds both kinds.
        film: Whether MCAP files hold the trials' films.
        on_trial: Told how many trials of how many are done.

    Raises:
        ConfigError: If there is nothing to export, something is there already, or kinds would be pooled.
    """
    root, infos = _chosen(source, operators)
    to = out or source / "export"
    taken = [to / form for form in formats if (to / form).exists()]
    if taken:
        raise ConfigError(f"{taken[0]} is there already: remove it, or name another folder with --out")
    export = _described(to, infos)
    results = _results(source)
    parts = {form: to / (form + _PART_SUFFIX) for form in formats}
    for part in parts.values():
        # What an export left behind that was ended on the way.
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
    with ExitStack() as stack:
        tables = [
            stack.enter_context(TableWriter(parts[form], form)) for form in _TABLE_FORMATS if form in parts
        ]
        for done, info in enumerate(infos, start=1):
            try:
                counts = info.status == "ended" and (results is None or info.id in results)
                rows = trial_rows(root / info.id, info, result=counts)
            except ConfigError as error:
                export.left_out.append((info.id, str(error)))
                on_trial(done, len(infos))
                continue
            for table in tables:
                table.write(rows)
            if "mcap" in parts:
                write_mcap(parts["mcap"] / f"{info.id}.mcap", rows, _drawing(root / info.id, info, film))
            _count(export, rows)
            on_trial(done, len(infos))
    if not export.trials:
        raise ConfigError(f"no trial could be read: {export.left_out[0][1]}")
    for form, part in parts.items():
        part.rename(to / form)
        export.files += sorted((to / form).iterdir())
    export.files += write_dictionary(to, export.origin, __version__)
    for name in STUDY_FILES:
        if (source / name).is_file():
            shutil.copyfile(source / name, to / name)
            export.files.append(to / name)
    return export


def refuse_mixture(kinds: set[tuple[OperatorKind, bool]], remedy: str) -> None:
    """Refuse to have trials of different kinds in one place.

    Args:
        kinds: Operator's kind, and whether the rig was simulated, of every trial.
        remedy: What to do where people and simulated operators meet.

    Raises:
        ConfigError: If there are several.
    """
    if len({operator for operator, _ in kinds}) > 1:
        raise ConfigError(f"human and simulated operators' trials are never pooled: {remedy}")
    if len(kinds) > 1:
        raise ConfigError(
            "trials on hardware and on the simulated rig are never pooled: keep them in folders of their own"
        )


def _chosen(source: Path, operators: OperatorKind | None) -> tuple[Path, list[TrialInfo]]:
    """Return the folder that holds the trials, and the trials."""
    if (source / LOG_NAME).is_file():
        root = source.resolve().parent
        return root, [read_trial(root, source.resolve().name)]
    root = source / TRIALS_NAME if (source / TRIALS_NAME).is_dir() else source
    infos = [info for info in list_trials(root) if operators in (None, info.header.operator_kind)]
    if not infos:
        said = f" of {operators} operators" if operators else ""
        raise ConfigError(f"{source} holds no trial{said}: name a trial, a folder of trials, or a study")
    kinds = {(info.header.operator_kind, info.header.simulated_rig) for info in infos}
    refuse_mixture(kinds, "choose with --operators human or --operators simulated")
    return root, infos


def _described(folder: Path, infos: list[TrialInfo]) -> Export:
    header = infos[0].header
    kind, rig = header.operator_kind, "a simulated rig" if header.simulated_rig else "hardware"
    simulated = kind == "simulated" or header.simulated_rig
    who = (
        f"Simulated operators on {rig}: no evidence about people"
        if kind == "simulated"
        else f"People on {rig}"
    )
    return Export(folder, kind, simulated, who)


def _count(export: Export, rows: TrialRows) -> None:
    export.trials.append(rows.id)
    for topic, count in rows.counts.items():
        export.counts[topic] = export.counts.get(topic, 0) + count


def _drawing(folder: Path, info: TrialInfo, film: bool) -> Drawing:
    video = folder / VIDEO_NAME
    return Drawing(vessel_of(info), video if film and video.is_file() else None)


def vessel_of(info: TrialInfo) -> VesselMap | None:
    """Return a trial's vessel model; None if it is not at hand with the mask of then."""
    vessel = _model(info.header.vessel)
    return vessel if vessel is not None and vessel.digest == info.header.vessel_sha256 else None


@lru_cache(maxsize=4)
def _model(name: str) -> VesselMap | None:
    try:
        return load_vessel_model(find_model(name))
    except ConfigError:
        return None


def _results(source: Path) -> set[str | None] | None:
    """Return the trials that a plan's steps ended with; None without a plan."""
    if not (source / PLAN_NAME).is_file():
        return None
    study = StudyFolder(source)
    progress = [study.progress(step) for step in study.steps if step.kind == "trial"]
    return {each.trial for each in progress if each.status == "done"}
