"""A sweep: lists that are multiplied into jobs, and what becomes of each job.

A job is plain data. Its folder is named by the hash of that data, so that the same job is done once.
"""

import hashlib
import itertools
import json
import math
import tomllib
from collections.abc import Callable, Generator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from mrnav_server.core.errors import ConfigError
from mrnav_server.training.sweep_job import assignments, clear, read_error, read_result
from mrnav_server.vision.model_store import find_model, models_root
from mrnav_server.vision.vessel_model import read_model_json

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

MAX_RETRIES = 3
"""How often a job is started again after its worker died."""

Algorithm = Literal["ppo", "a2c"]
Value = bool | int | float | str


def _listed(value: object) -> object:
    return value if isinstance(value, list) else [value]


def _plain(value: object) -> object:
    if not isinstance(value, bool | int | float | str):
        raise ValueError("should be a number, a text, true or false")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError("should be a finite number")
    return value


_T = TypeVar("_T")
_OneOrMore = Annotated[list[_T], BeforeValidator(_listed), Field(min_length=1)]
_Name = Annotated[str, Field(min_length=1)]
_Seed = Annotated[int, Field(ge=0, strict=True)]
_Setting = Annotated[Any, AfterValidator(_plain)]


@dataclass(frozen=True, slots=True)
class Job:
    """One training and its evaluation, as data.

    Attributes:
        model: Name of a shipped vessel model, or the absolute path of a model's folder.
        map_sha256: Hash of the model's mask: another vessel under the same name is another job.
        preset: Recipe.
        algo: ``ppo`` or ``a2c``.
        seed: Of everything random.
        settings: Hyper-parameters that differ from the preset, sorted by name.
        pairs: Random pairs of each evaluation.
    """

    model: str
    map_sha256: str
    preset: str
    algo: Algorithm
    seed: int
    settings: tuple[tuple[str, Value], ...]
    pairs: int

    def spec(self) -> dict[str, Any]:
        """Return the job as JSON."""
        return {**{k: v for k, v in asdict(self).items() if k != "settings"}, "set": dict(self.settings)}

    @property
    def name(self) -> str:
        """Hash of the spec, 16 hex digits: the name of the job's folder."""
        return spec_hash(self.spec())

    @property
    def title(self) -> str:
        """The job in a few words, for people."""
        changed = "".join(f", {key}={value}" for key, value in self.settings)
        return f"{Path(self.model).name}, {self.preset}, {self.algo}, seed {self.seed}{changed}"


class PooledJob(Protocol):
    """Whatever can be done in a process of its own and leaves a folder; a training is one kind."""

    def spec(self) -> dict[str, Any]:
        """Return all that its process must know, as JSON."""

    @property
    def name(self) -> str:
        """Name of its folder."""

    @property
    def title(self) -> str:
        """It in a few words, for people."""


Work = Callable[[dict[str, Any], Path], None]
"""Does a job, given its spec and its folder, and leaves a result or an error there; importable by name."""


class Sweep(BaseModel):
    """What a sweep's file holds: lists, each multiplied with every other. One value stands for a list of one.

    Attributes:
        models: Vessel models: names or folders.
        presets: Recipes.
        algos: ``ppo``, ``a2c``.
        seeds: One job per seed.
        set: Lists of values by the name of a hyper-parameter, as ``mrnav train --set`` names it.
        pairs: Random pairs of each evaluation.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    models: _OneOrMore[_Name]
    presets: _OneOrMore[_Name] = ["best"]
    algos: _OneOrMore[Algorithm] = ["ppo"]
    seeds: _OneOrMore[_Seed] = [0]
    set: dict[str, _OneOrMore[_Setting]] = {}
    pairs: Annotated[int, Field(ge=1, strict=True)] = 500


@dataclass(frozen=True, slots=True)
class Event:
    """What happened to a job.

    Attributes:
        job: Which.
        kind: ``skipped`` (done before), ``started``, ``lost`` (its worker died; it starts again), ``done``
            or ``failed``.
        text: Why it was lost or failed.
        pid: Process of a job that started on this machine.
    """

    job: PooledJob
    kind: Literal["skipped", "started", "lost", "done", "failed"]
    text: str = ""
    pid: int | None = None


Events = Generator[Event, None, None]
Runner = Callable[[Sequence[Job], Path], Events]
"""Runs jobs into folders and tells what happens; each job ends in one ``done`` or ``failed``."""


def spec_hash(spec: dict[str, Any]) -> str:
    """Return 16 hex digits that depend on what a spec says, not on the order in which it says it."""
    text = json.dumps(spec, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def read_sweep(path: Path) -> Sweep:
    """Read a sweep from a JSON or TOML file.

    Raises:
        ConfigError: If it is missing or unreadable, or a field is wrong; the message names every fault.
    """
    try:
        text = path.read_text()
        content = tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"sweep {path}: cannot be read ({error})") from None
    except ValueError as error:
        raise ConfigError(f"sweep {path}: is neither JSON nor named .toml and TOML ({error})") from None
    return parse_sweep(content, str(path))


def parse_sweep(content: object, origin: str = "sweep") -> Sweep:
    """Check a sweep that was read.

    Raises:
        ConfigError: If a field is wrong; the message names every fault.
    """
    try:
        return Sweep.model_validate(content)
    except ValidationError as error:
        faults = "; ".join(_fault(item) for item in error.errors(include_url=False))
        raise ConfigError(f"sweep {origin}: {faults}") from None


def expand(sweep: Sweep) -> list[Job]:
    """Return the product of a sweep's lists, each job once, seeds outermost so that settings fill evenly.

    Raises:
        ConfigError: If a vessel model does not exist.
    """
    models = [_found(model) for model in sweep.models]
    grid = [
        tuple(sorted(zip(sweep.set, values, strict=True)))
        for values in itertools.product(*sweep.set.values())
    ]
    jobs = {
        job.name: job
        for seed, (model, digest), preset, algo, settings in itertools.product(
            sweep.seeds, models, sweep.presets, sweep.algos, grid
        )
        for job in [Job(model, digest, preset, algo, seed, settings, sweep.pairs)]
    }
    return list(jobs.values())


def check(jobs: Sequence[Job]) -> None:
    """Refuse a sweep of which a job cannot start, before any does.

    Raises:
        ConfigError: If there is no such preset, algorithm or hyper-parameter.
    """
    from mrnav_server.training.presets import adjust, find_preset

    for job in jobs:
        adjust(find_preset(job.preset), job.algo, assignments(dict(job.settings)))


def run_sweep(jobs: Sequence[Job], out: Path, runner: Runner) -> Events:
    """Run the jobs that are not done yet.

    Args:
        jobs: Each job once.
        out: Gets one folder per job; one sweep at a time may use it.
        runner: Where they run.
    """
    left = []
    for job in jobs:
        if read_result(out / job.name) is not None:
            yield Event(job, "skipped")
        else:
            clear(out / job.name)
            left.append(job)
    yield from runner(left, out)


def settled(job: PooledJob, out: Path) -> Event | None:
    """Return what became of a job by what it left on disk; None if it left nothing, so its worker died."""
    if read_result(out / job.name) is not None:
        return Event(job, "done")
    error = read_error(out / job.name)
    return None if error is None else Event(job, "failed", error)


def dead(job: PooledJob, times: int, how: str) -> Event:
    """Return what follows when a job's worker died: ``lost``, so it starts again, or ``failed`` at last.

    Args:
        job: Which.
        times: How many of its workers died so far.
        how: What is known about this death.
    """
    if times <= MAX_RETRIES:
        return Event(job, "lost", how)
    return Event(job, "failed", f"{times} workers died of it; the last one: {how}")


def _fault(item: "ErrorDetails") -> str:
    where = ".".join(str(part) for part in item["loc"])
    if item["type"] == "extra_forbidden":
        return f"{where}: there is no such field (there are {', '.join(Sweep.model_fields)})"
    return f"{where or 'the whole'}: {item['msg'].removeprefix('Value error, ').removeprefix('Input ')}"


def _found(model: str) -> tuple[str, str]:
    """Return a model's name, or its absolute path if it is not a shipped one, and the hash of its mask."""
    folder = find_model(model).resolve()
    name = folder.name if folder.parent == models_root().resolve() else str(folder)
    return name, read_model_json(folder)["mask_sha256"]
