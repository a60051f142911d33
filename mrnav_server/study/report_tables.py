"""The statistical tables of a report (docs/report.md)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from mrnav_server.core.arrays import FloatArray
from mrnav_server.loops.trial_log import Condition
from mrnav_server.study import published
from mrnav_server.study.measures import Measure
from mrnav_server.study.report_table import Cell, Table, number, p_value, text
from mrnav_server.study.statistics import Analysis
from mrnav_server.study.statistics_normality import shapiro
from mrnav_server.study.statistics_pooled import POOLING
from mrnav_server.study.statistics_samples import Pairs
from mrnav_server.study.study_data import Study

WITH: Condition = "with_autonomy"
WITHOUT: Condition = "without_autonomy"
ARROWS = "↑ higher is better, ↓ lower is better. Lower G is straighter; a lower S is smoother (less jerk)."
_DIFFERENCE = "Differences are with minus without autonomy."

_MEANS = (
    "without autonomy: mean",
    "without autonomy: SD",
    "with autonomy: mean",
    "with autonomy: SD",
    "difference",
    "better",
)
_UNKNOWN: Mapping[Condition, float] = {WITH: math.nan, WITHOUT: math.nan}

Analyses = Mapping[str, Analysis]
"""By a measure's symbol; the first condition is with autonomy."""


def comparison(
    name: str, title: str, measures: Sequence[Measure], analyses: Analyses, people: str, note: str
) -> Table:
    """Return this study's means beside the published ones."""
    rows = []
    for each in measures:
        known = {**published.METRICS, **published.TLX}.get(each.symbol, _UNKNOWN)
        published_cells = (known[WITHOUT], known[WITH], known[WITH] - known[WITHOUT])
        rows.append(
            (
                text(each.label),
                *_means(each, analyses[each.symbol].samples.pairs()),
                *(number(value, each.decimals) for value in published_cells),
            )
        )
    return Table(
        name,
        title,
        ("metric", *_MEANS, *(f"published: {each}" for each in ("without", "with", "difference"))),
        tuple(rows),
        (
            f"{_own_means(people)} {note}",
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
            "difference: mean",
            "difference: CI low",
            "difference: CI high",
            "test",
            "p",
            "p Holm",
            "effect size: d_z",
            "effect size: CI low",
            "effect size: CI high",
            "r_rb",
            "p sign-flip",
            "least p",
        ),
        tuple(rows),
        (
            f"One mean per operator and condition; n {people} have both. {_DIFFERENCE} CI: 95 %"
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
            "trials: without",
            "trials: with",
            "mean: without",
            "mean: with",
            "test",
            "p",
            "p Holm",
            "published: test",
            "published: p",
        ),
        tuple(rows),
        (f"To be compared with the published table, not to be cited as evidence: {POOLING}. {ARROWS}",),
    )


def normality_table(measures: Sequence[Measure], analyses: Analyses) -> Table:
    """Return Shapiro–Wilk of the trials in either condition and of the operators' differences."""
    rows, notes = [], []
    for each in measures:
        analysis = analyses[each.symbol]
        known = published.SHAPIRO_P[each.symbol]
        tested = (
            ("trials without", analysis.pooled.second_normality, known[WITHOUT]),
            ("trials with", analysis.pooled.first_normality, known[WITH]),
            ("operators' differences", shapiro(analysis.samples.pairs().differences), math.nan),
        )
        for of, found, known_p in tested:
            rows.append((text(each.symbol), text(of), number(found.w, 3), p_value(found.p), p_value(known_p)))
            if found.note:
                notes.append(f"{each.symbol}, {of}: {found.note}.")
    return Table(
        "normality",
        "Shapiro–Wilk test of normality",
        ("metric", "of", "W", "p", "published p"),
        tuple(rows),
        ("A p of at least 0.05 lets values pass as normal. It says little about few values.", *notes),
    )


def means_table(
    name: str, title: str, measures: Sequence[Measure], studies: Mapping[str, Study], people: str
) -> Table:
    """Return means and spreads of measures that nothing published stands beside.

    Args:
        name: Of the table's files.
        title: Above it.
        measures: One row each.
        studies: By task, "" for all of them together.
        people: What the operators are called.
    """
    rows = tuple(
        (text(task), text(each.title), text(each.label), *_means(each, each.samples(study).pairs()))
        for task, study in studies.items()
        for each in measures
    )
    notes = (f"{_own_means(people)} Not tested. ↑ higher is better, ↓ lower is better.",)
    table = Table(name, title, ("task", "measure", "symbol", *_MEANS), rows, notes)
    if list(studies) != [""]:
        return table
    return replace(table, header=table.header[1:], rows=tuple(row[1:] for row in rows))


def _means(measure: Measure, pairs: Pairs) -> tuple[Cell, ...]:
    """Return the cells of the columns ``_MEANS``."""
    sign = 1.0 if measure.better == "higher" else -1.0
    better, count = int((sign * pairs.differences > 0).sum()), len(pairs.participants)
    values = (_mean(pairs.second), _sd(pairs.second), _mean(pairs.first), _sd(pairs.first))
    return (
        *(number(value, measure.decimals) for value in (*values, _mean(pairs.differences))),
        Cell(f"{better} of {count}", float(better)) if count else number(math.nan, 0),
    )


def _own_means(people: str) -> str:
    return (
        f"Means and standard deviations (SD) over the {people} who have both conditions; each counts with the"
        " mean of its trials. Better: for how many of them autonomy moved the metric the right way; an equal"
        f" value does not count. {_DIFFERENCE}"
    )


def _mean(values: FloatArray) -> float:
    return float(values.mean()) if values.size else math.nan


def _sd(values: FloatArray) -> float:
    return float(values.std(ddof=1)) if values.size > 1 else math.nan
