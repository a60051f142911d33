"""Does what a calibration asks for, with a manipulator and a camera; a thin shell that waits."""

import asyncio
from collections.abc import Awaitable, Callable

from mrnav_server.core.errors import DeviceTimeoutError, RefusedError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.limits import Limits
from mrnav_server.devices.base import Camera, Manipulator
from mrnav_server.vision.calibration_plan import Answer, MoveTip, Pictures, Prepare, Step, TakePictures

ARRIVED_UM = 2.0
"""A tip this near to its target has arrived."""
_POLL_S = 0.02
_SPARE_S = 5.0
"""Time that a move may take longer than its speed says."""
_FRAME_TIMEOUT_S = 2.0
_OLD_FRAMES = 2
"""Frames dropped before pictures count: they may have been taken before the bench came to rest."""


class CalibrationHost:
    """Moves the tip and takes pictures; a person or a simulated one prepares the bench.

    Args:
        manipulator: Open.
        camera: Open.
        limits: The manipulator's travel, which no move leaves.
        prepare: Has the bench prepared and returns when it is.
        clock: Monotonic time in seconds.
        sleep: Lets a time in seconds pass.
    """

    def __init__(
        self,
        manipulator: Manipulator,
        camera: Camera,
        limits: Limits,
        prepare: Callable[[Prepare], Awaitable[None]],
        clock: Callable[[], float],
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self._manipulator = manipulator
        self._camera = camera
        self._limits = limits
        self._prepare = prepare
        self._clock = clock
        self._sleep = sleep

    async def perform(self, step: Step) -> Answer:
        """Do a step and return its answer.

        Raises:
            RefusedError: If a move would leave the manipulator's travel.
            DeviceError: If a device fails, or the tip does not arrive.
        """
        match step:
            case Prepare():
                await self._prepare(step)
                return None
            case MoveTip():
                here, target = self._manipulator.tip().position, step.target
                if target.z_um > here.z_um:
                    # Up before across: nothing is known of what stands between the two.
                    above = StagePoint(here.x_um, here.y_um, target.z_um)
                    await self._move(above, step.speed_um_per_s)
                await self._move(target, step.speed_um_per_s)
                return None
            case TakePictures():
                await self._sleep(step.settle_s)
                return await self._take(step.count)
            case _:
                raise TypeError(f"no such step: {step}")

    async def _move(self, target: StagePoint, speed_um_per_s: float) -> None:
        low, high = self._limits.workspace_min_um, self._limits.workspace_max_um
        if any(not a <= v <= b for a, v, b in zip(low, target.array(), high, strict=True)):
            raise RefusedError(
                "out_of_travel",
                f"the tip would go to ({target.x_um:.0f}, {target.y_um:.0f}, {target.z_um:.0f}) µm, outside"
                " its travel: change the calibration's raster and heights",
            )
        away_um = _distance_um(self._manipulator.tip().position, target)
        self._manipulator.move_to(target, speed_um_per_s, self._clock())
        deadline_s = self._clock() + 1.5 * away_um / speed_um_per_s + _SPARE_S
        while True:
            await self._sleep(_POLL_S)
            reading = self._manipulator.tip()
            left_um = _distance_um(reading.position, target)
            if left_um <= ARRIVED_UM and not reading.moving:
                return
            if self._clock() > deadline_s:
                self._manipulator.stop()
                raise DeviceTimeoutError(f"the tip did not arrive: it is {left_um:.0f} µm from its target")

    async def _take(self, count: int) -> Pictures:
        frames = [
            await asyncio.to_thread(self._camera.read, _FRAME_TIMEOUT_S) for _ in range(count + _OLD_FRAMES)
        ]
        return Pictures(tuple(frames[_OLD_FRAMES:]), self._manipulator.tip().position)


def _distance_um(a: StagePoint, b: StagePoint) -> float:
    return float(((a.array() - b.array()) ** 2).sum() ** 0.5)
