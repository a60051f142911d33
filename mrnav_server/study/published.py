"""The published figures that a study is compared with (docs/study.md): five participants, on hardware.

Mao and Zhang, arXiv:2503.06359.
"""

from collections.abc import Mapping

from mrnav_server.loops.trial_log import Condition

METRICS: Mapping[str, Mapping[Condition, float]] = {
    "Va": {"with_autonomy": 2400.59, "without_autonomy": 1686.98},
    "TOC": {"with_autonomy": 11.38, "without_autonomy": 17.17},
    "G": {"with_autonomy": -4.45, "without_autonomy": -3.58},
    "S": {"with_autonomy": 0.62, "without_autonomy": 0.99},
    "C": {"with_autonomy": 0.3, "without_autonomy": 0.8},
}
"""Means by metric and condition."""
SHAPIRO_P: Mapping[str, Mapping[Condition, float]] = {
    "Va": {"without_autonomy": 0.061, "with_autonomy": 0.026},
    "TOC": {"without_autonomy": 0.882, "with_autonomy": 0.057},
    "G": {"without_autonomy": 0.093, "with_autonomy": 0.0001},
    "S": {"without_autonomy": 0.490, "with_autonomy": 0.005},
    "C": {"without_autonomy": 0.0001, "with_autonomy": 0.0001},
}
"""Shapiro–Wilk's p by metric and condition."""
TESTS: Mapping[str, tuple[str, float]] = {
    "Va": ("Mann–Whitney U", 3e-10),
    "TOC": ("t-test", 1e-10),
    "G": ("Mann–Whitney U", 6e-9),
    "S": ("Mann–Whitney U", 1e-10),
    "C": ("Mann–Whitney U", 7e-3),
}
"""The unpaired test and its p by metric."""
TLX: Mapping[str, Mapping[Condition, float]] = {
    "weighted": {"with_autonomy": 14.0, "without_autonomy": 48.4},
    "mental": {"with_autonomy": 16.0, "without_autonomy": 62.0},
    "physical": {"with_autonomy": 12.0, "without_autonomy": 58.0},
    "temporal": {"with_autonomy": 16.0, "without_autonomy": 38.0},
    "performance": {"with_autonomy": 8.0, "without_autonomy": 24.0},
    "effort": {"with_autonomy": 18.0, "without_autonomy": 68.0},
    "frustration": {"with_autonomy": 16.0, "without_autonomy": 36.0},
}
"""NASA-TLX by score and condition."""
