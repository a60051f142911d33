"""The simulated manipulator and camera, with faults to order.

Readings and frames carry the world's own time, so they are exact however seldom the world is advanced.
"""

import math
import time
from collections.abc import Callable
from typing import Protocol

import numpy as np

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import DeviceError, DeviceTimeoutError
from mrnav_server.core.frames import StagePoint, VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Frame, MotionCommand, TipReading
from mrnav_server.sim.world import SimConfig, SimulatedWorld, Snapshot


class Renderer(Protocol):
    """Draws what the microscope sees."""

    def __call__(self, robot: VesselPoint | None, tip: StagePoint, /) -> ByteArray:
        """Return the picture, shape (height, width, 3), BGR, uint8; no robot is one that left the floor."""


class SimulatedManipulator:
    """The world's manipulator as a device; use it from the thread that advances the world.

    Args:
        world: The world that it moves in.
    """

    def __init__(self, world: SimulatedWorld) -> None:
        self._world = world
        self._open = False
        self._failed = False
        self._last: TipReading | None = None

    async def open(self) -> None:
        """Acquire the device; nothing moves.

        Raises:
            DeviceError: If it has failed.
        """
        if self._failed:
            raise DeviceError("the simulated manipulator has failed; call recover() on it")
        self._open = True

    async def close(self) -> None:
        """Stop the device and give it back."""
        self.stop()
        self._open = False

    def tip(self) -> TipReading:
        """Return where the tip is, taken at the world's time.

        Raises:
            DeviceError: If the device is not open or has failed.
        """
        self._require_working()
        if self._last is not None:
            return self._last
        return TipReading(self._world.time_s, self._world.tip, self._world.moving)

    def move_to(self, target: StagePoint, speed_um_per_s: float, now_s: float) -> MotionCommand:
        """Go to an absolute target within the travel; replaces the one before.

        Raises:
            DeviceError: If the device is not open or has failed, or target or speed are not finite.
        """
        self._require_working()
        if not all(math.isfinite(v) for v in (target.x_um, target.y_um, target.z_um, speed_um_per_s)):
            raise DeviceError(f"the manipulator refuses {target} at {speed_um_per_s} µm/s: not finite")
        if self._last is not None:
            return MotionCommand(now_s, target, speed_um_per_s)
        return MotionCommand(now_s, *self._world.set_target(target, speed_um_per_s))

    def stop(self) -> None:
        """Stop all axes now, even after a failure, unless the line is mute."""
        if self._last is None:
            self._world.stop()

    def warnings(self) -> list[str]:
        """Return nothing: what fails here fails openly."""
        return []

    def fail(self) -> None:
        """Simulate a device that reports a failure: readings and moves raise; ``stop`` still works."""
        self._failed = True

    def mute(self) -> None:
        """Simulate a cut line: the last reading stays and ages, commands are lost, the last target holds."""
        self._last = self.tip()

    def recover(self) -> None:
        """End the fault that was simulated."""
        self._failed = False
        self._last = None

    def _require_working(self) -> None:
        if self._failed:
            raise DeviceError("the simulated manipulator has failed; call recover() on it")
        if not self._open:
            raise DeviceError("the simulated manipulator is not open; open it first")


class SimulatedCamera:
    """A camera on an absolute frame schedule; a slot that is missed leaves a gap in the numbers.

    Args:
        config: Latency.
        picture: Frame rate.
        snapshot: Where the newest state of the world comes from.
        render: Draws the picture.
        clock: Monotonic time in seconds, the one that the world's time was put on.
        sleep: Waits for a time in seconds.
    """

    def __init__(
        self,
        config: SimConfig,
        picture: PictureFormat,
        snapshot: Callable[[], Snapshot],
        render: Renderer,
        clock: Callable[[], float],
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._period_s = 1.0 / picture.fps
        self._latency_s = config.camera_latency_ms * 1e-3
        self._snapshot = snapshot
        self._render = render
        self._clock = clock
        self._sleep = sleep
        self._first_s: float | None = None
        self._next = 0
        self._unplugged = False
        self._black = False
        self._frozen: ByteArray | None = None
        self._extra_s = 0.0

    def open(self) -> None:
        """Start the schedule: frame 0 is due now.

        Raises:
            DeviceError: If the camera is unplugged.
        """
        self._require_plugged()
        self._first_s, self._next = self._clock(), 0

    def read(self, timeout_s: float) -> Frame:
        """Wait for the next frame that is due; draw the world as it is then.

        Raises:
            DeviceTimeoutError: If none is delivered in time.
            DeviceError: If the camera is not open or is unplugged.
        """
        self._require_plugged()
        if self._first_s is None:
            raise DeviceError("the simulated camera is not open; open it first")
        asked_s = self._clock()
        number = max(self._next, math.floor((asked_s - self._first_s) / self._period_s + 1e-6))
        due_s = self._first_s + number * self._period_s
        delivery_s = max(due_s, asked_s) + self._latency_s + self._extra_s
        if delivery_s - asked_s > timeout_s:
            self._sleep(timeout_s)
            raise DeviceTimeoutError(f"no frame from the simulated camera within {timeout_s:g} s")
        self._wait_until(due_s)
        self._require_plugged()
        seen = self._snapshot()
        image = self._picture(seen)
        self._next = number + 1
        self._wait_until(delivery_s)
        return Frame(number, seen.time_s, image)

    def close(self) -> None:
        """Give the camera back."""
        self._first_s = None

    def freeze(self) -> None:
        """Simulate a stuck sensor: new frames, the picture of now."""
        self._frozen = self._picture(self._snapshot())

    def black_out(self) -> None:
        """Simulate a lamp that went out: black frames."""
        self._black = True

    def unplug(self) -> None:
        """Simulate a pulled cable: opening and reading raise."""
        self._unplugged = True

    def slow_down(self, extra_s: float) -> None:
        """Simulate a busy bus: every frame arrives later by ``extra_s``."""
        self._extra_s = extra_s

    def recover(self) -> None:
        """End the faults that were simulated."""
        self._unplugged = self._black = False
        self._frozen = None
        self._extra_s = 0.0

    def _picture(self, seen: Snapshot) -> ByteArray:
        if self._frozen is not None:
            return self._frozen
        image = self._render(None if seen.lifted else seen.robot, seen.magnet)
        return np.zeros_like(image) if self._black else image

    def _wait_until(self, when_s: float) -> None:
        left_s = when_s - self._clock()
        if left_s > 0.0:
            self._sleep(left_s)

    def _require_plugged(self) -> None:
        if self._unplugged:
            raise DeviceError("the simulated camera is unplugged; plug it in and reopen it")
