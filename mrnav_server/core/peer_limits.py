"""How much of a peer is listened to. Time is passed in."""

from collections import deque


class TokenBucket:
    """A rate limit that forgives bursts.

    Args:
        rate_per_s: Lines a second in the long run.
        burst: Lines at once after a pause.
    """

    def __init__(self, rate_per_s: float, burst: float) -> None:
        self._rate_per_s = rate_per_s
        self._burst = burst
        self._tokens = burst
        self._filled_s: float | None = None

    def take(self, now_s: float) -> bool:
        """Tell whether one more line may pass now."""
        if self._filled_s is not None:
            self._tokens = min(self._burst, self._tokens + self._rate_per_s * (now_s - self._filled_s))
        self._filled_s = now_s
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True


class Strikes:
    """Notices when something happens too often.

    Args:
        limit: How many times within the span are too many.
        within_s: The span, in seconds.
    """

    def __init__(self, limit: int = 3, within_s: float = 1.0) -> None:
        self._within_s = within_s
        self._times_s: deque[float] = deque(maxlen=limit)

    def strike(self, now_s: float) -> bool:
        """Note one more; tell whether the limit is reached, and then start anew."""
        self._times_s.append(now_s)
        if len(self._times_s) < (self._times_s.maxlen or 0) or now_s - self._times_s[0] > self._within_s:
            return False
        self._times_s.clear()
        return True
