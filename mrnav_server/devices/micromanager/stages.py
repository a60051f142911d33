"""An XY stage and a Z stage of Micro-Manager as one manipulator: blocking calls, for one worker thread."""

import math
from collections.abc import Callable

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.records import TipReading
from mrnav_server.devices.micromanager.config import MicroManagerConfig
from mrnav_server.devices.micromanager.shared_core import CORE_ERRORS, Core, device_label, one_line

_Z_STAGE, _XY_STAGE = 5, 6
"""MMDevice's numbers of the device types."""


class Stages:
    """The two stages of a loaded core.

    Args:
        core: Loaded.
        config: Labels, axes, travel and speed.
        clock: Monotonic time in seconds.

    Raises:
        DeviceError: If the configuration does not have them.
    """

    def __init__(self, core: Core, config: MicroManagerConfig, clock: Callable[[], float]) -> None:
        self._core = core
        self._config = config
        self._clock = clock
        self.xy = device_label(
            core, config.xy_stage, core.getXYStageDevice(), _XY_STAGE, "XY stage", "micromanager.xy_stage"
        )
        self.z = device_label(
            core, config.z_stage, core.getFocusDevice(), _Z_STAGE, "Z stage", "micromanager.z_stage"
        )
        self._sent_xy: tuple[float, float] | None = None
        self._sent_z: float | None = None

    def prove_stop(self) -> None:
        """Stop both stages, which rest: a stage that cannot be stopped must not be used.

        Raises:
            DeviceError: If one cannot be stopped.
        """
        for label in (self.xy, self.z):
            try:
                self._core.stop(label)
            except CORE_ERRORS as error:
                raise DeviceError(
                    f"the stage {label} cannot be stopped through Micro-Manager ({one_line(error)}): take a "
                    "stage whose adapter supports it"
                ) from None

    def set_speed(self) -> None:
        """Set the speed properties that the settings name.

        Raises:
            DeviceError: If a stage does not have that property or refuses the value.
        """
        config = self._config
        value = f"{config.speed_um_per_s / config.speed_unit_um_per_s:g}"
        for label, names, setting in (
            (self.xy, config.xy_speed_properties, "xy_speed_properties"),
            (self.z, config.z_speed_properties, "z_speed_properties"),
        ):
            there = self._core.getDevicePropertyNames(label)
            for name in names:
                if name not in there:
                    raise DeviceError(
                        f"the stage {label} has no property {name}: choose micromanager.{setting} from "
                        f"{', '.join(there)}"
                    )
                try:
                    self._core.setProperty(label, name, value)
                except CORE_ERRORS as error:
                    raise DeviceError(
                        f"the stage {label} refuses {name} = {value} ({one_line(error)}): check "
                        "micromanager.speed_um_per_s and speed_unit_um_per_s"
                    ) from None

    def read(self) -> TipReading:
        """Return where the stages are, stamped before the first of them was asked.

        Raises:
            DeviceError: If a stage fails or reports what is not finite.
        """
        taken_s = self._clock()
        try:
            x, y = self._core.getXYPosition(self.xy)
            z = self._core.getPosition(self.z)
            moving = self._core.deviceBusy(self.xy) or self._core.deviceBusy(self.z)
        except CORE_ERRORS as error:
            raise _failure(error) from None
        if not all(map(math.isfinite, (x, y, z))):
            raise DeviceError(f"the stages {self.xy} and {self.z} report ({x}, {y}, {z}): restart them")
        return TipReading(taken_s, self._to_frame(x, y, z), moving)

    def limited(self, target: StagePoint) -> StagePoint:
        """Return the nearest point of the travel.

        Raises:
            DeviceError: If the target is not finite.
        """
        wanted = (target.x_um, target.y_um, target.z_um)
        # Before clamping: ``max(low, min(high, nan))`` is ``high``.
        if not all(map(math.isfinite, wanted)):
            raise DeviceError(f"the stages {self.xy} and {self.z} refuse {target}: not finite")
        bounds = zip(wanted, self._config.travel_min_um, self._config.travel_max_um, strict=True)
        return StagePoint(*(min(max(value, low), high) for value, low, high in bounds))

    def send(self, target: StagePoint, going_on: Callable[[], bool]) -> bool:
        """Begin to go to an absolute target; a stage whose part of it did not change is left alone.

        Args:
            target: Within the travel.
            going_on: Asked before each stage is told; False ends it there.

        Returns:
            Whether both stages took it. Some adapters take no target while their stage moves: False then, so
            that the newest target is tried again.

        Raises:
            DeviceError: If a stage at rest refuses it.
        """
        x, y, z = self._to_device(target)
        taken = True
        if going_on() and (x, y) != self._sent_xy:
            if self._takes(self.xy, lambda: self._core.setXYPosition(self.xy, x, y)):
                self._sent_xy = (x, y)
            else:
                taken = False
        if going_on() and z != self._sent_z:
            if self._takes(self.z, lambda: self._core.setPosition(self.z, z)):
                self._sent_z = z
            else:
                taken = False
        return taken

    def forget(self) -> None:
        """After a stop: the stages are not on the way to what was sent last."""
        self._sent_xy = self._sent_z = None

    def _takes(self, label: str, order: Callable[[], None]) -> bool:
        try:
            order()
        except CORE_ERRORS as refusal:
            try:
                if self._core.deviceBusy(label):
                    return False
            except CORE_ERRORS as error:
                raise _failure(error) from None
            raise _failure(refusal) from None
        return True

    def _to_frame(self, x: float, y: float, z: float) -> StagePoint:
        axes = zip((x, y, z), self._config.scale_xyz, self._config.offset_um, strict=True)
        return StagePoint(*(scale * value + offset for value, scale, offset in axes))

    def _to_device(self, point: StagePoint) -> tuple[float, float, float]:
        scale, offset = self._config.scale_xyz, self._config.offset_um
        return (
            (point.x_um - offset[0]) / scale[0],
            (point.y_um - offset[1]) / scale[1],
            (point.z_um - offset[2]) / scale[2],
        )


def _failure(error: Exception) -> DeviceError:
    return DeviceError(f"Micro-Manager: {one_line(error)}: check the stage's power, cable and travel limits")
