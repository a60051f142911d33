"""Where a replay first departs from its recording."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeGuard


@dataclass(frozen=True, slots=True)
class Difference:
    """The first line that is not as recorded.

    Attributes:
        seq: The log's line; 0 for the trial's result.
        t_s: When it was recorded, monotonic, in seconds.
        topic: What it is.
        field: Which of its fields; "" if the replay did something else altogether.
        recorded: What the log says.
        replayed: What the replay gave.
    """

    seq: int
    t_s: float
    topic: str
    field: str
    recorded: object
    replayed: object

    def __str__(self) -> str:
        name = f"{self.topic}.{self.field}" if self.field else self.topic
        return f"line {self.seq}, {name}: recorded {self.recorded}, replayed {self.replayed}"


class DivergedError(Exception):
    """The replay is no longer the recording.

    Args:
        difference: Where it departs.
    """

    def __init__(self, difference: Difference) -> None:
        super().__init__(str(difference))
        self.difference = difference


def first_difference(
    recorded: object, replayed: object, field: str = ""
) -> tuple[str, object, object] | None:
    """Return the first field that differs, with both its values; None if all are exactly equal.

    Args:
        recorded: Any JSON.
        replayed: Any JSON.
        field: Name of both.
    """
    if isinstance(recorded, Mapping) and isinstance(replayed, Mapping):
        for name in (*recorded, *(name for name in replayed if name not in recorded)):
            inner = f"{field}.{name}" if field else str(name)
            differs = first_difference(recorded.get(name), replayed.get(name), inner)
            if differs is not None:
                return differs
        return None
    if _is_list(recorded) and _is_list(replayed) and len(recorded) == len(replayed):
        for index, pair in enumerate(zip(recorded, replayed, strict=True)):
            differs = first_difference(*pair, f"{field}[{index}]")
            if differs is not None:
                return differs
        return None
    return None if recorded == replayed else (field, recorded, replayed)


def _is_list(value: object) -> TypeGuard[Sequence[object]]:
    return isinstance(value, Sequence) and not isinstance(value, str)
