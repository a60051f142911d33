"""Strict JSON: one line of at most 4096 bytes to checked fields, and a message to one line.

Nothing here trusts the peer: every field is checked for its type and range, and what is missing or left
over is an error that names the field.
"""

import json
import math
from collections.abc import Mapping

from mrnav_server.core.errors import WireError

MAX_LINE_BYTES = 4096
MAX_WHOLE = 2**53 - 1
"""Largest whole number that every JSON implementation keeps exactly."""


class NumberError(WireError):
    """A number that measures nothing: not finite, or out of range. Reaction: drop the line and count it.

    Args:
        message: One sentence for a person.
    """

    def __init__(self, message: str) -> None:
        super().__init__("bad_number", message)


class Fields:
    """The fields of one message, taken out one by one.

    Args:
        line: One line, with or without its newline.

    Raises:
        NumberError: If the line holds NaN or Infinity.
        WireError: ``line_too_long``, or ``bad_json`` if it is not one JSON object in UTF-8.
    """

    def __init__(self, line: bytes) -> None:
        if len(line) > MAX_LINE_BYTES:
            raise WireError("line_too_long", f"a line has at most {MAX_LINE_BYTES} bytes, not {len(line)}")
        try:
            parsed: object = _DECODER.decode(line.decode("utf-8"))
        except ValueError as error:
            raise WireError("bad_json", f"the line is not JSON in UTF-8 ({_shown(str(error))})") from None
        except RecursionError:
            raise WireError("bad_json", "the line is nested too deeply") from None
        if not isinstance(parsed, dict):
            raise WireError("bad_json", "the line must be one JSON object")
        self._fields: dict[str, object] = parsed

    def has(self, name: str) -> bool:
        """Tell whether an optional field is there."""
        return name in self._fields

    def text(self, name: str, max_chars: int = 64) -> str:
        """Take printable text."""
        value = self._take(name)
        if not isinstance(value, str):
            raise WireError("bad_message", f"{name} must be text")
        # A lone surrogate or a control character would break the lines that carry this text onwards.
        if len(value) > max_chars or not value.isprintable():
            raise WireError("bad_message", f"{name} must be printable text of at most {max_chars} characters")
        return value

    def flag(self, name: str) -> bool:
        """Take true or false."""
        value = self._take(name)
        if not isinstance(value, bool):
            raise WireError("bad_message", f"{name} must be true or false")
        return value

    def whole(self, name: str, low: int = 0, high: int = MAX_WHOLE) -> int:
        """Take a whole number within ``low..high``."""
        value = self._take(name)
        if isinstance(value, bool) or not isinstance(value, int):
            raise WireError("bad_message", f"{name} must be a whole number")
        if not low <= value <= high:
            raise NumberError(f"{name} must lie between {low} and {high}")
        return value

    def number(self, name: str, low: float, high: float) -> float:
        """Take a finite number within ``low..high``."""
        return _number(name, self._take(name), low, high)

    def vector(self, name: str, bound: float) -> tuple[float, float, float]:
        """Take a list of three finite numbers within ``-bound..bound``."""
        value = self._take(name)
        if not isinstance(value, list) or len(value) != 3:
            raise WireError("bad_message", f"{name} must be a list of three numbers")
        x, y, z = (_number(f"{name}[{axis}]", item, -bound, bound) for axis, item in enumerate(value))
        return x, y, z

    def finish(self) -> None:
        """Check that nothing is left over.

        Raises:
            WireError: ``bad_message``, naming the first unknown field.
        """
        if self._fields:
            raise WireError("bad_message", f"unknown field {_shown(next(iter(self._fields)))}")

    def _take(self, name: str) -> object:
        if name not in self._fields:
            raise WireError("bad_message", f"the field {name} is missing")
        return self._fields.pop(name)


def encode_line(message: Mapping[str, object]) -> bytes:
    """Return a message as one line of JSON with its newline.

    Raises:
        ValueError: If it holds a number that is not finite.
    """
    return json.dumps(message, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def _number(name: str, value: object, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise WireError("bad_message", f"{name} must be a number")
    if isinstance(value, float) and not math.isfinite(value):
        raise NumberError(f"{name} must be finite")
    if not low <= value <= high:
        raise NumberError(f"{name} must lie between {low:g} and {high:g}")
    return float(value)


def _refuse_constant(name: str) -> object:
    raise NumberError(f"{name} is not a number")


def _unique_fields(pairs: list[tuple[str, object]]) -> dict[str, object]:
    fields = dict(pairs)
    if len(fields) < len(pairs):
        raise WireError("bad_message", "a field is there twice")
    return fields


def _shown(text: str) -> str:
    """Return a peer's text so that it can be printed: short and escaped."""
    return ascii(text[:60])


_DECODER = json.JSONDecoder(parse_constant=_refuse_constant, object_pairs_hook=_unique_fields)
