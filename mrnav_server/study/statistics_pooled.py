"""The published analysis: unpaired tests on trials that are pooled over participants (docs/statistics.md).

It treats trials of one person as independent, which makes p too small; it is here to be compared with.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import stats

from mrnav_server.core.arrays import FloatArray
from mrnav_server.study.statistics_normality import Normality, shapiro
from mrnav_server.study.statistics_samples import Samples

POOLING = "pooled trials: repeated trials are treated as independent, so p is too small"
PooledTest = Literal["t-test", "Mann–Whitney U"]


@dataclass(frozen=True, slots=True)
class PooledAnalysis:
    """What the trials tell when nobody asks whose they are.

    Attributes:
        first_n, second_n: Trials in either condition.
        first_mean, second_mean, first_sd, second_sd: Over trials.
        first_normality, second_normality: Shapiro–Wilk in either condition.
        t, t_p: Student's t-test for independent samples.
        u, u_p: Mann–Whitney U; exact for up to 8 trials in a condition without ties.
        test: The t-test if both conditions pass Shapiro–Wilk, else Mann–Whitney U; None without data.
        p: Its p, two-sided.
    """

    first_n: int
    second_n: int
    first_mean: float
    second_mean: float
    first_sd: float
    second_sd: float
    first_normality: Normality
    second_normality: Normality
    t: float
    t_p: float
    u: float
    u_p: float
    test: PooledTest | None
    p: float


def pooled_analysis(samples: Samples, alpha: float = 0.05) -> PooledAnalysis:
    """Compare two conditions as if every trial were somebody else's."""
    first, second = samples.pooled(samples.first), samples.pooled(samples.second)
    normal_first, normal_second = shapiro(first), shapiro(second)
    t, t_p = _t_test(first, second)
    u, u_p = _mann_whitney(first, second)
    test: PooledTest | None = None
    if first.size and second.size:
        passed = normal_first.p > alpha and normal_second.p > alpha
        test = "t-test" if passed else "Mann–Whitney U"
    return PooledAnalysis(
        first_n=first.size,
        second_n=second.size,
        first_mean=float(first.mean()) if first.size else math.nan,
        second_mean=float(second.mean()) if second.size else math.nan,
        first_sd=_sd(first),
        second_sd=_sd(second),
        first_normality=normal_first,
        second_normality=normal_second,
        t=t,
        t_p=t_p,
        u=u,
        u_p=u_p,
        test=test,
        p=math.nan if test is None else t_p if test == "t-test" else u_p,
    )


def _t_test(first: FloatArray, second: FloatArray) -> tuple[float, float]:
    if first.size < 2 or second.size < 2:
        return math.nan, math.nan
    largest = max(float(np.abs(first).max()), float(np.abs(second).max()))
    if not max(np.ptp(first), np.ptp(second)) > 1e-12 * largest:
        return math.nan, math.nan
    found = stats.ttest_ind(first, second)
    return float(found.statistic), float(found.pvalue)


def _mann_whitney(first: FloatArray, second: FloatArray) -> tuple[float, float]:
    if not first.size or not second.size:
        return math.nan, math.nan
    if np.ptp(np.concatenate([first, second])) == 0:
        return first.size * second.size / 2.0, 1.0
    found = stats.mannwhitneyu(first, second)
    return float(found.statistic), float(found.pvalue)


def _sd(values: FloatArray) -> float:
    return float(values.std(ddof=1)) if values.size > 1 else math.nan
