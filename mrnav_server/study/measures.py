"""What a report measures: name, unit and direction of every metric, and where a trial holds it."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from mrnav_server.core.handover_metrics import HandoverMetrics
from mrnav_server.core.tlx import KEYS
from mrnav_server.loops.tlx_record import TlxAnswers
from mrnav_server.study.statistics_samples import Sample, Samples, samples
from mrnav_server.study.study_data import Study, StudyTrial


@dataclass(frozen=True, slots=True)
class Measure:
    """One metric.

    Attributes:
        symbol: As in tables and files.
        title: In words.
        unit: "" for none.
        better: Which way is better.
        decimals: How many are shown.
        of: A trial's value; NaN where it is not defined.
    """

    symbol: str
    title: str
    unit: str
    better: Literal["higher", "lower"]
    decimals: int
    of: Callable[[StudyTrial], float]

    @property
    def arrow(self) -> str:
        """Which way is better, as a sign."""
        return "↑" if self.better == "higher" else "↓"

    @property
    def label(self) -> str:
        """Symbol, arrow and unit."""
        return f"{self.symbol} {self.arrow}" + (f" ({self.unit})" if self.unit else "")

    @property
    def axis(self) -> str:
        """Symbol and unit, beside an axis."""
        return f"{self.symbol} ({self.unit})" if self.unit else self.symbol

    def samples(self, study: Study) -> Samples:
        """Return the study's values."""
        rows = [Sample(t.header.participant, t.header.condition, self.of(t)) for t in study.trials]
        return samples(rows)


def _handed(of: Callable[[HandoverMetrics], float]) -> Callable[[StudyTrial], float]:
    return lambda trial: math.nan if trial.handover is None else of(trial.handover)


FIVE = (
    Measure("Va", "average speed", "µm/s", "higher", 0, lambda t: t.metrics.average_speed_um_per_s),
    Measure("TOC", "time of completion", "s", "lower", 2, lambda t: t.metrics.completion_s),
    Measure("G", "geometric straightness", "log₁₀ µm⁻¹", "lower", 2, lambda t: t.metrics.straightness.value),
    Measure("S", "smoothness", "", "lower", 2, lambda t: t.metrics.smoothness.value),
    Measure("C", "wall contacts", "count", "lower", 2, lambda t: float(t.metrics.contacts)),
)
"""The published metrics."""
FURTHER = (
    Measure("LDLJ", "log dimensionless jerk", "", "higher", 2, lambda t: t.metrics.log_dimensionless_jerk),
    Measure("SPARC", "spectral arc length", "", "higher", 2, lambda t: t.metrics.spectral_arc_length),
    Measure("SPL", "share of the shortest path", "", "higher", 3, lambda t: t.metrics.path_length_share),
    Measure("clearance", "smallest clearance", "µm", "higher", 0, lambda t: t.metrics.min_clearance_um),
    Measure("first motion", "go cue to first motion", "s", "lower", 2, lambda t: t.metrics.first_motion_s),
)
HANDOVER = (
    Measure("S window", "S of the window", "", "lower", 2, _handed(lambda h: h.smoothness.value)),
    Measure("jerk", "peak jerk", "mm/s³", "lower", 0, _handed(lambda h: h.peak_jerk_um_per_s3 / 1000.0)),
    Measure("standstill", "standstill", "s", "lower", 2, _handed(lambda h: h.standstill_s)),
    Measure("jump", "jump of the setpoint", "µm", "lower", 0, _handed(lambda h: h.jump_um)),
    Measure(
        "take-over",
        "take-over time",
        "s",
        "lower",
        2,
        lambda t: (
            math.nan
            if t.handover is None or t.header.condition == "without_autonomy"
            else t.handover.take_over_s
        ),
    ),
)
"""Of the 2.5 s after the switch; without autonomy, after the critical area was entered."""


def _answered(of: Callable[[TlxAnswers], float]) -> Callable[[StudyTrial], float]:
    return lambda trial: math.nan if trial.answers is None else of(trial.answers)


def _rating(key: str) -> Callable[[TlxAnswers], float]:
    return lambda answers: float(answers.ratings[key])


WORKLOAD = (
    Measure("weighted", "weighted", "", "lower", 1, _answered(lambda a: a.workload().weighted)),
    Measure("raw", "raw", "", "lower", 1, _answered(lambda a: a.workload().raw)),
    *(Measure(key, key, "", "lower", 1, _answered(_rating(key))) for key in KEYS),
)
"""NASA-TLX: the two scores, then the six scales."""
