"""The twin stream as a console sees it: it keeps the lease alive and waits for what should happen."""

from collections.abc import Callable

from mrnav_server.client.errors import ConnectionEndedError
from mrnav_server.client.twin import Message, Twin
from mrnav_server.client.waiting import REAL, Waiting
from mrnav_server.core.errors import MrnavError

State = Message
_TAKE_S = 0.2


class TrialFailedError(MrnavError):
    """The trial cannot go on. Reaction: it counts as not completed, for the reason given."""


class TwinConsole(Twin):
    """A twin whose states are waited for.

    Args:
        url: The server's web address.
        token: An operator's token.
        alive: Asked often; raises if a process that the trial needs has ended.
        waiting: How it waits.

    Attributes:
        modes: Every mode that was shown, in order, repeats left out.
    """

    def __init__(self, url: str, token: str, alive: Callable[[], None], waiting: Waiting = REAL) -> None:
        super().__init__(url, token, heartbeat=True, waiting=waiting)
        self._alive = alive
        self.modes: list[str] = []
        self._watchers: list[Callable[[State], None]] = []
        self._mode_watchers: list[Callable[[State], None]] = []

    def watch(self, watcher: Callable[[State], None]) -> None:
        """Have a function called with every state from now on."""
        self._watchers.append(watcher)

    def watch_modes(self, watcher: Callable[[State], None]) -> None:
        """Have a function called with the first state of every new mode from now on."""
        self._mode_watchers.append(watcher)

    def until(self, condition: Callable[[State], bool], timeout_s: float, what: str) -> State:
        """Take messages until a state satisfies a condition; return that state.

        Raises:
            TrialFailedError: If it takes too long, or the connection ends.
        """
        deadline_s = self.waiting.now_s() + timeout_s
        while not (self.state and condition(self.state)):
            if self.waiting.now_s() > deadline_s:
                reason = self.state.get("reason") or self.state.get("auto_refusal") or "no reason given"
                raise TrialFailedError(f"{what}: not within {timeout_s:g} s ({reason})")
            self._look()
        return self.state

    def wait(self, duration_s: float) -> None:
        """Take messages for a while."""
        end_s = self.waiting.now_s() + duration_s
        while self.waiting.now_s() < end_s:
            self._look()

    def _look(self) -> None:
        self._alive()
        try:
            message = self.take(_TAKE_S)
        except ConnectionEndedError as error:
            raise TrialFailedError(str(error)) from None
        if message is None or message["type"] != "state":
            return
        if not self.modes or self.modes[-1] != message["mode"]:
            self.modes.append(message["mode"])
            for tell in self._mode_watchers:
                tell(message)
        for watcher in self._watchers:
            watcher(message)
