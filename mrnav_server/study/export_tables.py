"""The tables of an export as CSV and Parquet files: one file a topic, the trials one after the other."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

from mrnav_server.core.errors import ConfigError
from mrnav_server.study.export_rows import Row, TrialRows
from mrnav_server.study.export_topics import TRIALS_TABLE, Column, Topic, topic_named

if TYPE_CHECKING:
    import pyarrow as pa

TRIALS_TABLE_NAME = "trials"
TableFormat = Literal["csv", "parquet"]


class _TableFile(Protocol):
    def write_table(self, table: "pa.Table") -> None: ...
    def close(self) -> None: ...


class TableWriter:
    """Writes trials into tables; closing it finishes the files.

    Args:
        folder: Exists, and gets the files.
        form: Their format.
    """

    def __init__(self, folder: Path, form: TableFormat) -> None:
        self._folder = folder
        self._form = form
        self._writers: dict[str, _TableFile] = {}

    def __enter__(self) -> "TableWriter":
        return self

    def __exit__(self, *_: object) -> None:
        for writer in self._writers.values():
            writer.close()

    def write(self, trial: TrialRows) -> None:
        """Append a trial."""
        rows: dict[str, list[Row]] = {}
        columns: dict[str, tuple[Column, ...]] = {}
        for topic, row in trial.messages:
            rows.setdefault(topic.name, []).append(row)
            columns.setdefault(topic.name, topic.columns)
        self._append(TRIALS_TABLE_NAME, TRIALS_TABLE, [trial.summary], {})
        for name, found in rows.items():
            self._append(name, columns[name], found, trial.labels)

    def _append(self, name: str, columns: tuple[Column, ...], rows: list[Row], labels: Row) -> None:
        import pyarrow as pa

        schema = arrow_schema(columns)
        arrays = [
            pa.repeat(pa.scalar(labels[field.name], field.type), len(rows))
            if field.name in labels
            else pa.array([row.get(field.name) for row in rows], field.type)
            for field in schema
        ]
        table = pa.Table.from_arrays(arrays, schema=schema)
        if name not in self._writers:
            self._writers[name] = _open(self._folder / f"{name}.{self._form}", self._form, schema)
        self._writers[name].write_table(table)


def read_tables(folder: Path, form: TableFormat) -> Iterator[tuple[str, "pa.Table"]]:
    """Yield every table of an export's folder by its name, the trials' first.

    Raises:
        ConfigError: If a file or a column is missing, or not readable, with the remedy.
    """
    trials = folder / f"{TRIALS_TABLE_NAME}.{form}"
    if not trials.is_file():
        raise ConfigError(f"{trials} is missing: import a whole export, as mrnav export wrote it")
    yield TRIALS_TABLE_NAME, _read(trials, form, TRIALS_TABLE)
    for file in sorted(folder.glob(f"*.{form}")):
        if file != trials:
            yield file.stem, _read(file, form, topic_named(file.stem).columns)


def table_topics(table: "pa.Table", topic: Topic) -> Iterator[tuple[str, Row]]:
    """Yield the trial and the cells of every row of a topic's table, without what was derived."""
    needed = ["seq", "logged_mono_ns", "logged_epoch_s", "as_logged_json"]
    needed += [column.name for field in topic.fields for column in field.columns]
    trials = table.column("trial").to_pylist()
    cells = [table.column(name).to_pylist() for name in needed]
    for trial, *row in zip(trials, *cells, strict=True):
        yield trial, dict(zip(needed, row, strict=True))


def arrow_schema(columns: Iterable[Column]) -> "pa.Schema":
    """Return Arrow's schema: unit and meaning of a column are in its metadata."""
    import pyarrow as pa

    types: Mapping[str, pa.DataType] = {
        "float": pa.float64(),
        "int": pa.int64(),
        "bool": pa.bool_(),
        "text": pa.string(),
        "time": pa.timestamp("us", tz="UTC"),
        "json": pa.string(),
    }
    return pa.schema(
        [
            pa.field(each.name, types[each.kind], metadata={"unit": each.unit, "meaning": each.meaning})
            for each in columns
        ]
    )


def _open(file: Path, form: TableFormat, schema: "pa.Schema") -> _TableFile:
    if form == "parquet":
        from pyarrow.parquet import ParquetWriter

        parquet: _TableFile = ParquetWriter(file, schema, compression="zstd")
        return parquet
    from pyarrow.csv import CSVWriter

    text: _TableFile = CSVWriter(file, schema)
    return text


def _read(file: Path, form: TableFormat, columns: tuple[Column, ...]) -> "pa.Table":
    import pyarrow as pa

    try:
        table = _read_csv(file, columns) if form == "csv" else _read_parquet(file)
        lacking = [each.name for each in columns if each.name not in table.column_names]
        if lacking:
            raise ConfigError(f"{file} lacks the column {lacking[0]}: import the table with all its columns")
        for field in arrow_schema(columns):
            found = table.column(field.name)
            if found.type != field.type and field.type != pa.timestamp("us", tz="UTC"):
                place = table.column_names.index(field.name)
                try:
                    table = table.set_column(place, field, found.cast(field.type))
                except pa.ArrowInvalid as error:
                    raise ConfigError(f"{file}, column {field.name}: {error}") from None
    except (OSError, pa.ArrowException) as error:
        raise ConfigError(f"{file} is not readable as {form}: {error}") from None
    return table


def _read_parquet(file: Path) -> "pa.Table":
    from pyarrow.parquet import ParquetFile

    with ParquetFile(file) as opened:
        return opened.read()


def _read_csv(file: Path, columns: tuple[Column, ...]) -> "pa.Table":
    """Read every column as text: what no number can be made of is then told by the column's name."""
    import pyarrow as pa
    from pyarrow import csv

    return csv.read_csv(
        file,
        parse_options=csv.ParseOptions(newlines_in_values=True),
        convert_options=csv.ConvertOptions(
            column_types=dict.fromkeys((each.name for each in columns), pa.string()),
            null_values=[""],
            strings_can_be_null=True,
            # "" is a text without letters; nothing at all is no text.
            quoted_strings_can_be_null=False,
        ),
    )
