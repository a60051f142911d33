"""Two stages of Micro-Manager as the rig's manipulator."""

import asyncio
import contextlib
import functools
import math
from collections.abc import Callable

from mrnav_server.core.errors import DeviceError, DeviceTimeoutError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.records import MotionCommand, TipReading
from mrnav_server.devices.micromanager.config import MicroManagerConfig
from mrnav_server.devices.micromanager.shared_core import SharedCore
from mrnav_server.devices.micromanager.worker import StageWorker

_CLOSE_S = 1.0


class MicroManagerManipulator:
    """An XY stage and a Z stage that Micro-Manager drives.

    Micro-Manager's calls block, so one thread makes them all, and two more wait for nothing but a stop, one
    for each stage. Their stop passes through Micro-Manager's lock on the adapter library and usually a serial
    line: it waits for the one call that is under way there. No other process can stop these stages; after the
    death of the server they run to their last target, which is never far ahead.

    A fault stands until the stages were stopped for it and answer again.

    Args:
        config: Labels, axes, travel, rates.
        shared: The core of that configuration.
        clock: Monotonic time in seconds.
    """

    def __init__(self, config: MicroManagerConfig, shared: SharedCore, clock: Callable[[], float]) -> None:
        self._config = config
        self._shared = shared
        self._clock = clock
        self._worker: StageWorker | None = None

    async def open(self) -> None:
        """Load Micro-Manager's configuration, prove that the stages stop, and take first readings.

        Nothing moves, unless the configuration itself has a startup preset or an adapter that homes.

        Raises:
            DeviceError: If a file, adapter or device is missing or fails, with the remedy.
        """
        if self._worker is not None and self._worker.alive:
            raise DeviceError(
                "the Micro-Manager stages are still held since they were opened before: restart the server"
            )
        loop = asyncio.get_running_loop()
        opened: asyncio.Future[None] = loop.create_future()
        self._worker = StageWorker(
            self._config, self._shared, self._clock, functools.partial(_settle, loop, opened)
        )
        try:
            async with asyncio.timeout(self._config.open_timeout_s):
                await opened
        except TimeoutError:
            self._worker.end()
            raise DeviceTimeoutError(
                f"Micro-Manager has not loaded {self._config.config_file} within "
                f"{self._config.open_timeout_s:g} s: check the devices, or raise micromanager.open_timeout_s"
            ) from None
        except BaseException:
            self._worker.end()
            raise

    async def close(self) -> None:
        """Stop the stages and give them back; one that hangs is left to end by itself."""
        if self._worker is not None:
            self._worker.end()
            await asyncio.to_thread(self._worker.join, _CLOSE_S)

    def tip(self) -> TipReading:
        """Return the newest reading, stamped before the stages were asked. Never waits.

        Raises:
            DeviceError: If the stages are not open, failed, were not stopped or are silent.
        """
        return self._opened().tip()

    def move_to(self, target: StagePoint, speed_um_per_s: float, now_s: float) -> MotionCommand:
        """Go to an absolute target within the travel; replaces the one before. Never waits.

        The stages go there at their own speed: what limits the motion is how far ahead the targets are.

        Raises:
            DeviceError: As ``tip``, or if target or speed are not finite.
        """
        worker = self._opened()
        if not (math.isfinite(speed_um_per_s) and speed_um_per_s > 0.0):
            raise DeviceError(f"the Micro-Manager stages refuse a speed of {speed_um_per_s} µm/s")
        return MotionCommand(now_s, worker.put(target), speed_um_per_s)

    def warnings(self) -> list[str]:
        """Return nothing: what fails here fails openly."""
        return []

    def stop(self) -> None:
        """Stop both stages; waits behind nothing, safe at any time, also after a fault."""
        if self._worker is not None:
            self._worker.stop()

    def _opened(self) -> StageWorker:
        if self._worker is None:
            raise DeviceError("the Micro-Manager stages are not open: open them first")
        return self._worker


def _settle(loop: asyncio.AbstractEventLoop, opened: asyncio.Future[None], error: DeviceError | None) -> None:
    """Tell whoever waits for the opening how it went; called in the worker's thread."""

    def settle() -> None:
        if opened.done():
            return
        if error is None:
            opened.set_result(None)
        else:
            opened.set_exception(error)

    # Nobody waits any more once the event loop is closed.
    with contextlib.suppress(RuntimeError):
        loop.call_soon_threadsafe(settle)
