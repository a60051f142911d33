"""The mean of what has been over a span of time that may change."""

from collections import deque

Values = tuple[float, ...]


class MovingMean:
    """Values at uneven moments, each in force until the next; the first one always was.

    The mean over a span T is a low-pass with zeros at every multiple of 1/T, and delays by T/2.
    """

    def __init__(self) -> None:
        self._past: deque[tuple[float, Values]] = deque()

    def add(self, values: Values, now_s: float) -> None:
        """Take the values that are in force from now on."""
        self._past.append((now_s, values))

    def mean(self, span_s: float, now_s: float) -> Values:
        """Return the mean over the last ``span_s``, which must not grow faster than time passes.

        Raises:
            IndexError: Before the first value.
        """
        since_s = now_s - span_s
        past = self._past
        while len(past) > 1 and past[1][0] <= since_s:
            past.popleft()
        newest = past[-1][1]
        if span_s <= 0.0:
            return newest
        total = [0.0] * len(newest)
        begins_s, until_s = since_s, now_s
        for index, (_, values) in enumerate(past):
            ends_s = past[index + 1][0] if index + 1 < len(past) else until_s
            held_s = max(ends_s - begins_s, 0.0)
            total = [t + held_s * v for t, v in zip(total, values, strict=True)]
            begins_s = max(ends_s, begins_s)
        return tuple(t / span_s for t in total)
