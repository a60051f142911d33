"""NASA-TLX: six scales, fifteen pairs, weighted and raw workload (docs/tlx.md). No judgement is made up here.

Source: Hart, NASA Task Load Index (TLX) v. 1.0 manual, NTRS 20000021488.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, combinations
from math import comb
from random import Random

from mrnav_server.core.errors import RefusedError

MARK_STEP = 5
"""A scale has 21 marks, 0 to 100 in steps of 5."""


@dataclass(frozen=True, slots=True)
class Scale:
    """One of the six scales.

    Attributes:
        key: Its name in records.
        title: As people read it.
        question: What it asks.
        low, high: What its ends are called; the low end is 0, the high end 100, also for performance.
    """

    key: str
    title: str
    question: str
    low: str
    high: str


SCALES = (
    Scale(
        "mental", "Mental demand", "How much thinking, deciding and looking did the task ask?", "Low", "High"
    ),
    Scale("physical", "Physical demand", "How much physical activity did the task ask?", "Low", "High"),
    Scale("temporal", "Temporal demand", "How much time pressure did you feel?", "Low", "High"),
    Scale(
        "performance",
        "Performance",
        "How successful were you in doing what was asked of you?",
        "Good",
        "Poor",
    ),
    Scale("effort", "Effort", "How hard did you have to work to reach your performance?", "Low", "High"),
    Scale("frustration", "Frustration", "How irritated, stressed or discouraged were you?", "Low", "High"),
)
KEYS = tuple(scale.key for scale in SCALES)
PAIR_COUNT = comb(len(KEYS), 2)


@dataclass(frozen=True, slots=True)
class Choice:
    """Which of two scales contributed more to the workload.

    Attributes:
        left, right: The scales, as they were shown.
        chosen: One of the two.
    """

    left: str
    right: str
    chosen: str


@dataclass(frozen=True, slots=True)
class Workload:
    """A questionnaire's scores; higher is more workload.

    Attributes:
        weights: How often each scale was chosen, 0..5, together 15.
        weighted: Σ weight · rating / 15, 0..100.
        raw: Mean of the six ratings, 0..100.
    """

    weights: Mapping[str, int]
    weighted: float
    raw: float


def shown_pairs(seed: str) -> list[tuple[str, str]]:
    """Return the fifteen pairs (left, right), order and sides at random; the same for the same seed."""
    random = Random(seed)
    pairs = [pair if random.random() < 0.5 else pair[::-1] for pair in combinations(KEYS, 2)]
    random.shuffle(pairs)
    return pairs


def tally(choices: Sequence[Choice]) -> dict[str, int]:
    """Return how often each scale was chosen.

    Raises:
        RefusedError: ``bad_choices`` unless every pair was judged exactly once.
    """
    for number, choice in enumerate(choices, start=1):
        if choice.left not in KEYS or choice.right not in KEYS or choice.left == choice.right:
            raise RefusedError(
                "bad_choices",
                f"choices: pair {number} must be of two of {', '.join(KEYS)},"
                f" not {choice.left[:20]!r} and {choice.right[:20]!r}",
            )
        if choice.chosen not in (choice.left, choice.right):
            raise RefusedError(
                "bad_choices",
                f"choices: pair {number} is {choice.left} or {choice.right}, so {choice.chosen[:20]!r}"
                " cannot be chosen",
            )
    judged = [frozenset((choice.left, choice.right)) for choice in choices]
    missing = [" and ".join(pair) for pair in combinations(KEYS, 2) if judged.count(frozenset(pair)) != 1]
    if missing:
        raise RefusedError("bad_choices", f"choices: judge each pair exactly once, also {'; '.join(missing)}")
    return {key: sum(choice.chosen == key for choice in choices) for key in KEYS}


def workload(ratings: Mapping[str, int], weights: Mapping[str, int]) -> Workload:
    """Return weighted and raw workload.

    Args:
        ratings: A mark per scale, 0 to 100 in steps of 5. Performance runs from 0, good, to 100, poor, and is
            taken as it is.
        weights: How often each scale was chosen, 0..5; of the numbers that sum to 15 only those count that
            fifteen judgements can give.

    Raises:
        RefusedError: ``bad_ratings`` or ``bad_weights``, naming the scale.
    """
    for given, what in ((ratings, "ratings"), (weights, "weights")):
        if set(given) != set(KEYS):
            raise RefusedError(f"bad_{what}", f"{what}: give one each for {', '.join(KEYS)}, and no other")
    for key, mark in ratings.items():
        if not 0 <= mark <= 100 or mark % MARK_STEP:
            raise RefusedError(
                "bad_ratings", f"ratings: {key} must be a mark from 0 to 100 in steps of 5, not {mark}"
            )
    if not are_possible(list(weights.values())):
        raise RefusedError(
            "bad_weights",
            f"weights: {', '.join(f'{key} {weights[key]}' for key in KEYS)} cannot come from fifteen pairs:"
            " tally the choices again",
        )
    weighted = sum(weights[key] * ratings[key] for key in KEYS) / PAIR_COUNT
    return Workload(dict(weights), weighted, sum(ratings.values()) / len(KEYS))


def are_possible(weights: Sequence[int]) -> bool:
    """Tell whether judging every pair once can give these numbers.

    Source: Landau, On dominance relations and the structure of animal societies III, 1953: any k of them
    share at least the k·(k − 1)/2 pairs among themselves.
    """
    sums = list(accumulate(sorted(weights)))
    return sums[-1] == PAIR_COUNT and all(total >= comb(k, 2) for k, total in enumerate(sums, start=1))
