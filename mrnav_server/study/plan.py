"""A study's plan: who does what in which order, counter-balanced. Pure: the same numbers give the same plan.

Every participant does both conditions, each as a block: a training period, trials, a questionnaire. Half of
them begin with each condition; the vessel models follow one another by a balanced Latin square.
"""

import dataclasses
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from mrnav_server.core.errors import ConfigError
from mrnav_server.loops.trial_log import Condition, OperatorKind

SCHEMA_VERSION = 1
CONDITIONS: tuple[Condition, Condition] = ("with_autonomy", "without_autonomy")
MAX_PARTICIPANTS = 999
MAX_REPETITIONS = 99

StepKind = Literal["training", "trial", "questionnaire"]


@dataclass(frozen=True, slots=True)
class Step:
    """One thing to do.

    Attributes:
        id: The code and a number that counts the code's steps, for example ``P01-03``.
        code: Who does it: a pseudonym, never a name.
        kind: A training period, a trial, or the questionnaire about the block's trials.
        block: 1 or 2: the first or the second condition of this code.
        condition: The block's.
        model: Vessel model.
        repetition: From 1, for a trial; None otherwise.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    id: str
    code: str
    kind: StepKind
    block: int
    condition: Condition
    model: str
    repetition: int | None


@dataclass(frozen=True, slots=True)
class StudyPlan:
    """A study as it was planned.

    Attributes:
        operator_kind: People, or simulated operators, which are never participants.
        seed: Of the order.
        codes: Everybody, in the order of coming.
        models: Vessel models.
        repetitions: Trials of each model in each condition.
        training_s: Length of a training period in s.
        steps: What is to be done, in order.
        conditions: Both.
        schema: Version of this record.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    operator_kind: OperatorKind
    seed: int
    codes: tuple[str, ...]
    models: tuple[str, ...]
    repetitions: int
    training_s: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
    steps: tuple[Step, ...]
    conditions: tuple[Condition, ...] = CONDITIONS
    schema: Literal[1] = 1

    def fields(self) -> dict[str, Any]:
        """Return the plan, ready for JSON."""
        return dataclasses.asdict(self)

    def step(self, step_id: str) -> Step:
        """Return one step.

        Raises:
            ConfigError: If there is none of that id.
        """
        for step in self.steps:
            if step.id == step_id:
                return step
        raise ConfigError(f"the plan has no step {step_id!r}")

    def trials_before(self, step: Step) -> int:
        """Return how many trials the plan has for this step's code before it."""
        own = [each for each in self.steps if each.code == step.code and each.kind == "trial"]
        return sum(each.id < step.id for each in own)


def new_plan(
    participants: int,
    models: Sequence[str],
    repetitions: int,
    seed: int,
    operator_kind: OperatorKind = "human",
    training_s: float = 300.0,
) -> StudyPlan:
    """Plan a study.

    Among every two who come one after the other, one begins with each condition. After as many as twice the
    rows of the Latin square, every model has stood at every place, and followed every other, equally often.

    Args:
        participants: How many, 1 to 999.
        models: Vessel models, each once.
        repetitions: Trials of each model in each condition, 1 to 99.
        seed: Of the order, at least 0.
        operator_kind: Simulated operators neither train nor answer.
        training_s: Length of a training period in s.

    Raises:
        ConfigError: If a number is out of range, or a model is named twice.
    """
    for name, value, low, high in (
        ("participants", participants, 1, MAX_PARTICIPANTS),
        ("repetitions", repetitions, 1, MAX_REPETITIONS),
        ("seed", seed, 0, 2**32 - 1),
        ("models", len(models), 1, 99),
    ):
        if not low <= value <= high:
            raise ConfigError(f"{name} is {value}: should lie between {low} and {high}")
    if len(set(models)) != len(models):
        raise ConfigError(f"models {', '.join(models)}: each can be named once")
    chance = np.random.default_rng([seed, 8])
    named = [models[i] for i in chance.permutation(len(models))]
    rows = _shuffled_rows(len(models), chance)
    prefix = "P" if operator_kind == "human" else "SIM"
    codes = tuple(f"{prefix}{number:02d}" for number in range(1, participants + 1))
    steps: list[Step] = []
    for pair in range(0, participants, 2):
        first = int(chance.integers(2))
        for offset, code in enumerate(codes[pair : pair + 2]):
            conditions = (CONDITIONS[(first + offset) % 2], CONDITIONS[(first + offset + 1) % 2])
            orders = [[named[i] for i in rows[(pair // 2 + block) % len(rows)]] for block in range(2)]
            steps += _steps(code, conditions, orders, repetitions, training=operator_kind == "human")
    return StudyPlan(operator_kind, seed, codes, tuple(models), repetitions, training_s, tuple(steps))


def parse_plan(content: object, origin: str) -> StudyPlan:
    """Check a plan that was read.

    Args:
        content: Parsed JSON.
        origin: Where it comes from, for messages.

    Raises:
        ConfigError: If a field is wrong, naming it.
    """
    try:
        plan = TypeAdapter(StudyPlan).validate_python(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "the whole"
        raise ConfigError(f"{origin}: {where}: {first['msg']}") from None
    ids = [step.id for step in plan.steps]
    strange = {step.code for step in plan.steps} - set(plan.codes)
    if (
        len(set(ids)) != len(ids)
        or strange
        or not all(re.fullmatch(r"[A-Za-z0-9_]{1,32}", c) for c in plan.codes)
    ):
        raise ConfigError(f"{origin}: steps: each needs an id of its own and one of the codes")
    return plan


def latin_rows(count: int) -> list[list[list[int]]]:
    """Return balanced Latin squares (Williams 1949): one for an even count, two for an odd one.

    Each item stands once at each place of a square; over all squares, each follows each other item equally
    often.
    """
    base = [0]
    for i in range(1, count):
        base.append((i + 1) // 2 if i % 2 else count - i // 2)
    square = [[(item + shift) % count for item in base] for shift in range(count)]
    return [square] if count % 2 == 0 or count == 1 else [square, [row[::-1] for row in square]]


def _shuffled_rows(count: int, chance: np.random.Generator) -> list[list[int]]:
    """Return the rows of the squares in a random order, square by square."""
    return [square[i] for square in latin_rows(count) for i in chance.permutation(len(square))]


def _steps(
    code: str,
    conditions: Sequence[Condition],
    orders: Sequence[Sequence[str]],
    repetitions: int,
    *,
    training: bool,
) -> list[Step]:
    parts: list[tuple[StepKind, int, str, int | None]] = []
    for block, order in enumerate(orders, start=1):
        if training:
            parts.append(("training", block, order[0], None))
        parts += [("trial", block, model, r) for model in order for r in range(1, repetitions + 1)]
        if training:
            parts.append(("questionnaire", block, order[-1], None))
    width = max(2, len(str(len(parts))))
    return [
        Step(f"{code}-{number:0{width}d}", code, kind, block, conditions[block - 1], model, repetition)
        for number, (kind, block, model, repetition) in enumerate(parts, start=1)
    ]
