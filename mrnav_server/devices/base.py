"""What the control loop asks of hardware. Simulated and real devices satisfy the same two protocols.

Building touches nothing; ``open`` acquires, ``close`` gives back and is safe to call twice.
"""

from typing import Protocol

from mrnav_server.core.frames import StagePoint
from mrnav_server.core.records import Frame, MotionCommand, TipReading


class Manipulator(Protocol):
    """A micromanipulator that takes absolute targets; the newest replaces, none is queued."""

    async def open(self) -> None:
        """Acquire the device and take a first reading; nothing moves.

        Raises:
            DeviceError: If it cannot be acquired, with the remedy.
        """

    async def close(self) -> None:
        """Stop the device and give it back."""

    def tip(self) -> TipReading:
        """Return the newest reading. Never waits.

        Raises:
            DeviceError: If the device has failed.
        """

    def move_to(self, target: StagePoint, speed_um_per_s: float, now_s: float) -> MotionCommand:
        """Go to an absolute target; replaces the one before. Never waits.

        Returns:
            What was really sent, after the driver's own limits.

        Raises:
            DeviceError: If the device has failed, or the target is not finite.
        """

    def stop(self) -> None:
        """Stop all axes now. Waits behind nothing, safe at any time."""

    def warnings(self) -> list[str]:
        """Return what the operator should know of the device though it works, in plain sentences."""


class Camera(Protocol):
    """A camera read by one worker thread."""

    def open(self) -> None:
        """Acquire the camera.

        Raises:
            DeviceError: If it is missing or gives another format than asked for, with the remedy.
        """

    def read(self, timeout_s: float) -> Frame:
        """Wait for the next frame and return it.

        Raises:
            DeviceTimeoutError: If none arrives in time.
            DeviceError: If the camera fails.
        """

    def close(self) -> None:
        """Give the camera back."""
