"""How long a trial's metrics take: ``python -m benchmarks.metrics``. One thread, made-up trajectories.

Prints one JSON object: the median and the 99th percentile over rounds, in ms, for trials of several lengths.
"""

import json
import math
import time

import numpy as np
from threadpoolctl import threadpool_limits

from mrnav_server.core.metrics import Trial, trial_metrics
from mrnav_server.core.motion import RATE_HZ

ROUNDS = 100
LENGTHS_S = (20.0, 60.0, 600.0)


def made_up(length_s: float) -> Trial:
    """Return a winding path with a tracker's noise and a wall that is touched now and then."""
    rng = np.random.default_rng(1)
    t_s = np.arange(round(length_s * RATE_HZ) + 1) / RATE_HZ
    path_um = np.column_stack([1500.0 * t_s, 2000.0 * np.sin(1.3 * t_s)])
    return Trial(
        t_s=t_s,
        xy_um=path_um + rng.normal(0.0, 3.0, path_um.shape),
        clearance_um=300.0 + 310.0 * np.sin(0.7 * t_s),
        go_s=0.0,
        end_s=length_s,
        reached=True,
        sigma_um=3.0,
        geodesic_um=1400.0 * length_s,
    )


def main() -> None:
    """Print the figures."""
    found: dict[str, dict[str, float]] = {}
    with threadpool_limits(1):
        for length_s in LENGTHS_S:
            trial = made_up(length_s)
            trial_metrics(trial)  # which imports scipy
            took_ms = []
            for _ in range(ROUNDS if length_s < 100 else ROUNDS // 5):
                began_s = time.perf_counter()
                metrics = trial_metrics(trial)
                took_ms.append(1e3 * (time.perf_counter() - began_s))
            assert math.isfinite(metrics.smoothness.value)
            p50, p99 = np.percentile(took_ms, [50, 99])
            found[f"{length_s:.0f}"] = {"p50": round(p50, 3), "p99": round(p99, 3)}
    print(json.dumps({"trial_metrics_ms": found}))


if __name__ == "__main__":
    main()
