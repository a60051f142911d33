"""The thread that owns the stages from loading to unloading."""

import logging
import threading
from collections.abc import Callable

from mrnav_server.core.errors import DeviceError, DeviceTimeoutError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.records import TipReading
from mrnav_server.devices.micromanager.config import MicroManagerConfig
from mrnav_server.devices.micromanager.shared_core import Core, SharedCore
from mrnav_server.devices.micromanager.stages import Stages
from mrnav_server.devices.micromanager.stop_line import StopLine

_TRIAL_READS = 5
_SLOW_READ_S = 1.0 / 30.0
_LONGEST_READ_S = 0.1
_STOP_S = 0.5
_log = logging.getLogger(__name__)


class StageWorker:
    """Sends the newest target and reads the position, in a thread of its own; starts at once, ends for good.

    Args:
        config: Labels, axes, travel, rates.
        shared: Where the core comes from.
        clock: Monotonic time in seconds.
        on_open: Called in the thread, once: with None when the stages work, else with what is wrong.
    """

    def __init__(
        self,
        config: MicroManagerConfig,
        shared: SharedCore,
        clock: Callable[[], float],
        on_open: Callable[[DeviceError | None], None],
    ) -> None:
        self._config = config
        self._shared = shared
        self._clock = clock
        self._on_open = on_open
        self._timeout_s = 1e-3 * config.timeout_ms
        self._ending = threading.Event()
        self._wake = threading.Event()
        self._target: StagePoint | None = None
        self._sent: StagePoint | None = None
        self._stop_seen = self._sent_after = object()
        self._stages: Stages | None = None
        self._lines: tuple[StopLine, ...] = ()
        self._tip: TipReading | None = None
        self._fault = ""
        self._fault_stop: object | None = None
        self._called_s: float | None = None
        # A daemon: an adapter that never returns must not keep the process alive either.
        self._thread = threading.Thread(target=self._run, name="Micro-Manager stages", daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread still holds the stages."""
        return self._thread.is_alive()

    def tip(self) -> TipReading:
        """Return the newest reading.

        Raises:
            DeviceError: If the stages are not open, failed, were not stopped or are silent.
        """
        return self._working()[1]

    def put(self, target: StagePoint) -> StagePoint:
        """Replace the target; return it as it will be sent, within the travel.

        Raises:
            DeviceError: As ``tip``, or if the target is not finite.
        """
        target = self._working()[0].limited(target)
        self._target = target
        self._wake.set()
        return target

    def stop(self) -> None:
        """Forget the target and stop both stages; any thread may."""
        self._target = None
        self._stop_seen = object()
        for line in self._lines:
            line.stop()

    def end(self) -> None:
        """Have the stages stopped and given back."""
        self.stop()
        self._ending.set()
        self._wake.set()

    def join(self, timeout_s: float) -> bool:
        """Wait for the thread; return whether it has ended in time."""
        self._thread.join(timeout_s)
        return not self.alive

    def _working(self) -> tuple[Stages, TipReading]:
        if self._stages is None or self._tip is None or self._ending.is_set():
            raise DeviceError("the Micro-Manager stages are not open: open them first")
        for line in self._lines:
            line.check()
        if self._fault:
            raise DeviceError(self._fault)
        called_s = self._called_s
        silent_s = 0.0 if called_s is None else self._clock() - called_s
        if silent_s > self._timeout_s:
            raise DeviceTimeoutError(
                f"the Micro-Manager stages have been silent for {1000 * silent_s:.0f} ms: "
                "check their power and cables"
            )
        return self._stages, self._tip

    def _run(self) -> None:
        try:
            core = self._shared.acquire()
        except DeviceError as error:
            self._on_open(error)
            return
        try:
            stages = self._open(core)
            self._on_open(None)
            self._serve(stages)
        except DeviceError as error:
            self._on_open(error)
        finally:
            self._ending.set()
            if self._end_lines():
                self._shared.release()
            else:
                _log.error("a Micro-Manager stage hangs while it is stopped: its adapter stays loaded")

    def _open(self, core: Core) -> Stages:
        """Return the stages once they have shown that they stop and answer; nothing moves.

        Raises:
            DeviceError: If they do not.
        """
        stages = Stages(core, self._config, self._clock)
        stages.prove_stop()
        stages.set_speed()
        began_s = self._clock()
        for _ in range(_TRIAL_READS):
            self._tip = stages.read()
        read_s = (self._clock() - began_s) / _TRIAL_READS
        slow = f"reading the stages {stages.xy} and {stages.z} takes {1000 * read_s:.0f} ms"
        if read_s > _LONGEST_READ_S:
            raise DeviceError(f"{slow}, too long to steer by: raise the serial line's baud rate")
        if read_s > _SLOW_READ_S:
            _log.warning("%s: fewer than 30 positions a second", slow)
        self._lines = tuple(
            StopLine(core, label, self._clock, self._timeout_s) for label in (stages.xy, stages.z)
        )
        self._stages = stages
        return stages

    def _serve(self, stages: Stages) -> None:
        period_s = 1.0 / self._config.poll_hz
        due_s = self._clock()
        while not self._ending.is_set():
            self._wake.wait(max(due_s - self._clock(), 0.0))
            self._wake.clear()
            self._called_s = self._clock()
            try:
                self._send(stages)
                if self._clock() >= due_s:
                    due_s = self._clock() + period_s
                    self._tip = stages.read()
                    self._forgive()
            except DeviceError as error:
                if not self._fault:
                    self._fault_stop = self._stop_seen
                self._fault = str(error)
            finally:
                self._called_s = None

    def _send(self, stages: Stages) -> None:
        # In this order: a target that was there before the stop must not look as if it came after it.
        seen = self._stop_seen
        target = self._target
        # One that came after a stop waits until that is through: the next reading comes soon enough.
        if target is None or target is self._sent or any(line.pending for line in self._lines):
            return
        if seen is not self._sent_after:
            self._sent_after = seen
            stages.forget()
        taken = True
        try:
            taken = stages.send(target, lambda: self._stop_seen is seen)
        finally:
            if self._stop_seen is not seen:
                # The stop may have reached the stage just before this target: it has the last word.
                for line in self._lines:
                    line.stop()
            elif taken:
                self._sent = target

    def _forgive(self) -> None:
        """Forget a fault once the stages were stopped for it and answer again."""
        if self._fault and self._stop_seen is not self._fault_stop:
            self._fault = ""

    def _end_lines(self) -> bool:
        """Let the stop lines finish and end them; return whether none hangs."""
        until_s = self._clock() + _STOP_S
        while any(line.pending for line in self._lines) and self._clock() < until_s:
            self._wake.clear()
            self._wake.wait(0.005)
        return not [line for line in self._lines if not line.end(_STOP_S)]
