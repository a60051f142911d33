"""Shapiro–Wilk, with an answer where the data allow none."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats

from mrnav_server.core.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Normality:
    """Shapiro–Wilk's test.

    Attributes:
        w, p: NaN if it cannot be done.
        note: Why not; "" if it was done.
    """

    w: float
    p: float
    note: str = ""


def shapiro(values: FloatArray) -> Normality:
    """Test values for normality.

    Fewer than three values, and values that are all the same, tell nothing about normality: the p of 1 that
    the test gives on constants would let them pass.

    Args:
        values: Shape (n,), finite.
    """
    if values.size < 3:
        return Normality(math.nan, math.nan, "fewer than 3 values")
    if not np.ptp(values) > 1e-12 * float(np.abs(values).max()):
        return Normality(math.nan, math.nan, "all values are the same")
    found = stats.shapiro(values)
    return Normality(float(found.statistic), float(found.pvalue))
