"""A ``CMMCore`` with one XY stage and one Z stage that do what the test tells them."""

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

WAIT_S = 30.0
"""How long something that surely comes is waited for."""


def leaked() -> list[str]:
    """Return the device threads that do not end."""
    threads = [t for t in threading.enumerate() if t.name.startswith(("Micro-Manager", "stop "))]
    for thread in threads:
        thread.join(WAIT_S)
    return [thread.name for thread in threads if thread.is_alive()]


class OffsetClock:
    """Real time, and what the test adds to it."""

    def __init__(self) -> None:
        self.ahead_s = 0.0

    def __call__(self) -> float:
        return time.monotonic() + self.ahead_s


class FakeCore:
    """Jumps to every target; every call is noted, may be held and may fail."""

    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []
        self.xy_um = (100.0, 200.0)
        self.z_um = 300.0
        self.busy: dict[str, int] = {}
        self.fails: dict[str, str] = {}
        self.on_call: Callable[[str], None] = lambda name: None
        self.properties: tuple[str, ...] = ("Speed",)
        self.unloaded = 0
        self._held: dict[str, threading.Event] = {}

    def hold(self, name: str) -> threading.Event:
        """Hold calls of that name until the event that is returned is set."""
        self._held[name] = threading.Event()
        return self._held[name]

    def sent(self) -> list[tuple[Any, ...]]:
        """Return the calls that move or stop, without those of opening."""
        return [call for call in self.calls if call[0] in ("setXYPosition", "setPosition", "stop")][2:]

    def _note(self, name: str, *arguments: object) -> None:
        self.calls.append((name, *arguments))
        self.on_call(name)
        if name in self._held:
            assert self._held[name].wait(WAIT_S)
        if name in self.fails:
            raise RuntimeError(self.fails[name])

    def getLoadedDevicesOfType(self, devType: int, /) -> Sequence[str]:
        return {5: ("Z", "Piezo"), 6: ("XY",)}.get(devType, ())

    def getXYStageDevice(self) -> str:
        return "XY"

    def getFocusDevice(self) -> str:
        return "Z"

    def getXYPosition(self, label: str, /) -> Sequence[float]:
        self._note("getXYPosition", label)
        return list(self.xy_um)

    def getPosition(self, label: str, /) -> float:
        self._note("getPosition", label)
        return self.z_um

    def setXYPosition(self, label: str, x: float, y: float, /) -> None:
        self._note("setXYPosition", label, x, y)
        self.xy_um = (x, y)

    def setPosition(self, label: str, z: float, /) -> None:
        self._note("setPosition", label, z)
        self.z_um = z

    def deviceBusy(self, label: str, /) -> bool:
        self._note("deviceBusy", label)
        return self.busy.get(label, 0) > 0

    def stop(self, label: str, /) -> None:
        self._note("stop", label)
        self.busy[label] = self.busy.get(label, 0) - 1

    def getDevicePropertyNames(self, label: str, /) -> Sequence[str]:
        return self.properties

    def setProperty(self, label: str, name: str, value: str, /) -> None:
        self._note("setProperty", label, name, value)

    def unloadAllDevices(self) -> None:
        self.unloaded += 1
