"""The noncentral t distribution, which effect sizes and power rest on."""

import math

import numpy as np
from scipy import special, stats

_STEPS = 8000


def noncentral_t_cdf(t: float, df: int, noncentrality: float) -> float:
    """Return P(T ≤ t) for T = (Z + δ)/√(χ²/df), as the mean of Φ(t·s − δ) over s = √(χ²/df).

    An integral of a smooth function, so it also holds far out, where the usual series fail.

    Args:
        t: Where.
        df: Degrees of freedom, at least 1.
        noncentrality: δ.
    """
    spread = stats.chi(df, scale=1.0 / math.sqrt(df))
    s = np.linspace(float(spread.ppf(1e-13)), float(spread.ppf(1.0 - 1e-13)), _STEPS + 1)
    density = spread.pdf(s)
    return float((special.ndtr(t * s - noncentrality) * density).sum() / density.sum())
