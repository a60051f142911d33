"""How many participants a paired comparison needs, and what so many can show (docs/statistics.md)."""

import math
from dataclasses import dataclass

from scipy import optimize, stats

from mrnav_server.core.errors import ConfigError
from mrnav_server.study.statistics_noncentral import noncentral_t_cdf
from mrnav_server.study.statistics_paired import least_participants

RANK_EFFICIENCY = 3.0 / math.pi
"""Of Wilcoxon's test against t, for normal differences and many participants."""
_MOST = 100_000


@dataclass(frozen=True, slots=True)
class Power:
    """A paired t-test, two-sided, planned.

    Attributes:
        effect: d_z, mean over standard deviation of the participants' differences.
        participants: How many.
        power: Chance to find the effect, 0..1; at least the one asked for, as participants are whole.
        alpha: Level that the test is held to.
        participants_by_rank: How many Wilcoxon's test needs for the same power.
        least_by_rank: Below so many, no data could make a test by rank or sign significant.
    """

    effect: float
    participants: int
    power: float
    alpha: float
    participants_by_rank: int
    least_by_rank: int


def planned(
    effect: float | None = None,
    participants: int | None = None,
    power: float | None = None,
    alpha: float = 0.05,
    tests: int = 1,
) -> Power:
    """Return the plan that two of effect, participants and power make.

    Args:
        effect: d_z, > 0.
        participants: At least 2.
        power: Between alpha and 1.
        alpha: Level over all measures.
        tests: Measures that share it; the plan holds for the strictest of Holm's steps, ``alpha/tests``.

    Raises:
        ConfigError: If not exactly two are given, or one is out of range.
    """
    if sum(each is not None for each in (effect, participants, power)) != 2:
        raise ConfigError("give two of effect (d_z), participants and power; the third is the answer")
    if not 0.0 < alpha < 1.0 or tests < 1:
        raise ConfigError(
            f"alpha must lie between 0 and 1 and tests be at least 1, not {alpha:g} and {tests}"
        )
    level = alpha / tests
    if effect is not None and not 0.0 < effect < math.inf:
        raise ConfigError(f"effect must be a d_z above 0, for example 0.8, not {effect:g}")
    if participants is not None and not 2 <= participants <= _MOST:
        raise ConfigError(f"participants must be 2 to {_MOST}, not {participants}")
    if power is not None and not level < power < 1.0:
        raise ConfigError(f"power must lie between {level:g} and 1, for example 0.8, not {power:g}")
    if effect is None:
        assert participants is not None
        assert power is not None
        effect = _detectable(participants, power, level)
    elif participants is None:
        assert power is not None
        participants = _needed(effect, power, level)
    return Power(
        effect=effect,
        participants=participants,
        power=paired_power(effect, participants, level),
        alpha=level,
        participants_by_rank=max(math.ceil(participants / RANK_EFFICIENCY), least_participants(level)),
        least_by_rank=least_participants(level),
    )


def paired_power(effect: float, participants: int, alpha: float) -> float:
    """Return the power of the two-sided paired t-test, by the noncentral t distribution.

    Source: Cohen, Statistical power analysis for the behavioral sciences, 1988.
    """
    df, noncentrality = participants - 1, effect * math.sqrt(participants)
    critical = float(stats.t.ppf(1.0 - alpha / 2.0, df))
    below = noncentral_t_cdf(critical, df, noncentrality) - noncentral_t_cdf(-critical, df, noncentrality)
    return 1.0 - below


def _needed(effect: float, power: float, alpha: float) -> int:
    least, most = 2, 2
    while paired_power(effect, most, alpha) < power:
        least, most = most, 2 * most
        if most > _MOST:
            raise ConfigError(f"an effect of {effect:g} needs more than {_MOST} participants")
    while least < most:
        middle = (least + most) // 2
        if paired_power(effect, middle, alpha) < power:
            least = middle + 1
        else:
            most = middle
    return most


def _detectable(participants: int, power: float, alpha: float) -> float:
    def excess(effect: float) -> float:
        return paired_power(effect, participants, alpha) - power

    most = 1.0
    while excess(most) < 0:
        most *= 2.0
    return float(optimize.brentq(excess, 1e-6, most))
