"""The paired analysis, on one mean per participant and condition (docs/statistics.md).

Trials of one person are no independent samples; the participants' own differences are.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import optimize, stats

from mrnav_server.core.arrays import FloatArray
from mrnav_server.study.statistics_noncentral import noncentral_t_cdf
from mrnav_server.study.statistics_normality import shapiro
from mrnav_server.study.statistics_samples import Samples

PairedTest = Literal["paired t", "Wilcoxon signed-rank", "exact sign-flip"]
ENUMERATED = 20
"""Up to so many differences every pattern of signs is tried, else 100 000 random ones."""
_FLIPS = 100_000


@dataclass(frozen=True, slots=True)
class PairedAnalysis:
    """What the participants' differences, first condition minus second, tell.

    NaN where the data do not define a value.

    Attributes:
        participants: How many have both conditions.
        left_out: Those who lack one.
        first_mean, second_mean: Means of the participants' means.
        mean_difference: In the measure's unit.
        mean_ci: Its confidence interval, by Student's t.
        shapiro_p: Shapiro–Wilk of the differences.
        t, df, t_p: Paired t-test.
        d_z: Mean over standard deviation of the differences, with its confidence interval ``d_z_ci``.
        wilcoxon_w, wilcoxon_p: Wilcoxon's signed-rank test; exact, with ties too, up to 20 differences.
        median_difference: Hodges and Lehmann's, with its confidence interval ``median_ci``.
        rank_biserial: Matched, −1..1.
        sign_flip_p: Test of the mean over all patterns of signs.
        test: The primary one of the three.
        p: Its p, two-sided.
        smallest_p: The least p that a test by rank or sign can reach on so many differences.
        warnings: What a reader must know.
    """

    participants: int
    left_out: tuple[str, ...]
    first_mean: float
    second_mean: float
    mean_difference: float
    mean_ci: tuple[float, float]
    shapiro_p: float
    t: float
    df: int
    t_p: float
    d_z: float
    d_z_ci: tuple[float, float]
    wilcoxon_w: float
    wilcoxon_p: float
    median_difference: float
    median_ci: tuple[float, float]
    rank_biserial: float
    sign_flip_p: float
    test: PairedTest | None
    p: float
    smallest_p: float
    warnings: tuple[str, ...]


def paired_analysis(
    samples: Samples, alpha: float = 0.05, test: PairedTest | None = None, tests: int = 1
) -> PairedAnalysis:
    """Compare two conditions by the participants' own differences.

    Args:
        samples: The values.
        alpha: Level of the tests; the confidence intervals cover ``1 − alpha``.
        test: The primary test; if left out, the paired t where Shapiro–Wilk lets the differences pass as
            normal, else Wilcoxon's.
        tests: How many measures share ``alpha`` by Holm; it tells whether ``alpha`` can be reached at all.
    """
    pairs = samples.pairs()
    d = pairs.differences
    normality = shapiro(d)
    t, t_p, spread = _t_test(d)
    w, w_p = _wilcoxon(d)
    chosen = test or _choice(d, normality.p, alpha)
    p = {"paired t": t_p, "Wilcoxon signed-rank": w_p, "exact sign-flip": sign_flip_p(d)}.get(
        chosen or "", math.nan
    )
    d_z = float(d.mean()) / spread if spread > 0 else math.nan
    smallest = smallest_reachable_p(d)
    return PairedAnalysis(
        participants=d.size,
        left_out=pairs.left_out,
        first_mean=_mean(pairs.first),
        second_mean=_mean(pairs.second),
        mean_difference=_mean(d),
        mean_ci=_mean_interval(d, spread, alpha),
        shapiro_p=normality.p,
        t=t,
        df=max(d.size - 1, 0),
        t_p=t_p,
        d_z=d_z,
        d_z_ci=d_z_interval(d_z, d.size, alpha),
        wilcoxon_w=w,
        wilcoxon_p=w_p,
        median_difference=_hodges_lehmann(d),
        median_ci=_hodges_lehmann_interval(d, alpha),
        rank_biserial=rank_biserial(d),
        sign_flip_p=sign_flip_p(d),
        test=chosen,
        p=p,
        smallest_p=smallest,
        warnings=tuple(_warnings(samples, pairs.left_out, d, chosen, alpha, tests)),
    )


def smallest_reachable_p(differences: FloatArray) -> float:
    """Return 2/2ⁿ, the least two-sided p of a test by rank or sign on n differences that are not zero."""
    return min(1.0, 2.0 ** (1 - np.count_nonzero(differences)))


def sign_flip_p(differences: FloatArray) -> float:
    """Return the two-sided p of the mean difference over patterns of signs; NaN without differences.

    Exact up to 20 differences; beyond, over 100 000 random patterns from a fixed seed.

    Args:
        differences: Shape (n,).
    """
    d = np.asarray(differences, dtype=np.float64)
    if d.size == 0:
        return math.nan
    # Sums that differ by rounding alone count as equal.
    reached = abs(d.sum()) - 1e-9 * np.abs(d).sum()
    if d.size <= ENUMERATED:
        sums = np.zeros(1)
        for each in d.tolist():
            sums = np.concatenate([sums + each, sums - each])
        return float((np.abs(sums) >= reached).mean())
    signs = np.random.default_rng(0).choice((-1.0, 1.0), size=(_FLIPS, d.size))
    return float((1 + (np.abs(signs @ d) >= reached).sum()) / (1 + _FLIPS))


def rank_biserial(differences: FloatArray) -> float:
    """Return the matched rank-biserial correlation, (W₊ − W₋) over their sum; NaN without differences.

    Source: Kerby, The simple difference formula, 2014. Zeros are left out, as in Wilcoxon's test.
    """
    d = differences[differences != 0.0]
    if d.size == 0:
        return math.nan
    ranks = stats.rankdata(np.abs(d))
    return float((ranks * np.sign(d)).sum() / ranks.sum())


def d_z_interval(d_z: float, participants: int, alpha: float) -> tuple[float, float]:
    """Return the confidence interval of d_z by the noncentral t distribution.

    Source: Cumming and Finch, A primer on confidence intervals based on noncentral distributions, 2001.
    """
    if math.isnan(d_z) or participants < 2:
        return math.nan, math.nan
    root = math.sqrt(participants)
    t, df = d_z * root, participants - 1

    def bound(probability: float) -> float:
        def excess(noncentrality: float) -> float:
            return noncentral_t_cdf(t, df, noncentrality) - probability

        # At few degrees of freedom the distribution is wide in proportion to t.
        reach = 10.0 + 3.0 * abs(t)
        return float(optimize.brentq(excess, t - reach, t + reach)) / root

    return bound(1.0 - alpha / 2.0), bound(alpha / 2.0)


def _t_test(d: FloatArray) -> tuple[float, float, float]:
    """Return t, p and the differences' standard deviation; NaN and 0 where they are all the same."""
    if d.size < 2:
        return math.nan, math.nan, 0.0
    spread = float(d.std(ddof=1))
    if spread <= 1e-12 * float(np.abs(d).max()):
        return math.nan, math.nan, 0.0
    t = float(d.mean()) / (spread / math.sqrt(d.size))
    return t, float(2.0 * stats.t.sf(abs(t), d.size - 1)), spread


def _wilcoxon(d: FloatArray) -> tuple[float, float]:
    """Return W, the smaller sum of ranks, and p; zeros are left out."""
    if not d.any():
        return (0.0, 1.0) if d.size else (math.nan, math.nan)
    d = d[d != 0.0]
    ranks = stats.rankdata(np.abs(d)) * np.sign(d)
    w = min(float(ranks[ranks > 0].sum()), float(-ranks[ranks < 0].sum()))
    return w, sign_flip_p(ranks) if d.size <= ENUMERATED else float(stats.wilcoxon(d).pvalue)


def _choice(d: FloatArray, normality_p: float, alpha: float) -> PairedTest | None:
    if d.size < 2:
        return None
    return "paired t" if normality_p > alpha else "Wilcoxon signed-rank"


def _mean_interval(d: FloatArray, spread: float, alpha: float) -> tuple[float, float]:
    if not spread > 0:
        return math.nan, math.nan
    half = float(stats.t.ppf(1.0 - alpha / 2.0, d.size - 1)) * spread / math.sqrt(d.size)
    return float(d.mean()) - half, float(d.mean()) + half


def _walsh(d: FloatArray) -> FloatArray:
    """Return the means of all pairs of differences, each with itself too, sorted."""
    i, j = np.triu_indices(d.size)
    return np.sort((d[i] + d[j]) / 2.0)


def _hodges_lehmann(d: FloatArray) -> float:
    return float(np.median(_walsh(d))) if d.size else math.nan


def _hodges_lehmann_interval(d: FloatArray, alpha: float) -> tuple[float, float]:
    """Return the interval that Wilcoxon's exact distribution gives; NaN where n is too small for any."""
    walsh = _walsh(d)
    # How many of the 2ⁿ patterns of signs give each sum of positive ranks.
    patterns = np.ones(1)
    for rank in range(1, d.size + 1):
        patterns = np.convolve(patterns, np.eye(1, rank + 1, 0)[0] + np.eye(1, rank + 1, rank)[0]) / 2.0
    below = int(np.searchsorted(np.cumsum(patterns), alpha / 2.0, side="right"))
    if below == 0:
        return math.nan, math.nan
    return float(walsh[below - 1]), float(walsh[-below])


def _warnings(
    samples: Samples,
    left_out: tuple[str, ...],
    d: FloatArray,
    test: PairedTest | None,
    alpha: float,
    tests: int,
) -> list[str]:
    found = []
    if samples.missing:
        found.append(f"rows without a value, left out: {samples.missing}")
    if left_out:
        found.append(f"left out, as one of the conditions is missing: {', '.join(left_out)}")
    if d.size < 2:
        return [*found, f"differences: {d.size}; nothing can be tested on fewer than two"]
    if not np.ptp(d) > 1e-12 * float(np.abs(d).max()):
        found.append("all differences are the same: t and d_z are not defined")
    elif d.size < 3:
        found.append("fewer than 3 differences: normality cannot be tested")
    smallest = smallest_reachable_p(d)
    if d.any() and smallest > alpha / tests:
        by = (
            f"{alpha:g}" if tests == 1 else f"the {alpha:g}/{tests} that Holm asks for among {tests} measures"
        )
        found.append(
            f"the smallest reachable p by rank or sign is {smallest:.4g} on"
            f" {np.count_nonzero(d)} differences, above {by}: {least_participants(alpha / tests)} are needed"
            + (
                ", and only the assumption of normal differences lets t go below"
                if test == "paired t"
                else ""
            )
        )
    return found


def least_participants(alpha: float) -> int:
    """Return how many differences a test by rank or sign needs before its p can reach ``alpha``."""
    return math.ceil(round(1.0 - math.log2(alpha), 9))


def _mean(values: FloatArray) -> float:
    return float(values.mean()) if values.size else math.nan
