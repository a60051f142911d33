"""The tables at a report's end: every trial with its flags, what was left out, environment and hashes."""

import platform
from collections import Counter
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version

from mrnav_server.core.metric_flags import FLAGS
from mrnav_server.study.measures import FIVE, FURTHER, HANDOVER
from mrnav_server.study.report_table import Cell, Table, number, text
from mrnav_server.study.study_data import Study, StudyTrial

_PACKAGES = ("mrnav-server", "numpy", "scipy", "matplotlib")
_MOST_SHOWN = 6
_FILE_ONLY = ("operators", "log sha256", "configuration sha256")
NO_HANDOVER = "no_handover"


def trial_flags(trial: StudyTrial) -> tuple[str, ...]:
    """Return why a trial is to be read with care."""
    missing = trial.handover is None and trial.header.condition == "with_autonomy"
    return (*trial.metrics.flags, *((NO_HANDOVER,) if missing else ()))


def trials_table(study: Study) -> Table:
    """Return every trial with its metrics and flags."""
    rows = []
    raised: set[str] = set()
    for trial in study.trials:
        flags = trial_flags(trial)
        raised.update(flags)
        rows.append(
            (
                text(trial.id),
                text(trial.header.participant),
                text(trial.task),
                text(trial.header.condition.removesuffix("_autonomy")),
                *(number(each.of(trial), 0 if each.symbol == "C" else each.decimals) for each in FIVE),
                number(100.0 * trial.metrics.seen_share, 0),
                Cell(", ".join(flags) or "–", ", ".join(flags)),
                text(trial.header.operator_kind),
                text(trial.log_sha256),
                text(trial.header.configuration_sha256),
            )
        )
    words = {**FLAGS, NO_HANDOVER: "autonomy did not hand over"}
    return Table(
        "trials",
        "Every trial and its flags",
        (
            "trial",
            "operator",
            "task",
            "autonomy",
            *(each.label for each in FIVE),
            "seen (%)",
            "flags",
            *_FILE_ONLY,
        ),
        tuple(rows),
        tuple(f"{flag}: {words[flag]}." for flag in words if flag in raised) or ("No trial raised a flag.",),
        _FILE_ONLY,
    )


def left_out_table(study: Study) -> Table:
    """Return the trials that are no results."""
    rows = tuple((text(trial), text(why)) for trial, why in study.left_out)
    return Table("left-out", "Trials that are no results", ("trial", "why"), rows)


def values_table(study: Study) -> Table:
    """Return every value of every measure, in the columns that ``mrnav stats`` reads."""
    rows = tuple(
        (
            text(trial.header.participant),
            text(trial.header.condition),
            text(each.symbol),
            number(each.of(trial), each.decimals),
            text(trial.task),
            text(trial.id),
            text(study.operator_kind),
        )
        for each in (*FIVE, *FURTHER, *HANDOVER)
        for trial in study.trials
    )
    header = ("participant", "condition", "metric", "value", "task", "trial", "operators")
    return Table("values", "Every value", header, rows)


def environment_table(study: Study) -> Table:
    """Return what the trials were made with, and what analysed them."""
    headers = [trial.header for trial in study.trials]
    rows = [
        ("operators", study.origin),
        ("trials", f"{len(study.trials)}, of {len(study.operators)} {study.people}"),
        ("recorded", _dates(study)),
        *_each("recorded by version", (header.software_version for header in headers)),
        *_each("configuration sha256", (header.configuration_sha256 for header in headers)),
        *_each("policy sha256", (header.policy_sha256 or "none" for header in headers)),
        *(
            (f"vessel {vessel.name}, mask sha256", f"{vessel.digest}, {vessel.um_per_px:g} µm/px")
            for vessel in study.vessels.values()
        ),
        ("analysed with", ", ".join(f"{name} {_version(name)}" for name in _PACKAGES)),
        ("on", f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"),
    ]
    return Table(
        "environment",
        "Environment, versions and hashes",
        ("what", "value"),
        tuple((text(what), text(value)) for what, value in rows),
        ("Each trial's own log and configuration hashes are in trials.csv.",),
    )


def _dates(study: Study) -> str:
    """Return the days of the first and of the last trial, which their ids begin with."""
    days = sorted({f"{trial.id[:4]}-{trial.id[4:6]}-{trial.id[6:8]}" for trial in study.trials})
    return days[0] if len(days) == 1 else f"{days[0]} to {days[-1]}"


def _each(what: str, values: Iterable[str]) -> list[tuple[str, str]]:
    """Return a row for each different value, with its number of trials; one row for many values."""
    counted = Counter(values)
    if len(counted) == 1:
        return [(what, next(iter(counted)))]
    if len(counted) > _MOST_SHOWN:
        return [(what, f"{len(counted)} different, see trials.csv")]
    return [(what, f"{value} ({count} trials)") for value, count in counted.most_common()]


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "?"
