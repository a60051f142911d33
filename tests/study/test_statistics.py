import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from mrnav_server.study.statistics import analyse, holm
from mrnav_server.study.statistics_normality import shapiro
from mrnav_server.study.statistics_paired import (
    d_z_interval,
    least_participants,
    paired_analysis,
    rank_biserial,
    sign_flip_p,
)
from mrnav_server.study.statistics_pooled import pooled_analysis
from mrnav_server.study.statistics_samples import Sample, Samples, samples

A = [11.1, 12.4, 10.2, 11.8, 12.9, 10.6]
B = [16.8, 18.1, 15.0, 17.7, 19.5, 15.9]


def paired_samples(first: list[float], second: list[float]) -> Samples:
    rows = [Sample(f"P{who:02d}", "A", value) for who, value in enumerate(first)]
    return samples(rows + [Sample(f"P{who:02d}", "B", value) for who, value in enumerate(second)])


FIXED = paired_samples(A, B)


def test_the_fixed_set_paired() -> None:
    found = paired_analysis(FIXED)
    assert found.t == pytest.approx(-23.04886, abs=1e-5)
    assert found.df == 5
    assert found.t_p == pytest.approx(2.85981e-6, rel=1e-5)
    assert found.wilcoxon_p == 0.03125
    assert found.sign_flip_p == 0.03125
    assert found.d_z == pytest.approx(-9.40966, abs=1e-5)
    assert found.mean_ci == pytest.approx((-6.29866, -5.03447), abs=1e-3)
    assert found.mean_ci == pytest.approx(tuple(stats.ttest_rel(A, B).confidence_interval()), rel=1e-12)
    assert found.rank_biserial == -1.0
    assert (found.test, found.p) == ("paired t", found.t_p)
    assert found.warnings == ()


def test_the_fixed_set_pooled() -> None:
    found = pooled_analysis(FIXED)
    assert found.u_p == pytest.approx(0.00216450, abs=1e-8)
    assert (found.t, found.t_p) == pytest.approx(tuple(stats.ttest_ind(A, B)), rel=1e-12)
    assert (found.test, found.p) == ("t-test", found.t_p)
    assert found.first_normality.p == pytest.approx(stats.shapiro(A).pvalue)


def test_holm_of_the_published_p() -> None:
    published = {"Va": 3e-10, "TOC": 1e-10, "G": 6e-9, "S": 1e-10, "C": 7e-3}
    expected = {"Va": 9e-10, "TOC": 5e-10, "G": 1.2e-8, "S": 5e-10, "C": 0.007}
    assert holm(published) == pytest.approx(expected, rel=1e-12)


def test_holm_leaves_out_what_was_not_tested() -> None:
    found = holm({"a": 0.01, "b": math.nan, "c": 0.8})
    assert (found["a"], found["c"]) == (0.02, 0.8)
    assert math.isnan(found["b"])


@settings(deadline=None)
@given(st.dictionaries(st.text(max_size=3), st.floats(0.0, 1.0), max_size=8))
def test_holm_keeps_the_order_and_lowers_nothing(p: dict[str, float]) -> None:
    adjusted = holm(p)
    assert all(p[name] <= adjusted[name] <= 1.0 for name in p)
    by_p = sorted(p, key=lambda name: p[name])
    assert [adjusted[name] for name in by_p] == sorted(adjusted.values())


def test_five_participants_are_told_that_ranks_cannot_reach_alpha() -> None:
    found = paired_analysis(paired_samples(A[:5], B[:5]))
    assert (found.wilcoxon_p, found.smallest_p) == (0.0625, 0.0625)
    assert any("0.0625" in warning and "6 are needed" in warning for warning in found.warnings)
    assert not paired_analysis(FIXED).warnings


def test_holm_asks_for_more_participants() -> None:
    assert [least_participants(alpha) for alpha in (0.05, 0.01)] == [6, 8]
    found = paired_analysis(FIXED, tests=5)
    assert any("0.05/5" in warning and "8 are needed" in warning for warning in found.warnings)


def test_the_least_participants_reach_alpha_and_one_fewer_does_not() -> None:
    for alpha in (0.1, 0.05, 0.0625, 0.01, 0.001):
        least = least_participants(alpha)
        assert 2.0 ** (1 - least) <= alpha < 2.0 ** (2 - least)


def test_participants_are_averaged_before_they_are_compared() -> None:
    rows = [Sample("P1", "A", value) for value in (1.0, 3.0)] + [Sample("P1", "B", 5.0)]
    rows += [Sample("P2", "A", 1.0), Sample("P2", "B", 2.0), Sample("P2", "B", 8.0), Sample("P3", "A", 9.0)]
    rows += [Sample("P4", "A", math.nan), Sample("P4", "B", 1.0)]
    found = paired_analysis(samples(rows))
    assert (found.participants, found.left_out) == (2, ("P3", "P4"))
    assert found.mean_difference == pytest.approx(((2.0 - 5.0) + (1.0 - 5.0)) / 2)
    assert (found.first_mean, found.second_mean) == (1.5, 5.0)
    assert any("P3, P4" in warning for warning in found.warnings)
    # The pooled analysis counts every trial.
    pooled = pooled_analysis(samples(rows))
    assert (pooled.first_n, pooled.second_n) == (4, 4)


def test_constants_and_too_few_are_not_called_normal() -> None:
    assert math.isnan(shapiro(np.array([1.0, 2.0])).p)
    assert shapiro(np.array([1.0, 2.0])).note == "fewer than 3 values"
    assert math.isnan(shapiro(np.full(9, 0.1)).p)
    assert "same" in shapiro(np.full(9, 0.1)).note
    pooled = pooled_analysis(paired_samples([0.0] * 6, [0.0] * 6))
    assert (pooled.test, pooled.p) == ("Mann–Whitney U", 1.0)
    assert math.isnan(pooled.t)


def test_differences_that_are_all_the_same_leave_the_exact_tests() -> None:
    found = paired_analysis(paired_samples([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [2.1, 3.1, 4.1, 5.1, 6.1, 7.1]))
    assert math.isnan(found.t)
    assert math.isnan(found.d_z)
    assert (found.test, found.p) == ("Wilcoxon signed-rank", 0.03125)
    assert any("all differences are the same" in warning for warning in found.warnings)
    none = paired_analysis(paired_samples([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]))
    assert (none.p, none.sign_flip_p, none.mean_difference) == (1.0, 1.0, 0.0)


@pytest.mark.parametrize("count", [1, 2])
def test_hardly_any_participants(count: int) -> None:
    found = paired_analysis(paired_samples(A[:count], B[:count]))
    assert found.participants == count
    assert found.warnings
    assert math.isnan(found.shapiro_p)
    assert (found.test is None) is (count == 1)


def test_a_test_that_was_fixed_before_is_the_primary_one() -> None:
    found = paired_analysis(FIXED, test="exact sign-flip")
    assert (found.test, found.p) == ("exact sign-flip", 0.03125)


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.integers(-40, 40).map(lambda value: value / 8), min_size=2, max_size=8).filter(
        lambda values: len({abs(value) for value in values} - {0.0}) == len(values)
    )
)
def test_exact_tests_agree_with_scipy(differences: list[float]) -> None:
    d = np.array(differences)
    first = paired_analysis(paired_samples(d.tolist(), [0.0] * len(differences)))
    exact = stats.wilcoxon(d, method="exact")
    assert (first.wilcoxon_w, first.wilcoxon_p) == pytest.approx((exact.statistic, exact.pvalue), rel=1e-9)
    flips = stats.permutation_test((d,), np.mean, permutation_type="samples", n_resamples=10_000)
    assert sign_flip_p(d) == pytest.approx(flips.pvalue, rel=1e-9)


def test_many_differences_are_flipped_at_random() -> None:
    d = np.random.default_rng(3).normal(0.45, 1.0, 40)
    assert sign_flip_p(d) == pytest.approx(stats.ttest_1samp(d, 0.0).pvalue, abs=0.004)
    assert paired_analysis(paired_samples(d.tolist(), [0.0] * 40)).wilcoxon_p == stats.wilcoxon(d).pvalue


def test_the_rank_biserial_of_the_textbook() -> None:
    # W₊ = 27 and W₋ = 18 of 45 (Kerby 2014's form): 9/45.
    assert rank_biserial(np.array([1.0, 2.0, -3.0, 4.0, -5.0, 6.0, -10.0, 7.0, 8.0])) == pytest.approx(
        (1 + 2 + 4 + 6 + 7 + 8 - 3 - 5 - 9) / 45
    )
    assert rank_biserial(np.array([0.0, 1.0])) == 1.0


def test_the_interval_of_d_z_holds_the_noncentral_t_at_its_bounds() -> None:
    low, high = d_z_interval(0.5, 20, 0.05)
    t = 0.5 * math.sqrt(20)
    assert stats.nct.cdf(t, 19, low * math.sqrt(20)) == pytest.approx(0.975, abs=1e-6)
    assert stats.nct.cdf(t, 19, high * math.sqrt(20)) == pytest.approx(0.025, abs=1e-6)
    assert d_z_interval(-0.5, 20, 0.05) == pytest.approx((-high, -low), abs=1e-6)


def test_the_interval_of_the_median_is_that_of_the_signed_ranks() -> None:
    # n = 6 at 95 %: only the extreme of the 64 patterns is left out, so the range of the Walsh averages.
    found = paired_analysis(FIXED)
    assert found.median_ci == pytest.approx((-6.6, -4.8))
    assert all(map(math.isnan, paired_analysis(paired_samples(A[:5], B[:5])).median_ci))
    # n = 10: the 9th smallest and largest of 55 (Hollander and Wolfe's table).
    d = np.arange(1.0, 11.0) ** 2
    walsh = sorted((x + y) / 2 for i, x in enumerate(d) for y in d[i:])
    ten = paired_analysis(paired_samples(d.tolist(), [0.0] * 10))
    assert ten.median_ci == (walsh[8], walsh[-9])


def test_pooling_makes_p_too_small() -> None:
    random = np.random.default_rng(5)
    rows = []
    for who in range(6):
        gain = random.normal(0.6, 1.0)
        for condition, shift in (("with", gain), ("without", 0.0)):
            rows += [Sample(f"P{who}", condition, shift + random.normal(0.0, 0.2)) for _ in range(30)]
    found = analyse({"x": samples(rows)})["x"]
    assert found.pooled.p < 1e-6 < 0.05 < found.paired.p


def test_a_record_is_ready_for_json() -> None:
    record = analyse({"x": paired_samples([1.0], [2.0])})["x"].record()
    assert record["conditions"] == ["A", "B"]
    assert record["paired"]["t"] is None
    assert record["paired"]["mean_ci"] == [None, None]
    assert "pooled trials" in record["pooled"]["label"]
