"""Writes single settings into a TOML file and leaves every other line as it is."""

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mrnav_server.core.errors import ConfigError

Value = str | float


def store(path: Path, section: str, values: Mapping[str, Value]) -> None:
    """Set values in a section of a settings file, which is made if there is none.

    Args:
        path: The file.
        section: Name of the section.
        values: Names and values.

    Raises:
        ConfigError: If the file cannot be read or written, or lays the section out in another way than
            ``[section]`` with a line for each value; the message says which lines to add by hand.
    """
    try:
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        before = tomllib.loads(text)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path} cannot be read ({error}): {_by_hand(section, values)}") from None
    lines = _changed(text.splitlines(), section, values)
    wanted: dict[str, Any] = {**before, section: {**before.get(section, {}), **values}}
    made = "\n".join(lines) + "\n"
    if not _means(made, wanted):
        raise ConfigError(f"{path} has no plain section [{section}]: {_by_hand(section, values)}")
    draft = path.with_name(path.name + ".draft")
    try:
        draft.write_text(made, encoding="utf-8")
        draft.replace(path)
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be written ({error.strerror}): {_by_hand(section, values)}"
        ) from None


def _changed(lines: list[str], section: str, values: Mapping[str, Value]) -> list[str]:
    """Return the lines of a file with the values set."""
    header = re.compile(rf"\s*\[\s*{re.escape(section)}\s*\]\s*(#.*)?$")
    start = next((at for at, line in enumerate(lines) if header.match(line)), None)
    if start is None:
        gap = [""] if lines and lines[-1].strip() else []
        return [*lines, *gap, f"[{section}]", *(_line(name, value) for name, value in values.items())]
    after = range(start + 1, len(lines))
    end = next((at for at in after if lines[at].lstrip().startswith("[")), len(lines))
    body, added = lines[start + 1 : end], []
    for name, value in values.items():
        found = next((at for at, line in enumerate(body) if re.match(rf"\s*{name}\s*=", line)), None)
        if found is None:
            added.append(_line(name, value))
        else:
            body[found] = _line(name, value)
    return [*lines[: start + 1], *added, *body, *lines[end:]]


def _means(text: str, wanted: dict[str, Any]) -> bool:
    """Whether a file says what it should."""
    try:
        return tomllib.loads(text) == wanted
    except tomllib.TOMLDecodeError:
        return False


def _line(name: str, value: Value) -> str:
    return f'{name} = "{value}"' if isinstance(value, str) else f"{name} = {value}"


def _by_hand(section: str, values: Mapping[str, Value]) -> str:
    lines = ", ".join(_line(name, value) for name, value in values.items())
    return f"write into section [{section}] by hand: {lines}"
