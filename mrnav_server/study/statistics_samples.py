"""What the statistics are computed from: values of one measure under two conditions (docs/statistics.md)."""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.errors import ConfigError

_NEEDED = ("participant", "condition", "value")
_METRIC = "metric"
_MISSING = {"", "nan", "na", "null", "none"}


@dataclass(frozen=True, slots=True)
class Sample:
    """One trial's value of a measure.

    Attributes:
        participant: Who.
        condition: Under which condition.
        value: NaN where the trial does not define it.
    """

    participant: str
    condition: str
    value: float


@dataclass(frozen=True, slots=True)
class Pairs:
    """One mean per participant and condition.

    Attributes:
        participants: Those who have both, sorted; length n.
        first, second: Their means under the two conditions, shape (n,).
        left_out: Participants who lack one of the two.
    """

    participants: tuple[str, ...]
    first: FloatArray
    second: FloatArray
    left_out: tuple[str, ...]

    @property
    def differences(self) -> FloatArray:
        """First minus second, shape (n,)."""
        return self.first - self.second


@dataclass(frozen=True, slots=True)
class Samples:
    """The values of one measure under two conditions.

    Attributes:
        rows: All of them.
        first, second: The conditions; differences are first minus second.
    """

    rows: tuple[Sample, ...]
    first: str
    second: str

    @property
    def missing(self) -> int:
        """How many rows hold no value."""
        return sum(math.isnan(row.value) for row in self.rows)

    def pooled(self, condition: str) -> FloatArray:
        """Return every value under a condition, whoever it is from, shape (n,)."""
        return np.array([r.value for r in self.rows if r.condition == condition and not math.isnan(r.value)])

    def pairs(self) -> Pairs:
        """Return each participant's mean under either condition."""
        means = {each: self._means(each) for each in sorted({row.participant for row in self.rows})}
        whole = [name for name, pair in means.items() if not any(map(math.isnan, pair))]
        return Pairs(
            participants=tuple(whole),
            first=np.array([means[name][0] for name in whole]),
            second=np.array([means[name][1] for name in whole]),
            left_out=tuple(name for name in means if name not in whole),
        )

    def _means(self, participant: str) -> tuple[float, float]:
        own = [row for row in self.rows if row.participant == participant and not math.isnan(row.value)]
        first = [row.value for row in own if row.condition == self.first]
        second = [row.value for row in own if row.condition == self.second]
        return _mean(first), _mean(second)


def samples(rows: Sequence[Sample], what: str = "the rows") -> Samples:
    """Return rows as samples under two conditions, in the order of their names.

    Raises:
        ConfigError: If there are not two conditions, naming those there are.
    """
    conditions = sorted({row.condition for row in rows})
    if len(conditions) != 2:
        found = ", ".join(conditions) or "none"
        raise ConfigError(f"{what}: column condition must hold two conditions to compare, not {found}")
    return Samples(tuple(rows), conditions[0], conditions[1])


def read_samples(path: Path) -> dict[str, Samples]:
    """Read a CSV file with the columns participant, condition, value.

    With a column ``metric`` too, the file holds one measure per name; else its one measure is called "value".

    Returns:
        The samples by measure, in the file's order.

    Raises:
        ConfigError: If something is wrong, naming column and row and the remedy.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            columns = [name.strip() for name in reader.fieldnames or ()]
            lacking = [name for name in _NEEDED if name not in columns]
            if lacking:
                raise ConfigError(
                    f"{path}: the first line lacks {', '.join(lacking)}"
                    f" (it has {', '.join(columns) or 'nothing'}); write participant,condition,value"
                )
            reader.fieldnames = columns
            measures: dict[str, list[Sample]] = {}
            for fields in reader:
                where = f"{path}, line {reader.line_num}"
                measures.setdefault((fields.get(_METRIC) or "value").strip(), []).append(
                    _sample(fields, where)
                )
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path} is not readable as CSV text: {error}") from None
    if not measures:
        raise ConfigError(
            f"{path} holds no rows: write one line per trial, for example P01,with_autonomy,11.4"
        )
    return {
        name: samples(rows, f"{path}" + (f", metric {name}" if len(measures) > 1 else ""))
        for name, rows in measures.items()
    }


def _sample(fields: dict[str, str | None], where: str) -> Sample:
    texts = {name: (fields[name] or "").strip() for name in _NEEDED}
    for name in ("participant", "condition"):
        if not texts[name]:
            raise ConfigError(f"{where}: column {name} is empty; every row needs one")
    if texts["value"].lower() in _MISSING:
        return Sample(texts["participant"], texts["condition"], math.nan)
    try:
        value = float(texts["value"])
    except ValueError:
        value = math.inf
    if math.isinf(value):
        raise ConfigError(
            f"{where}: column value holds {texts['value']!r};"
            " write a finite number, or nothing where there is none"
        )
    return Sample(texts["participant"], texts["condition"], value)


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else math.nan
