"""Questionnaires on disk: ``tlx.json`` beside a trial's log, written once (docs/tlx.md)."""

import csv
import io
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import orjson

from mrnav_server.core.errors import ConfigError, RefusedError
from mrnav_server.core.tlx import KEYS, Choice, Workload, tally, workload
from mrnav_server.loops.trial_log import TrialInfo, list_trials, read_trial, trial_folder

TLX_NAME = "tlx.json"
SCHEMA_VERSION = 1


@dataclass(frozen=True, slots=True)
class TlxAnswers:
    """What a participant answered after a trial.

    Attributes:
        ratings: A mark per scale.
        choices: The fifteen judgements, in the order in which they were asked.
    """

    ratings: Mapping[str, int]
    choices: tuple[Choice, ...]

    def workload(self) -> Workload:
        """Return the scores.

        Raises:
            RefusedError: If an answer is missing or impossible, with the remedy.
        """
        return workload(self.ratings, tally(self.choices))


@dataclass(frozen=True, slots=True)
class TlxRecord:
    """A trial's questionnaire.

    Attributes:
        trial: The trial's id.
        answered_wall: Unix time at which it was handed in; a label.
        answers: The ones that count.
        replaced: Earlier answers that these corrected, oldest first.
    """

    trial: str
    answered_wall: float
    answers: TlxAnswers
    replaced: tuple[TlxAnswers, ...] = field(default=())

    def fields(self) -> dict[str, Any]:
        """Return the record with its scores, ready for JSON."""
        return {"schema": SCHEMA_VERSION, **asdict(self), **asdict(self.answers.workload())}


def keep_tlx(
    root: Path, trial_id: str, answers: TlxAnswers, answered_wall: float, *, replace: bool = False
) -> TlxRecord:
    """Store a trial's questionnaire and return the record.

    The same answers again change nothing. Other answers are refused, unless they are to replace the ones that
    are there, which the record then keeps as replaced.

    Raises:
        RefusedError: ``no_such_trial``, ``simulated_operator``, ``trial_running``, ``tlx_exists``, or what is
            wrong with the answers.
        ConfigError: If the trial's log or an earlier questionnaire is not readable.
    """
    answers.workload()
    info = read_trial(root, trial_id)
    if info.header.operator_kind == "simulated":
        raise RefusedError(
            "simulated_operator", f"trial {trial_id} had a simulated operator: only people feel workload"
        )
    if info.status == "running":
        raise RefusedError("trial_running", f"trial {trial_id} still runs: end it first")
    folder = trial_folder(root, trial_id)
    earlier = read_tlx(folder)
    if earlier is not None and earlier.answers == answers:
        return earlier
    if earlier is not None and not replace:
        raise RefusedError(
            "tlx_exists",
            f"trial {trial_id} has other answers already: send replace to correct them; they are kept beside",
        )
    before = (*earlier.replaced, earlier.answers) if earlier else ()
    record = TlxRecord(trial_id, answered_wall, answers, before)
    _write(folder / TLX_NAME, orjson.dumps(record.fields(), option=orjson.OPT_INDENT_2) + b"\n")
    return record


def read_tlx(folder: Path) -> TlxRecord | None:
    """Return a trial's questionnaire; None if it was not filled in.

    Raises:
        ConfigError: If the file is damaged.
    """
    file = folder / TLX_NAME
    try:
        fields: dict[str, Any] = orjson.loads(file.read_bytes())
        record = TlxRecord(
            fields["trial"],
            fields["answered_wall"],
            _answers(fields["answers"]),
            tuple(_answers(each) for each in fields["replaced"]),
        )
        record.answers.workload()
    except FileNotFoundError:
        return None
    except (orjson.JSONDecodeError, KeyError, TypeError, RefusedError) as error:
        raise ConfigError(f"{file}: not a questionnaire ({error})") from None
    return record


def tlx_csv(root: Path) -> str:
    """Return every questionnaire under ``root`` as CSV: a row a trial, ratings, weights, scores, choices."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        [
            *("trial", "participant", "condition", "vessel", "simulated_rig", "answered_wall"),
            *(f"rating_{key}" for key in KEYS),
            *(f"weight_{key}" for key in KEYS),
            *("weighted", "raw", "choices", "times_replaced"),
        ]
    )
    for info in list_trials(root):
        record = read_tlx(trial_folder(root, info.id))
        if record is not None:
            writer.writerow(_row(info, record))
    return text.getvalue()


def _row(info: TrialInfo, record: TlxRecord) -> list[object]:
    head, answers, scores = info.header, record.answers, record.answers.workload()
    return [
        *(info.id, head.participant, head.condition, head.vessel),
        *(str(head.simulated_rig).lower(), f"{record.answered_wall:.3f}"),
        *(answers.ratings[key] for key in KEYS),
        *(scores.weights[key] for key in KEYS),
        *(f"{scores.weighted:.4f}", f"{scores.raw:.4f}"),
        " ".join(f"{choice.left}|{choice.right}={choice.chosen}" for choice in answers.choices),
        len(record.replaced),
    ]


def _answers(fields: Mapping[str, Any]) -> TlxAnswers:
    return TlxAnswers(dict(fields["ratings"]), tuple(Choice(**each) for each in fields["choices"]))


def _write(file: Path, content: bytes) -> None:
    """Write a file whole or not at all, and safely."""
    part = file.with_suffix(".part")
    with part.open("wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())
    part.replace(file)
