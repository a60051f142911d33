"""What participants tell about themselves, if they wish: kept by code, apart from everything they did."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import orjson
from pydantic import Field, TypeAdapter, ValidationError

from mrnav_server.core.errors import ConfigError

DEMOGRAPHICS_NAME = "demographics.json"

Sex = Literal["female", "male", "diverse"]
Experience = Literal["none", "some", "much"]


@dataclass(frozen=True, slots=True)
class Demographics:
    """One participant; everything may be left out.

    Attributes:
        age_years: 16 to 120.
        sex: As told.
        mr_experience: With mixed reality.
        micromanipulation_experience: With micromanipulators.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    age_years: Annotated[int, Field(ge=16, le=120)] | None = None
    sex: Sex | None = None
    mr_experience: Experience | None = None
    micromanipulation_experience: Experience | None = None


_FILE = TypeAdapter(dict[str, Demographics])


def read_demographics(folder: Path) -> dict[str, Demographics]:
    """Return what is known, by code; nothing without the file.

    Raises:
        ConfigError: If the file is damaged.
    """
    file = folder / DEMOGRAPHICS_NAME
    if not file.exists():
        return {}
    try:
        return _FILE.validate_json(file.read_bytes())
    except ValidationError as error:
        raise ConfigError(f"{file}: {error.errors(include_url=False)[0]['msg']}") from None


def keep_demographics(folder: Path, code: str, told: Demographics) -> None:
    """Keep what one participant told, readable by this user alone; it replaces what was told before."""
    known = read_demographics(folder) | {code: told}
    file = folder / DEMOGRAPHICS_NAME
    part = file.with_suffix(".part")
    part.touch(mode=0o600)
    fields = {key: dataclasses.asdict(known[key]) for key in sorted(known)}
    part.write_bytes(orjson.dumps(fields, option=orjson.OPT_INDENT_2) + b"\n")
    part.replace(file)
