"""A trial as an MCAP file: a channel a topic, the rows as JSON with JSON Schemas, and what Foxglove draws.

Every message of a topic's channel is the row of its table, so all formats say the same.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import orjson

from mrnav_server.core.errors import ConfigError
from mrnav_server.study.export_foxglove import SCHEMAS, Drawing, foxglove_messages
from mrnav_server.study.export_rows import Row, TrialRows, wall_ns
from mrnav_server.study.export_topics import LABELS, Column, Topic, topic_named

if TYPE_CHECKING:
    from mcap.writer import Writer

TRIAL_RECORD = "trial"
SCHEMA_PREFIX = "mrnav."
_TYPES: Mapping[str, dict[str, Any]] = {
    "float": {"type": "number"},
    "int": {"type": "integer"},
    "bool": {"type": "boolean"},
    "text": {"type": "string"},
    "time": {"type": "string", "format": "date-time"},
    "json": {"type": "string", "contentMediaType": "application/json"},
}


def write_mcap(file: Path, trial: TrialRows, drawing: Drawing) -> None:
    """Write a trial.

    Args:
        file: Where to.
        trial: The trial.
        drawing: What Foxglove draws beside the rows.
    """
    from mcap.writer import CompressionType, Writer

    with file.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="", library="mrnav-server")
        writer.add_metadata(TRIAL_RECORD, {name: _text(value) for name, value in trial.summary.items()})
        channels = _Channels(writer, {name: _text(value) for name, value in trial.labels.items()})
        for topic, row in trial.messages:
            message = {name: value for name, value in row.items() if value is not None}
            channels.add(
                topic.name,
                SCHEMA_PREFIX + topic.name,
                partial(json_schema, topic),
                orjson.dumps(message, option=orjson.OPT_UTC_Z),
                logged_ns=round(row["logged_epoch_s"] * 1e9),
                happened_ns=wall_ns(row),
                sequence=row["seq"],
            )
        for channel, schema, stamp_ns, fields in foxglove_messages(trial, drawing):
            channels.add(
                channel,
                schema,
                partial(SCHEMAS.__getitem__, schema),
                orjson.dumps(fields),
                stamp_ns,
                stamp_ns,
            )
        writer.finish()  # type: ignore[no-untyped-call]


def read_mcap(file: Path) -> tuple[dict[str, str], Iterator[tuple[Topic, Row]]]:
    """Return a trial's summary and its rows; what was written for Foxglove alone is left out.

    Raises:
        ConfigError: If the file is no export of a trial.
    """
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    def rows() -> Iterator[tuple[Topic, Row]]:
        with file.open("rb") as stream:
            for schema, channel, message in make_reader(stream).iter_messages(log_time_order=False):
                if schema is not None and schema.name.startswith(SCHEMA_PREFIX):
                    yield topic_named(channel.topic.removeprefix("/")), orjson.loads(message.data)

    try:
        with file.open("rb") as stream:
            records = {each.name: dict(each.metadata) for each in make_reader(stream).iter_metadata()}
    except (OSError, McapError) as error:
        raise ConfigError(f"{file} is not readable as MCAP: {error}") from None
    if TRIAL_RECORD not in records:
        raise ConfigError(f"{file} has no metadata record {TRIAL_RECORD!r}: import what mrnav export wrote")
    return records[TRIAL_RECORD], rows()


def json_schema(topic: Topic) -> dict[str, Any]:
    """Return the JSON Schema of a topic's messages, with units and meanings."""
    labels = {each.name for each in LABELS}
    columns = [each for each in topic.columns if each.name not in labels]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": SCHEMA_PREFIX + topic.name,
        "description": topic.meaning,
        "type": "object",
        "properties": {each.name: _TYPES[each.kind] | {"description": _described(each)} for each in columns},
        "required": ["seq", "t_s", "wall_time", "logged_mono_ns", "logged_epoch_s"],
    }


class _Channels:
    """Registers schemas and channels when the first message asks for them."""

    def __init__(self, writer: "Writer", labels: dict[str, str]) -> None:
        self._writer = writer
        self._labels = labels
        self._ids: dict[str, int] = {}

    def add(
        self,
        topic: str,
        schema: str,
        fields: Callable[[], object],
        data: bytes,
        logged_ns: int,
        happened_ns: int,
        sequence: int = 0,
    ) -> None:
        if topic not in self._ids:
            schema_id = self._writer.register_schema(schema, "jsonschema", orjson.dumps(fields()))
            self._ids[topic] = self._writer.register_channel(f"/{topic}", "json", schema_id, self._labels)
        self._writer.add_message(self._ids[topic], logged_ns, data, happened_ns, sequence)


def _described(column: Column) -> str:
    return f"{column.meaning} [{column.unit}]" if column.unit else column.meaning


def _text(value: object) -> str:
    """Return a value for a record that holds text alone: JSON's for everything that is no text."""
    if isinstance(value, str):
        return value
    return orjson.dumps(value, option=orjson.OPT_UTC_Z).decode().strip('"')
