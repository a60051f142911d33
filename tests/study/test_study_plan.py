"""The plan: everybody does everything, and the order is balanced."""

from collections import Counter
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrnav_server.core.errors import ConfigError
from mrnav_server.study.plan import CONDITIONS, StudyPlan, latin_rows, new_plan, parse_plan

MODELS = ("a", "b", "c", "d", "e")


def orders(plan: StudyPlan) -> dict[tuple[str, int], list[str]]:
    """Return the models of every block, in order."""
    found: dict[tuple[str, int], list[str]] = {}
    for step in plan.steps:
        if step.kind == "trial" and step.repetition == 1:
            found.setdefault((step.code, step.block), []).append(step.model)
    return found


@settings(deadline=None, max_examples=60)
@given(
    participants=st.integers(1, 25),
    count=st.integers(1, 5),
    repetitions=st.integers(1, 4),
    seed=st.integers(0, 2**32 - 1),
    kind=st.sampled_from(["human", "simulated"]),
)
def test_everybody_does_everything_once_in_two_blocks(
    participants: int, count: int, repetitions: int, seed: int, kind: str
) -> None:
    plan = new_plan(participants, MODELS[:count], repetitions, seed, kind)  # type: ignore[arg-type]
    assert len(plan.codes) == len(set(plan.codes)) == participants
    assert len({step.id for step in plan.steps}) == len(plan.steps)
    for code in plan.codes:
        own = [step for step in plan.steps if step.code == code]
        cells = [(s.condition, s.model, s.repetition) for s in own if s.kind == "trial"]
        wanted = {(c, m, r) for c in CONDITIONS for m in MODELS[:count] for r in range(1, repetitions + 1)}
        assert len(cells) == len(wanted)
        assert set(cells) == wanted
        assert [step.block for step in own] == sorted(step.block for step in own)
        for block in (1, 2):
            part = [step for step in own if step.block == block]
            assert len({step.condition for step in part}) == 1
            kinds = [step.kind for step in part]
            middle = ["trial"] * (count * repetitions)
            assert kinds == (["training", *middle, "questionnaire"] if kind == "human" else middle)
        assert own == sorted(own, key=lambda step: step.id)
    # Everybody one after the other.
    assert [code for code, _ in Counter(step.code for step in plan.steps).items()] == list(plan.codes)
    first = Counter(step.condition for step in plan.steps if step.id.endswith("-01"))
    assert abs(first["with_autonomy"] - first["without_autonomy"]) <= 1


@settings(deadline=None, max_examples=20)
@given(count=st.integers(2, 5), seed=st.integers(0, 1000))
def test_over_a_whole_round_every_model_stands_everywhere_equally_often(count: int, seed: int) -> None:
    rows = sum(len(square) for square in latin_rows(count))
    plan = new_plan(2 * rows, MODELS[:count], 1, seed)
    blocks = orders(plan)
    for block in (1, 2):
        places = Counter(
            (place, model)
            for (_, b), order in blocks.items()
            if b == block
            for place, model in enumerate(order)
        )
        assert len(places) == count**2
        assert len(set(places.values())) == 1
        followed = Counter(pair for (_, b), order in blocks.items() if b == block for pair in pairwise(order))
        assert len(followed) == count * (count - 1)
        assert len(set(followed.values())) == 1
        # Also among those who begin with the same condition.
        first = {step.code: step.condition for step in plan.steps if step.block == block}
        crossed = Counter((first[code], order[0]) for (code, b), order in blocks.items() if b == block)
        assert len(set(crossed.values())) == 1


def test_the_seed_is_the_order() -> None:
    assert new_plan(6, MODELS, 2, 4) == new_plan(6, MODELS, 2, 4)
    assert len({tuple(s.model for s in new_plan(6, MODELS, 1, seed).steps) for seed in range(10)}) > 5


def test_codes_say_who_is_simulated_and_an_operator_s_practice_is_counted() -> None:
    assert new_plan(2, MODELS, 1, 0).codes == ("P01", "P02")
    plan = new_plan(2, MODELS[:2], 2, 0, "simulated")
    assert plan.codes == ("SIM01", "SIM02")
    assert [plan.trials_before(step) for step in plan.steps] == [*range(8), *range(8)]


def test_a_plan_survives_json() -> None:
    import orjson

    plan = new_plan(3, MODELS[:3], 2, 9)
    assert parse_plan(orjson.loads(orjson.dumps(plan.fields())), "plan.json") == plan


@pytest.mark.parametrize(
    ("numbers", "named"),
    [
        ((0, MODELS, 1, 0), "participants"),
        ((1, (), 1, 0), "models"),
        ((1, MODELS, 0, 0), "repetitions"),
        ((1, MODELS, 1, -1), "seed"),
        ((1, ("a", "a"), 1, 0), "each can be named once"),
    ],
)
def test_wrong_numbers_are_named(numbers: tuple[int, tuple[str, ...], int, int], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        new_plan(*numbers)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"schema": 2}, "schema"),
        ({"names": ["Ada"]}, "names"),
        ({"operator_kind": "robot"}, "operator_kind"),
        ({"codes": ["P02"]}, "codes"),
        ({"training_s": float("nan")}, "training_s"),
    ],
)
def test_a_wrong_plan_names_the_field(change: dict[str, object], named: str) -> None:
    with pytest.raises(ConfigError, match=f"my file.*{named}"):
        parse_plan(new_plan(1, MODELS, 1, 0).fields() | change, "my file")
