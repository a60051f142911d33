"""How much of the exchange with a device is lost on the way. Pure; is told the time."""

from collections import deque

_WINDOW_S = 10.0
_LOSS_LIMIT = 0.05
_AT_LEAST = 3


class LossRate:
    """Share of requests that had to be repeated or were never answered, over the last ten seconds."""

    def __init__(self) -> None:
        self._requests_s: deque[float] = deque()
        self._losses_s: deque[float] = deque()

    def on_request(self, now_s: float) -> None:
        """Count a request."""
        self._requests_s.append(now_s)
        _forget(self._requests_s, now_s)

    def on_loss(self, now_s: float) -> None:
        """Count one that was repeated, or given up."""
        self._losses_s.append(now_s)
        _forget(self._losses_s, now_s)

    def warnings(self, now_s: float) -> list[str]:
        """Return what the operator should know."""
        _forget(self._requests_s, now_s)
        _forget(self._losses_s, now_s)
        lost, asked = len(self._losses_s), len(self._requests_s)
        if lost < _AT_LEAST or lost <= _LOSS_LIMIT * asked:
            return []
        return [
            f"the controller left {lost} of {asked} requests of the last {_WINDOW_S:.0f} s without an answer "
            "in time: check the network cable, and that nothing else uses this network"
        ]


def _forget(times_s: deque[float], now_s: float) -> None:
    while times_s and now_s - times_s[0] > _WINDOW_S:
        times_s.popleft()
