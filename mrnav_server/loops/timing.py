"""Rolling latencies and rates: what the dashboard shows and the benchmarks check."""

from collections import deque

import numpy as np

from mrnav_server.core.records import Percentiles


class RollingLatency:
    """Percentiles over the newest values.

    Args:
        keep: How many values count.
    """

    def __init__(self, keep: int = 2000) -> None:
        self._values_ms: deque[float] = deque(maxlen=keep)
        self._cached = Percentiles(0.0, 0.0)
        self._stale = 0

    def add(self, value_s: float) -> None:
        """Count one latency, in seconds."""
        self._values_ms.append(1000.0 * value_s)
        self._stale += 1

    def clear(self) -> None:
        """Forget everything: a new trial begins."""
        self._values_ms.clear()
        self._cached, self._stale = Percentiles(0.0, 0.0), 0

    def percentiles(self) -> Percentiles:
        """Return p50 and p99; recomputed every 50 values, since states are published 60 times a second."""
        if self._values_ms and (self._stale >= 50 or self._cached.p99 == 0.0):
            p50, p99 = np.percentile(np.fromiter(self._values_ms, float), (50, 99))
            self._cached, self._stale = Percentiles(round(float(p50), 3), round(float(p99), 3)), 0
        return self._cached


class Rate:
    """Events per second over a sliding span.

    Args:
        span_s: Length of the span.
    """

    def __init__(self, span_s: float = 2.0) -> None:
        self._span_s = span_s
        self._times_s: deque[float] = deque()

    def add(self, now_s: float) -> None:
        """Count one event."""
        self._times_s.append(now_s)
        self._forget(now_s)

    def hz(self, now_s: float) -> float:
        """Return events per second."""
        self._forget(now_s)
        return round(len(self._times_s) / self._span_s, 1)

    def _forget(self, now_s: float) -> None:
        while self._times_s and self._times_s[0] < now_s - self._span_s:
            self._times_s.popleft()
