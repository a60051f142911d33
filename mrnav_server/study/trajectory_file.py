"""Reads a trajectory from a CSV file with the columns t_s, x_um, y_um, whoever made it."""

import csv
import math
from pathlib import Path

import numpy as np

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.errors import ConfigError

COLUMNS = ("t_s", "x_um", "y_um")
_FEWEST = 4
_MISSING = {"", "nan", "na", "null", "none"}


def read_trajectory(path: Path) -> tuple[FloatArray, FloatArray]:
    """Return capture times in seconds, shape (n,), and positions in µm, shape (n, 2).

    An empty or NaN position says that the robot was not seen; further columns are ignored.

    Raises:
        ConfigError: If something is wrong, naming column and line and the remedy.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            reader.fieldnames = columns = [name.strip() for name in reader.fieldnames or ()]
            lacking = [name for name in COLUMNS if name not in columns]
            if lacking:
                raise ConfigError(
                    f"{path}: the first line lacks {', '.join(lacking)}"
                    f" (it has {', '.join(columns) or 'nothing'}); write {','.join(COLUMNS)},"
                    " with times in seconds and positions in µm"
                )
            rows: list[list[float]] = []
            for fields in reader:
                where = f"{path}, line {reader.line_num}"
                row = _row(fields, where)
                if rows and row[0] < rows[-1][0]:
                    raise ConfigError(
                        f"{where}: column t_s falls from {rows[-1][0]:g} to {row[0]:g};"
                        " sort the rows by time, one trial a file"
                    )
                rows.append(row)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path} is not readable as CSV text: {error}") from None
    if len(rows) < _FEWEST:
        raise ConfigError(
            f"{path} holds {len(rows)} positions; the filters need 0.7 s of them, 30 a second or so"
        )
    table = np.array(rows, dtype=np.float64)
    return table[:, 0], table[:, 1:]


def _row(fields: dict[str, str | None], where: str) -> list[float]:
    t_s, *place_um = (_number(fields[name], f"{where}: column {name}") for name in COLUMNS)
    if math.isnan(t_s):
        raise ConfigError(f"{where}: column t_s is empty; every row needs the time of its picture in seconds")
    return [t_s, *place_um]


def _number(text: str | None, where: str) -> float:
    shown = (text or "").strip()
    if shown.lower() in _MISSING:
        return math.nan
    try:
        value = float(shown)
    except ValueError:
        value = math.inf
    if math.isinf(value):
        raise ConfigError(
            f"{where} holds {shown[:40]!r}; write a finite number, or nothing where the robot was not seen"
        )
    return value
