"""The statistical tables of a report (docs/report.md)."""

import math
from collections.abc import Mapping, Sequence

from mrnav_server.core.arrays import FloatArray
from mrnav_server.loops.trial_log import Condition
from mrnav_server.study import published
from mrnav_server.study.measures import Measure
from mrnav_server.study.report_table import Cell, Table, number, p_value, text
from mrnav_server.study.statistics import Analysis
from mrnav_server.study.statistics_normality import Normality, shapiro
from mrnav_server.study.statistics_pooled import POOLING
from mrnav_server.study.study_data import Study

WITH: Condition = "with_autonomy"
WITHOUT: Condition = "without_autonomy"
ARROWS = "↑ higher is better, ↓ lower is better. Lower G is straighter; a lower S is smoother (less jerk)."
_DIFFERENCE = "Differences are with minus without autonomy."

Analyses = Mapping[str, Analysis]
"""By a measure's symbol; the first condition is with autonomy."""


def comparison(study: Study, measures: Sequence[Measure], analyses: Analyses) -> Table:
    """Return this study's means beside the published ones."""
    rows = []
    for each in measures:
        paired = analyses[each.symbol].paired
        pairs = analyses[each.symbol].samples.pairs()
        sign = 1.0 if each.better == "higher" else -1.0
        better = int((sign * pairs.differences > 0).sum())
        known = published.METRICS[each.symbol]
        rows.append(
            (
                text(each.label),
                number(paired.second_mean, each.decimals),
                number(_sd(pairs.second), each.decimals),
                number(paired.first_mean, each.decimals),
                number(_sd(pairs.first), each.decimals),
                number(paired.mean_difference, each.decimals),
                Cell(f"{better} of {paired.participants}", float(better)),
                number(known[WITHOUT], each.decimals),
                number(known[WITH], each.decimals),
                number(known[WITH] - known[WITHOUT], each.decimals),
            )
        )
    return Table(
        "comparison",
        "The five metrics, beside the published ones",
        (
            "metric",
            "without: mean",
            "SD",
            "with: mean",
            "SD",
            "difference",
            "better with",
            "published without",
            "with",
            "difference",
        ),
        tuple(rows),
        (
            f"Means and standard deviations (SD) over {len(study.operators)} {study.people}, each the mean of"
            f" their trials. {_DIFFERENCE} {ARROWS}",
            "Published: five participants on hardware (arXiv:2503.06359); other vessels, other people.",
        ),
    )


def paired_table(
    name: str, title: str, measures: Sequence[Measure], analyses: Analyses, people: str, note: str
) -> Table:
    """Return the primary analysis."""
    rows = []
    for each in measures:
        analysis, paired = analyses[each.symbol], analyses[each.symbol].paired
        rows.append(
            (
                text(each.label),
                number(float(paired.participants), 0),
                number(paired.mean_difference, max(each.decimals, 1)),
                number(paired.mean_ci[0], max(each.decimals, 1)),
                number(paired.mean_ci[1], max(each.decimals, 1)),
                text(paired.test or "–"),
                p_value(paired.p),
                p_value(analysis.paired_holm),
                number(paired.d_z, 2),
                number(paired.d_z_ci[0], 2),
                number(paired.d_z_ci[1], 2),
                number(paired.rank_biserial, 2),
                p_value(paired.sign_flip_p),
                p_value(paired.smallest_p),
            )
        )
    warned: dict[str, list[str]] = {}
    for each in measures:
        for warning in analyses[each.symbol].paired.warnings:
            warned.setdefault(warning, []).append(each.symbol)
    return Table(
        name,
        title,
        (
            "metric",
            "n",
            "difference",
            "CI low",
            "CI high",
            "test",
            "p",
            "p Holm",
            "d_z",
            "low",
            "high",
            "r_rb",
            "p sign-flip",
            "least p",
        ),
        tuple(rows),
        (
            f"One mean per operator and condition, n of the {people} have both. {_DIFFERENCE} CI: 95 %"
            " confidence interval. d_z: mean over SD of the differences, with its interval; r_rb: matched"
            " rank-biserial correlation. Least p: the smallest that a test by rank or sign can reach."
            f" {note}",
            *(f"{', '.join(symbols)}: {warning}." for warning, symbols in warned.items()),
        ),
    )


def pooled_table(measures: Sequence[Measure], analyses: Analyses) -> Table:
    """Return the published analysis, on this study's trials, beside the published p."""
    rows = []
    for each in measures:
        analysis, pooled = analyses[each.symbol], analyses[each.symbol].pooled
        test, p = published.TESTS[each.symbol]
        rows.append(
            (
                text(each.label),
                number(float(pooled.second_n), 0),
                number(float(pooled.first_n), 0),
                number(pooled.second_mean, each.decimals),
                number(pooled.first_mean, each.decimals),
                text(pooled.test or "–"),
                p_value(pooled.p),
                p_value(analysis.pooled_holm),
                text(test),
                p_value(p),
            )
        )
    return Table(
        "pooled",
        "As published: unpaired tests on pooled trials",
        (
            "metric",
            "trials without",
            "with",
            "mean without",
            "with",
            "test",
            "p",
            "p Holm",
            "published test",
            "p",
        ),
        tuple(rows),
        (f"To be compared with the published table, not to be cited as evidence: {POOLING}. {ARROWS}",),
    )


def normality_table(measures: Sequence[Measure], analyses: Analyses) -> Table:
    """Return Shapiro–Wilk of the trials in either condition and of the operators' differences."""
    rows = []
    for each in measures:
        analysis = analyses[each.symbol]
        known = published.SHAPIRO_P[each.symbol]
        tested = (
            ("trials without", analysis.pooled.second_normality, known[WITHOUT]),
            ("trials with", analysis.pooled.first_normality, known[WITH]),
            ("operators' differences", shapiro(analysis.samples.pairs().differences), math.nan),
        )
        rows += [_normality_row(each, *entry) for entry in tested]
    return Table(
        "normality",
        "Shapiro–Wilk",
        ("metric", "of", "W", "p", "published p", "note"),
        tuple(rows),
        ("A p of at least 0.05 lets values pass as normal. It says little about few values.",),
    )


def _normality_row(measure: Measure, of: str, found: Normality, known_p: float) -> tuple[Cell, ...]:
    return (
        text(measure.symbol),
        text(of),
        number(found.w, 3),
        p_value(found.p),
        p_value(known_p),
        text(found.note),
    )


def means_table(
    name: str, title: str, study: Study, measures: Sequence[Measure], analyses: Analyses, note: str
) -> Table:
    """Return means and spreads of measures that nothing published stands beside."""
    rows = []
    for each in measures:
        pooled = analyses[each.symbol].pooled
        rows.append(
            (
                text(f"{each.title} {each.arrow}"),
                text(each.unit),
                number(pooled.second_mean, each.decimals),
                number(pooled.second_sd, each.decimals),
                number(pooled.first_mean, each.decimals),
                number(pooled.first_sd, each.decimals),
            )
        )
    return Table(
        name,
        title,
        ("measure", "unit", "without: mean", "SD", "with: mean", "SD"),
        tuple(rows),
        (f"Over the trials of {len(study.operators)} {study.people}. {note}",),
    )


def _sd(values: FloatArray) -> float:
    return float(values.std(ddof=1)) if values.size > 1 else math.nan
