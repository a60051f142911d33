from collections.abc import Sequence
from itertools import combinations, product

import pytest

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.tlx import KEYS, SCALES, Choice, are_possible, shown_pairs, tally, workload

RATINGS = dict(zip(KEYS, (60, 20, 45, 30, 70, 35), strict=True))
WEIGHTS = dict(zip(KEYS, (5, 4, 3, 2, 1, 0), strict=True))


def by_rank(order: Sequence[str] = KEYS) -> list[Choice]:
    """Judge every pair for the one that comes first in an order."""
    return [Choice(left, right, min(left, right, key=order.index)) for left, right in shown_pairs("trial")]


def test_the_published_example() -> None:
    found = workload(RATINGS, WEIGHTS)
    assert found.raw == pytest.approx(43.333, abs=5e-4)
    assert found.weighted == pytest.approx(43.0)
    assert tally(by_rank()) == WEIGHTS


def test_performance_runs_from_good_to_poor_and_is_never_turned_round() -> None:
    scale = next(scale for scale in SCALES if scale.key == "performance")
    assert (scale.low, scale.high) == ("Good", "Poor")
    poor, good = ({**RATINGS, "performance": mark} for mark in (100, 0))
    heavy = {**dict.fromkeys(KEYS, 2), "performance": 5}
    assert workload(poor, heavy).weighted - workload(good, heavy).weighted == pytest.approx(100 * 5 / 15)
    assert workload(poor, heavy).raw > workload(good, heavy).raw


def test_every_pair_is_shown_once_in_an_order_of_the_seed() -> None:
    pairs = shown_pairs("one")
    assert {frozenset(pair) for pair in pairs} == {frozenset(pair) for pair in combinations(KEYS, 2)}
    assert len(pairs) == 15
    assert pairs == shown_pairs("one")
    many = [shown_pairs(f"seed {i}") for i in range(400)]
    assert len({tuple(each) for each in many}) == 400
    # Each side and each place is taken by chance: 200 ± 10 and 400/15 ± 5 at one standard deviation.
    left = sum(("mental", "effort") in each for each in many)
    first = sum(set(each[0]) == {"mental", "effort"} for each in many)
    assert 150 < left < 250
    assert 5 < first < 55


def test_of_the_vectors_that_sum_to_fifteen_those_of_real_pairs_are_possible() -> None:
    vectors = [v for v in product(range(6), repeat=6) if sum(v) == 15]
    assert len(vectors) == 4332
    real = {
        tuple(sum(chosen == k for chosen in choices) for k in range(6))
        for choices in product(*combinations(range(6), 2))
    }
    assert len(real) == 2932
    assert {v for v in vectors if are_possible(v)} == real


def test_answers_that_cannot_be_are_refused_with_their_place() -> None:
    choices = by_rank()
    with pytest.raises(RefusedError, match=r"judge each pair exactly once, also .*mental and physical"):
        tally([each for each in choices if {each.left, each.right} != {"mental", "physical"}])
    with pytest.raises(RefusedError, match="judge each pair exactly once"):
        tally([*choices, choices[0]])
    with pytest.raises(RefusedError, match="pair 1 must be of two of"):
        tally([Choice("mental", "mental", "mental"), *choices[1:]])
    with pytest.raises(RefusedError, match=r"pair 2 is .*cannot be chosen"):
        tally([choices[0], Choice(choices[1].left, choices[1].right, "other"), *choices[2:]])


@pytest.mark.parametrize(
    ("ratings", "weights", "told"),
    [
        ({**RATINGS, "effort": 42}, WEIGHTS, "effort must be a mark from 0 to 100 in steps of 5, not 42"),
        ({**RATINGS, "effort": 105}, WEIGHTS, "effort must be a mark"),
        ({**RATINGS, "effort": -5}, WEIGHTS, "effort must be a mark"),
        ({"mental": 50}, WEIGHTS, "ratings: give one each"),
        (RATINGS, {**WEIGHTS, "luck": 0}, "weights: give one each"),
        (RATINGS, dict(zip(KEYS, (5, 5, 5, 0, 0, 0), strict=True)), "cannot come from fifteen pairs"),
        (RATINGS, dict(zip(KEYS, (5, 4, 3, 2, 1, 1), strict=True)), "cannot come from fifteen pairs"),
    ],
)
def test_ratings_and_weights_are_checked(ratings: dict[str, int], weights: dict[str, int], told: str) -> None:
    with pytest.raises(RefusedError, match=told):
        workload(ratings, weights)
