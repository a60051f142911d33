"""Both analyses of several measures: the paired one, the published one beside it, Holm over the measures."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from mrnav_server.study.statistics_paired import PairedAnalysis, PairedTest, paired_analysis
from mrnav_server.study.statistics_pooled import POOLING, PooledAnalysis, pooled_analysis
from mrnav_server.study.statistics_samples import Samples

PAIRING = "paired: one mean per participant and condition"


@dataclass(frozen=True, slots=True)
class Analysis:
    """One measure's analyses.

    Attributes:
        samples: What was analysed.
        paired: The primary analysis.
        paired_holm: Its p, adjusted by Holm over the measures.
        pooled: The published analysis.
        pooled_holm: Its p, adjusted likewise.
    """

    samples: Samples
    paired: PairedAnalysis
    paired_holm: float
    pooled: PooledAnalysis
    pooled_holm: float

    def record(self) -> dict[str, Any]:
        """Return both analyses as an object for JSON; what is not defined is null."""
        conditions = [self.samples.first, self.samples.second]
        paired: dict[str, Any] = asdict(self.paired)
        pooled: dict[str, Any] = asdict(self.pooled)
        difference = " − ".join(conditions)
        found = {
            "conditions": conditions,
            "paired": {"label": PAIRING, "difference": difference, **paired, "p_holm": self.paired_holm},
            "pooled": {"label": POOLING, **pooled, "p_holm": self.pooled_holm},
        }
        defined: dict[str, Any] = _defined(found)
        return defined


def analyse(
    measures: Mapping[str, Samples], alpha: float = 0.05, test: PairedTest | None = None
) -> dict[str, Analysis]:
    """Analyse measures, which share ``alpha`` by Holm.

    Args:
        measures: Samples by name.
        alpha: Level of the tests.
        test: The paired test of every measure; chosen by its differences if left out.
    """
    tests = sum(len(samples.pairs().participants) > 1 for samples in measures.values())
    paired = {
        name: paired_analysis(samples, alpha, test, max(tests, 1)) for name, samples in measures.items()
    }
    pooled = {name: pooled_analysis(samples, alpha) for name, samples in measures.items()}
    paired_holm = holm({name: each.p for name, each in paired.items()})
    pooled_holm = holm({name: each.p for name, each in pooled.items()})
    return {
        name: Analysis(samples, paired[name], paired_holm[name], pooled[name], pooled_holm[name])
        for name, samples in measures.items()
    }


def holm(p: Mapping[str, float]) -> dict[str, float]:
    """Return p adjusted for testing them all; one that is NaN stays so and does not count.

    Source: Holm, A simple sequentially rejective multiple test procedure, 1979.
    """
    adjusted = dict(p)
    known = sorted((value, name) for name, value in p.items() if not math.isnan(value))
    largest = 0.0
    for rank, (value, name) in enumerate(known):
        largest = max(largest, min(1.0, (len(known) - rank) * value))
        adjusted[name] = largest
    return adjusted


def _defined(value: Any) -> Any:  # noqa: ANN401 - JSON
    if isinstance(value, dict):
        return {name: _defined(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_defined(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
