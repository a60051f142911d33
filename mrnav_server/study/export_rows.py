"""A trial's log as rows of tables, and rows as a log again, to the last byte."""

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import orjson

from mrnav_server.core.errors import ConfigError
from mrnav_server.loops.tlx_record import TLX_NAME
from mrnav_server.loops.trial_log import LOG_NAME, TrialInfo
from mrnav_server.study.export_topics import AS_LOGGED, Column, Field, Topic, topic_named

Row = dict[str, Any]
_INT_LIMIT = 2**63
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass
class TrialRows:
    """A trial, ready for every format.

    Attributes:
        id: The trial's id.
        labels: Whose it is; every row holds them.
        summary: Its row in the table ``trials``.
        header: The fields of its log's first line.
        messages: Topic and row of every line, in the log's order.
    """

    id: str
    labels: Row
    summary: Row
    header: Mapping[str, Any]
    messages: list[tuple[Topic, Row]] = field(default_factory=list)

    @property
    def counts(self) -> dict[str, int]:
        """Rows by topic."""
        counts: dict[str, int] = {}
        for topic, _ in self.messages:
            counts[topic.name] = counts.get(topic.name, 0) + 1
        return counts


def trial_rows(folder: Path, info: TrialInfo, *, result: bool) -> TrialRows:
    """Read a trial's log; a last line that is not whole is left out.

    Args:
        folder: The trial's folder.
        info: The trial.
        result: Whether it is a result of its study.

    Raises:
        ConfigError: If a line is damaged, naming it.
    """
    log = folder / LOG_NAME
    header_line, *raw_lines = _whole_lines(log)
    header, lines = orjson.loads(header_line), list(_lines(log, raw_lines))
    labels = {
        "trial": info.id,
        "participant": info.header.participant,
        "condition": info.header.condition,
        "model": info.header.vessel,
        "operator_kind": info.header.operator_kind,
        "simulated_rig": info.header.simulated_rig,
    }
    start_s, start_wall = _start(lines)
    rows = TrialRows(info.id, labels, {}, header)
    for line, raw in zip(lines, raw_lines, strict=True):
        topic = topic_named(line["topic"])
        row = _row(topic, line, start_s, info.header.um_per_px)
        if log_bytes(topic, row) != raw:
            row[AS_LOGGED.name] = orjson.dumps(line["data"]).decode()
        rows.messages.append((topic, row))
    area_px, tlx = info.header.area_px or (None, None), folder / TLX_NAME
    rows.summary = labels | {
        "status": info.status,
        "result": result,
        "reached": any(line["topic"] == "trial" and line["data"].get("mark") == "reached" for line in lines),
        "start_time": _wall(start_wall) if lines else None,
        "duration_s": lines[-1]["t_mono_ns"] * 1e-9 - start_s if lines else None,
        "lines": len(lines),
        "um_per_px": info.header.um_per_px,
        "area_x_px": area_px[0],
        "area_y_px": area_px[1],
        "area_epsilon_um": info.header.area_epsilon_um,
        "software_version": info.header.software_version,
        "log_sha256": log_digest([header_line, *raw_lines]),
        "header_json": header_line.decode().removesuffix("\n"),
        "tlx_json": tlx.read_text() if tlx.is_file() else None,
    }
    return rows


def log_bytes(topic: Topic, row: Mapping[str, Any]) -> bytes:
    """Return the log's line that a row was made from."""
    whole = row.get(AS_LOGGED.name)
    fields = {
        "seq": row["seq"],
        "t_mono_ns": row["logged_mono_ns"],
        "t_wall": row["logged_epoch_s"],
        "topic": topic.name,
        "data": orjson.Fragment(whole) if whole is not None else _gathered(topic, row),
    }
    return orjson.dumps(fields, option=orjson.OPT_APPEND_NEWLINE)


def log_digest(lines: Iterable[bytes]) -> str:
    """Return the SHA-256 of a log's lines."""
    digest = hashlib.sha256()
    for line in lines:
        digest.update(line)
    return digest.hexdigest()


def wall_ns(row: Row) -> int:
    """Return when a row happened, in ns since 1970, as precisely as its wall time says."""
    since: timedelta = row["wall_time"] - _EPOCH
    return ((since.days * 86_400 + since.seconds) * 1_000_000 + since.microseconds) * 1000


def _whole_lines(log: Path) -> list[bytes]:
    content = log.read_bytes()
    return content[: content.rfind(b"\n") + 1].splitlines(keepends=True)


def _lines(log: Path, raw_lines: list[bytes]) -> Iterator[dict[str, Any]]:
    for number, raw in enumerate(raw_lines, start=2):
        try:
            line = orjson.loads(raw)
            _ = float(line["t_wall"]), int(line["t_mono_ns"]), int(line["seq"]), dict(line["data"])
        except (orjson.JSONDecodeError, KeyError, TypeError, ValueError) as error:
            raise ConfigError(f"{log}, line {number}: not a log line ({error!r})") from None
        yield line


def _start(lines: list[dict[str, Any]]) -> tuple[float, float]:
    """Return when the trial began, monotonic and by the wall clock: its mark, else its first line."""
    for line in lines:
        if line["topic"] == "trial" and line["data"].get("mark") == "start":
            return line["t_mono_ns"] * 1e-9, line["t_wall"]
    return (lines[0]["t_mono_ns"] * 1e-9, lines[0]["t_wall"]) if lines else (0.0, 0.0)


def _row(topic: Topic, line: Mapping[str, Any], start_s: float, um_per_px: float) -> Row:
    data, logged_s = line["data"], line["t_mono_ns"] * 1e-9
    own = data.get(topic.own_time)
    happened_s = own if isinstance(own, float) else logged_s
    row: Row = {
        "seq": line["seq"],
        "t_s": happened_s - start_s,
        "wall_time": _wall(line["t_wall"] - logged_s + happened_s),
        "logged_mono_ns": line["t_mono_ns"],
        "logged_epoch_s": line["t_wall"],
    }
    for each in topic.fields:
        row.update(_spread(each, data.get(each.key)))
    if topic.name == "track" and row["vessel_x_px"] is not None:
        row |= {"x_um": row["vessel_x_px"] * um_per_px, "y_um": row["vessel_y_px"] * um_per_px}
    return row


def _spread(field: Field, value: object) -> Iterator[tuple[str, Any]]:
    """Yield a field's cells; one that does not fit its column stays empty."""
    if not field.is_vector:
        yield field.columns[0].name, _cell(field.columns[0], value)
        return
    fits = isinstance(value, list) and len(value) == len(field.columns)
    for at, column in enumerate(field.columns):
        yield column.name, _cell(column, value[at]) if fits and isinstance(value, list) else None


def _cell(column: Column, value: object) -> float | str | None:
    match column.kind, value:
        case "bool", bool():
            return value
        case "float" | "int", bool():
            return None  # Python counts truth values among the numbers
        case "float", int() | float():
            return float(value)
        case "int", int() if -_INT_LIMIT <= value < _INT_LIMIT:
            return value
        case "text" | "json", str():
            return value
    return None


def _gathered(topic: Topic, row: Mapping[str, Any]) -> dict[str, Any]:
    data: dict[str, Any] = {}
    for each in topic.fields:
        cells = [row.get(column.name) for column in each.columns]
        if any(cell is not None for cell in cells):
            data[each.key] = cells if each.is_vector else cells[0]
        elif not each.optional:
            data[each.key] = None
    return data


def _wall(epoch_s: float) -> datetime:
    return datetime.fromtimestamp(epoch_s, UTC)
