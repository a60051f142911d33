"""Reads trials for an import: from an export in any of its formats, or from another study's folder."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mrnav_server.core.errors import ConfigError
from mrnav_server.loops.trial_log import LOG_NAME, list_trials, trial_folder
from mrnav_server.study.export_mcap import read_mcap
from mrnav_server.study.export_rows import log_bytes, log_digest
from mrnav_server.study.export_tables import TRIALS_TABLE_NAME, TableFormat, read_tables, table_topics
from mrnav_server.study.export_topics import topic_named
from mrnav_server.study.study_folder import TRIALS_NAME


@dataclass(frozen=True)
class SourceTrial:
    """A trial to import.

    Attributes:
        id: Its id.
        log: Its log's bytes.
        tlx: Its questionnaire's file; None without one.
        exact: Whether the log is known to be as it was recorded.
        folder: The trial's folder, with film and all; None of an export.
    """

    id: str
    log: bytes
    tlx: str | None
    exact: bool
    folder: Path | None = None


def read_source(source: Path) -> Iterator[SourceTrial]:
    """Yield the trials of an export, of an MCAP file, or of a study's folder.

    An export with several formats is read from Parquet, else CSV, else MCAP: all hold the same.

    Raises:
        ConfigError: If it is none of these, or something is missing in it, with the remedy.
    """
    if source.is_file():
        yield _mcap_trial(source)
        return
    for form in ("parquet", "csv"):
        for folder in (source / form, source):
            if (folder / f"{TRIALS_TABLE_NAME}.{form}").is_file():
                yield from _table_trials(folder, form)
                return
    files = sorted(source.glob("mcap/*.mcap")) or sorted(source.glob("*.mcap"))
    if files:
        yield from map(_mcap_trial, files)
        return
    root = source / TRIALS_NAME if (source / TRIALS_NAME).is_dir() else source
    if (source / LOG_NAME).is_file():
        root, ids = source.resolve().parent, [source.resolve().name]
    else:
        ids = [info.id for info in list_trials(root)]
    if not ids:
        raise ConfigError(
            f"{source} holds nothing to import: name a folder that mrnav export wrote, an .mcap file of it,"
            " or a study's folder"
        )
    for trial_id in ids:
        folder = trial_folder(root, trial_id)
        yield SourceTrial(trial_id, (folder / LOG_NAME).read_bytes(), None, True, folder)


def _table_trials(folder: Path, form: TableFormat) -> Iterator[SourceTrial]:
    tables = read_tables(folder, form)
    _, trials = next(tables)
    lines: dict[str, list[tuple[int, bytes]]] = {}
    for name, table in tables:
        topic = topic_named(name)
        for trial, row in table_topics(table, topic):
            if row["seq"] is None or row["logged_mono_ns"] is None or row["logged_epoch_s"] is None:
                raise ConfigError(
                    f"{folder / name}.{form}: seq, logged_mono_ns or logged_epoch_s is empty:"
                    " every row needs the three"
                )
            lines.setdefault(trial, []).append((row["seq"], log_bytes(topic, row)))
    known = trials.column("trial").to_pylist()
    strange = sorted(set(lines) - set(known))
    if strange:
        raise ConfigError(
            f"{folder}: the tables hold rows of trial {strange[0]}, which {TRIALS_TABLE_NAME}.{form} lacks:"
            " import the export whole"
        )
    for summary in trials.to_pylist():
        yield _rebuilt(
            summary["trial"],
            summary["header_json"],
            lines.pop(summary["trial"], []),
            summary["tlx_json"],
            summary["log_sha256"],
        )


def _mcap_trial(file: Path) -> SourceTrial:
    summary, rows = read_mcap(file)
    try:
        lines = [(row["seq"], log_bytes(topic, row)) for topic, row in rows]
        return _rebuilt(
            summary["trial"],
            summary["header_json"],
            lines,
            summary["tlx_json"] if summary["tlx_json"] != "null" else None,
            summary["log_sha256"],
        )
    except KeyError as error:
        raise ConfigError(f"{file} lacks {error}: import what mrnav export wrote") from None


def _rebuilt(
    trial_id: str, header: str, lines: list[tuple[int, bytes]], tlx: str | None, digest: str
) -> SourceTrial:
    """Put a log together in the order of its lines' numbers."""
    if not trial_id or not header:
        raise ConfigError(f"trial {trial_id}: trial or header_json is empty: every trial needs both")
    lines.sort(key=lambda line: line[0])
    content = [header.encode() + b"\n", *(line for _, line in lines)]
    return SourceTrial(trial_id, b"".join(content), tlx, log_digest(content) == digest)
