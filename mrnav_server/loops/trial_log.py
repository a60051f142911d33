"""Trials on disk: one folder each, with one append-only JSON Lines log (docs/study.md).

The first line is the header; every other line is ``{"seq", "t_mono_ns", "t_wall", "topic", "data"}``. A
partial last line, left by a crash, is ignored.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

import orjson

from mrnav_server.core.errors import ConfigError, RefusedError

SCHEMA_VERSION = 1
LOG_NAME = "log.jsonl"
CLOSED_TOPIC = "closed"

Condition = Literal["with_autonomy", "without_autonomy"]
OperatorKind = Literal["human", "simulated"]
Status = Literal["running", "ended", "interrupted"]

_TRIAL_ID = re.compile(r"\d{8}-\d{6}-(\d{3,})-[A-Za-z0-9_]{1,32}")
_PARTICIPANT = re.compile(r"[A-Za-z0-9_]{1,32}")
_TAIL_BYTES = 65_536


@dataclass(frozen=True, slots=True)
class TrialHeader:
    """What a log's reader must know before its first line.

    Attributes:
        participant: Pseudonym, letters, digits and underscores; never a name.
        condition: With or without autonomy.
        operator_kind: Human, or a simulated operator (which is never a participant).
        simulated_rig: Whether the rig is the simulator.
        software_version: Of this package.
        configuration_sha256: Digest of the settings in force.
        vessel: The vessel model's name.
        vessel_sha256: Digest of its mask.
        um_per_px: Size of a vessel grid pixel in µm.
        calibration: The calibration's fields, as in the twin's snapshot.
        start_px: Start in vessel grid pixels; None if the robot was not seen.
        area_id: The critical area; None without one.
        area_px: Its centre in vessel grid pixels.
        area_epsilon_um: Its radius in µm.
        policy_sha256: Digest of the policy in use; "" without one.
        seeds: Seeds by what they seed.
        notes: Free text.
    """

    participant: str
    condition: Condition
    operator_kind: OperatorKind
    simulated_rig: bool
    software_version: str
    configuration_sha256: str
    vessel: str
    vessel_sha256: str
    um_per_px: float
    calibration: Mapping[str, object]
    start_px: tuple[float, float] | None
    area_id: str | None
    area_px: tuple[float, float] | None
    area_epsilon_um: float | None
    policy_sha256: str = ""
    seeds: Mapping[str, int] = field(default_factory=dict)
    notes: str = ""


@dataclass(frozen=True, slots=True)
class LogLine:
    """One message of a log.

    Attributes:
        seq: Counts the log's lines from 1.
        t_s: When it was recorded, monotonic, in seconds.
        t_wall: Unix time in seconds: a label, never a measure.
        topic: What it is.
        data: Its fields.
    """

    seq: int
    t_s: float
    t_wall: float
    topic: str
    data: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class TrialInfo:
    """A trial in a list.

    Attributes:
        id: Server-made.
        header: What its log begins with.
        status: Running until its log is closed.
    """

    id: str
    header: TrialHeader
    status: Status


def new_trial_id(root: Path, participant: str, now: datetime) -> str:
    """Return an id that no trial under ``root`` has, for example ``20261122-174500-001-P01``.

    Raises:
        RefusedError: ``bad_participant`` if the name is not letters, digits and underscores.
    """
    if not _PARTICIPANT.fullmatch(participant):
        raise RefusedError(
            "bad_participant",
            "participant must be a pseudonym of 1 to 32 letters, digits or underscores, for example P01",
        )
    taken = [int(match[1]) for match in map(_TRIAL_ID.fullmatch, _ids(root)) if match]
    return f"{now:%Y%m%d-%H%M%S}-{max(taken, default=0) + 1:03d}-{participant}"


def trial_folder(root: Path, trial_id: str) -> Path:
    """Return a trial's folder, which lies inside ``root``.

    Raises:
        RefusedError: ``no_such_trial``.
    """
    folder = root / trial_id
    # The pattern alone keeps paths out; the resolved path also keeps out links that lead elsewhere.
    inside = _TRIAL_ID.fullmatch(trial_id) and folder.resolve().parent == root.resolve()
    if not inside or not (folder / LOG_NAME).is_file():
        raise RefusedError("no_such_trial", f"there is no trial {trial_id[:64]!r}")
    return folder


def header_line(trial_id: str, header: TrialHeader) -> bytes:
    """Return a log's first line."""
    fields = {"schema": SCHEMA_VERSION, "topic": "header", "id": trial_id, **asdict(header)}
    return orjson.dumps(fields, option=orjson.OPT_APPEND_NEWLINE | orjson.OPT_SERIALIZE_NUMPY)


def read_header(path: Path) -> TrialHeader:
    """Read a log's first line.

    Raises:
        ConfigError: If the file is no trial log, or of another schema version.
    """
    with path.open("rb") as file:
        line = file.readline()
    try:
        fields: dict[str, Any] = orjson.loads(line)
        schema = fields.pop("schema")
        if schema != SCHEMA_VERSION:
            raise ConfigError(f"{path}: log schema {schema}, but this version reads {SCHEMA_VERSION}")
        del fields["topic"], fields["id"]
        for name in ("start_px", "area_px"):
            if fields[name] is not None:
                fields[name] = tuple(fields[name])
        return TrialHeader(**fields)
    except (orjson.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"{path}: not a trial log ({error!r})") from None


def read_log(path: Path) -> Iterator[LogLine]:
    """Read a log's messages in order; a partial last line is ignored.

    Raises:
        ConfigError: If a line in the middle is damaged, naming it.
    """
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            if number == 1 or not line.endswith(b"\n"):
                continue
            try:
                yield _log_line(line)
            except (orjson.JSONDecodeError, KeyError) as error:
                raise ConfigError(f"{path}, line {number}: not a log line ({error!r})") from None


def list_trials(root: Path) -> list[TrialInfo]:
    """Return the trials under ``root``, oldest first; folders that hold no readable log are left out."""
    infos = []
    for trial_id in _ids(root):
        try:
            infos.append(read_trial(root, trial_id))
        except (ConfigError, RefusedError):
            continue
    return infos


def read_trial(root: Path, trial_id: str) -> TrialInfo:
    """Return one trial.

    Raises:
        RefusedError: ``no_such_trial``.
        ConfigError: If its log is not readable.
    """
    log = trial_folder(root, trial_id) / LOG_NAME
    return TrialInfo(trial_id, read_header(log), _status(log))


def mark_interrupted(root: Path, now_s: float, t_wall: float) -> list[str]:
    """Close the logs that a crash left open; return their trials' ids.

    A partial last line is cut off first, so that the file stays readable to its end.
    """
    marked = []
    for info in list_trials(root):
        if info.status != "running":
            continue
        log = trial_folder(root, info.id) / LOG_NAME
        whole = _whole_lines_bytes(log)
        last = _last_line(log)
        with log.open("r+b") as file:
            file.truncate(whole)
            file.seek(whole)
            seq = last.seq + 1 if last else 1
            file.write(
                log_line(seq, now_s, t_wall, CLOSED_TOPIC, {"status": "interrupted", "lost_lines": None})
            )
        marked.append(info.id)
    return marked


def log_line(seq: int, t_s: float, t_wall: float, topic: str, data: Mapping[str, object]) -> bytes:
    """Return one line of a log; a number that is not finite becomes null."""
    return orjson.dumps(
        {"seq": seq, "t_mono_ns": int(t_s * 1e9), "t_wall": t_wall, "topic": topic, "data": data},
        option=orjson.OPT_APPEND_NEWLINE | orjson.OPT_SERIALIZE_NUMPY,
    )


def _log_line(line: bytes) -> LogLine:
    fields = orjson.loads(line)
    return LogLine(
        fields["seq"], fields["t_mono_ns"] * 1e-9, fields["t_wall"], fields["topic"], fields["data"]
    )


def _status(log: Path) -> Status:
    last = _last_line(log)
    if last is None or last.topic != CLOSED_TOPIC:
        return "running"
    return "interrupted" if last.data.get("status") == "interrupted" else "ended"


def _last_line(log: Path) -> LogLine | None:
    """Return the last whole message; None if there is none but the header."""
    end = _whole_lines_bytes(log)
    start = _line_start(log, max(0, end - 1))
    with log.open("rb") as file:
        file.seek(start)
        line = file.read(end - start)
    try:
        return _log_line(line)
    except (KeyError, orjson.JSONDecodeError):
        return None


def _whole_lines_bytes(log: Path) -> int:
    """Return the length of the file up to its last newline."""
    return _line_start(log, log.stat().st_size)


def _line_start(log: Path, end: int) -> int:
    """Return where the line begins that goes on at a place, or begins there."""
    with log.open("rb") as file:
        while end > 0:
            start = max(0, end - _TAIL_BYTES)
            file.seek(start)
            newline = file.read(end - start).rfind(b"\n")
            if newline >= 0:
                return start + newline + 1
            end = start
    return 0


def _ids(root: Path) -> list[str]:
    if not root.is_dir():
        return []
    return sorted(path.name for path in root.iterdir() if _TRIAL_ID.fullmatch(path.name))
