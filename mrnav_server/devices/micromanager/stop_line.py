"""A thread that does nothing but stop one stage."""

import threading
from collections.abc import Callable

from mrnav_server.core.errors import DeviceError
from mrnav_server.devices.micromanager.shared_core import CORE_ERRORS, Core, one_line

_REPEAT_S = 0.03
_REST_S = 1.0


class StopLine:
    """Stops one stage whenever it is asked to, again and again until the stage rests.

    Waits behind no other order; inside Micro-Manager it waits for the call into the same adapter library that
    runs at that moment, and for no more than that.

    Args:
        core: Loaded.
        label: The stage.
        clock: Monotonic time in seconds.
        timeout_s: How long a call may take.
    """

    def __init__(self, core: Core, label: str, clock: Callable[[], float], timeout_s: float) -> None:
        self._core = core
        self._label = label
        self._clock = clock
        self._timeout_s = timeout_s
        self._asked = threading.Event()
        self._stopping = False
        self._ending = threading.Event()
        self._began_s = 0.0
        self._called_s: float | None = None
        self._refusal = ""
        self._thread = threading.Thread(target=self._run, name=f"stop {label}", daemon=True)
        self._thread.start()

    @property
    def pending(self) -> bool:
        """Whether the stage was asked to stop and is not known to rest since."""
        return self._asked.is_set() or self._stopping

    def stop(self) -> None:
        """Ask for a stop. Never waits; any thread may."""
        self._asked.set()

    def check(self) -> None:
        """Raise if the stage could not be stopped.

        Raises:
            DeviceError: If the stop was refused, hangs, or the stage goes on moving.
        """
        if self._refusal:
            raise DeviceError(self._refusal)
        called_s = self._called_s
        if called_s is not None and self._clock() - called_s > self._timeout_s:
            raise DeviceError(f"Micro-Manager does not come back from stopping {self._label}: {_SWITCH}")

    def end(self, timeout_s: float) -> bool:
        """End the thread; return whether it has ended in time."""
        self._ending.set()
        self._asked.set()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while True:
            self._asked.wait()
            # In this order: whoever looks at ``pending`` in between must not see False.
            self._stopping = True
            self._asked.clear()
            self._began_s = self._clock()
            while not self._rests():
                if self._ending.wait(_REPEAT_S):
                    break
            if self._ending.is_set():
                return
            self._stopping = False

    def _rests(self) -> bool:
        """Stop once; return whether the stage took it and rests."""
        self._called_s = self._clock()
        try:
            self._core.stop(self._label)
            busy = self._core.deviceBusy(self._label)
        except CORE_ERRORS as error:
            self._refusal = f"the stage {self._label} was not stopped ({one_line(error)}): {_SWITCH}"
            return False
        finally:
            self._called_s = None
        late = busy and self._clock() - self._began_s > _REST_S
        self._refusal = f"the stage {self._label} moves on after it was stopped: {_SWITCH}" if late else ""
        return not busy


_SWITCH = "switch its controller off"
