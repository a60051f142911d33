import pytest
from scipy import stats

from mrnav_server.core.errors import ConfigError
from mrnav_server.study.statistics_noncentral import noncentral_t_cdf
from mrnav_server.study.statistics_power import paired_power, planned


@pytest.mark.parametrize(
    ("effect", "power", "participants", "reached"),
    # G*Power 3.1, t-tests, difference between two dependent means, two-sided, 0.05.
    [(0.5, 0.8, 34, 0.8077775), (0.8, 0.8, 15, 0.8213105), (0.2, 0.8, 199, 0.8016903)],
)
def test_sample_sizes_of_gpower(effect: float, power: float, participants: int, reached: float) -> None:
    plan = planned(effect=effect, power=power)
    assert plan.participants == participants
    assert plan.power == pytest.approx(reached, abs=1e-6)
    assert paired_power(effect, participants - 1, 0.05) < power


@pytest.mark.parametrize("effect", [0.25, 0.41, 0.55, 0.7, 0.95, 1.3, 2.5])
def test_no_fewer_participants_would_do(effect: float) -> None:
    found = planned(effect=effect, power=0.9).participants
    assert paired_power(effect, found, 0.05) >= 0.9 > paired_power(effect, found - 1, 0.05)


def test_any_two_give_the_third() -> None:
    plan = planned(effect=0.8, participants=12)
    again = planned(participants=12, power=plan.power)
    assert again.effect == pytest.approx(0.8, abs=1e-4)
    assert planned(effect=0.8, power=plan.power - 1e-9).participants == 12


def test_ranks_need_more_and_never_fewer_than_can_reach_alpha() -> None:
    assert planned(effect=0.5, power=0.8).participants_by_rank == 36
    large = planned(effect=4.0, power=0.8)
    assert large.participants < large.participants_by_rank == large.least_by_rank == 6
    assert planned(effect=4.0, power=0.8, tests=5).least_by_rank == 8


def test_five_measures_cost_participants() -> None:
    assert planned(effect=0.8, power=0.8, tests=5).alpha == pytest.approx(0.01)
    assert planned(effect=0.8, power=0.8, tests=5).participants > planned(effect=0.8, power=0.8).participants


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"effect": 0.8}, "give two"),
        ({"effect": 0.8, "participants": 5, "power": 0.8}, "give two"),
        ({"effect": -1.0, "power": 0.8}, "effect must be"),
        ({"effect": 0.8, "power": 1.0}, "power must lie"),
        ({"effect": 0.8, "participants": 1}, "participants must be"),
        ({"effect": 0.8, "power": 0.8, "alpha": 0.0}, "alpha must lie"),
        ({"effect": 1e-4, "power": 0.9}, "more than"),
    ],
)
def test_a_plan_that_cannot_be_is_refused(given: dict[str, float], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        planned(**given)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("t", "df", "delta"), [(2.2, 9, 1.5), (-1.0, 4, 0.3), (2.0, 30, -1.0), (1.9, 500, 1.5)]
)
def test_the_noncentral_t(t: float, df: int, delta: float) -> None:
    assert noncentral_t_cdf(t, df, delta) == pytest.approx(stats.nct.cdf(t, df, delta), abs=1e-9)
    assert noncentral_t_cdf(t, df, 0.0) == pytest.approx(stats.t.cdf(t, df), abs=1e-9)
