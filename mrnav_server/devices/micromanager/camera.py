"""A camera that Micro-Manager drives, as the rig's camera."""

import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import DeviceError
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Frame
from mrnav_server.devices.grabber import GrabbedCamera
from mrnav_server.devices.micromanager.capture_time import CaptureTime
from mrnav_server.devices.micromanager.config import MicroManagerConfig
from mrnav_server.devices.micromanager.shared_core import (
    CORE_ERRORS,
    Core,
    SharedCore,
    device_label,
    one_line,
)

if TYPE_CHECKING:
    import pymmcore

_CAMERA = 2
"""MMDevice's number of the device type."""
_POLL_S = 0.002
_ELAPSED_MS = "ElapsedTime-ms"


class MicroManagerCamera(GrabbedCamera):
    """A camera in continuous sequence acquisition; the newest picture wins.

    Micro-Manager's configuration is loaded if nobody has. A camera that shares its core with the stage is
    stopped when it is closed, but not unloaded: many adapters find one that was pulled out only when the
    server is started anew.

    Args:
        config: Label and exposure.
        picture: Size that the pictures must have, and the rate that is asked for.
        shared: The core of that configuration.
        clock: Monotonic time in seconds.
    """

    def __init__(
        self,
        config: MicroManagerConfig,
        picture: PictureFormat,
        shared: SharedCore,
        clock: Callable[[], float],
    ) -> None:
        name = f"Micro-Manager camera {config.camera}".rstrip()
        super().__init__(name, config.open_timeout_s, "switch it off and on again")
        self._config = config
        self._asked = picture
        self._shared = shared
        self._clock = clock

    def _frames(self, ending: threading.Event) -> Iterator[Frame]:
        core = self._shared.acquire()
        try:
            yield from self._run(core, ending)
        except CORE_ERRORS as error:
            raise DeviceError(
                f"{self._name} failed: {one_line(error)}: check its power and its cable"
            ) from None
        finally:
            self._shared.release()

    def _run(self, core: Core, ending: threading.Event) -> Iterator[Frame]:
        label = device_label(
            core, self._config.camera, core.getCameraDevice(), _CAMERA, "camera", "micromanager.camera"
        )
        if core.isSequenceRunning(label):
            # It could not be stopped while it was pulled out.
            core.stopSequenceAcquisition(label)
        core.setCameraDevice(label)
        if self._config.exposure_ms > 0.0:
            core.setExposure(label, self._config.exposure_ms)
        times = CaptureTime(1e-3 * core.getExposure(label))
        core.startContinuousSequenceAcquisition(1000.0 / self._asked.fps)
        try:
            yield from self._sequence(core, label, times, ending)
        finally:
            core.stopSequenceAcquisition(label)

    def _sequence(
        self, core: Core, label: str, times: CaptureTime, ending: threading.Event
    ) -> Iterator[Frame]:
        import pymmcore

        metadata = pymmcore.Metadata()
        number = -1
        empty_s = self._clock()
        while not ending.wait(_POLL_S):
            asked_s = self._clock()
            waiting = core.getRemainingImageCount()
            if waiting == 0:
                empty_s = asked_s
                if not core.isSequenceRunning(label):
                    raise DeviceError(f"{self._name} stopped by itself: check its power and its cable")
                continue
            for _ in range(waiting):
                image = core.popNextImageMD(metadata)
            number += waiting
            taken_s = times.taken_s(empty_s, asked_s, _elapsed_s(metadata))
            empty_s = asked_s
            yield Frame(number, taken_s, self._picture(image, core))

    def _picture(self, image: ByteArray, core: Core) -> ByteArray:
        """Return a picture as BGR, shape (height, width, 3), uint8; refuse any other size and kind."""
        height_px, width_px = image.shape[:2]
        asked = self._asked
        if (width_px, height_px) != (asked.width_px, asked.height_px):
            raise DeviceError(
                f"{self._name} gives pictures of {width_px}×{height_px} px; asked for "
                f"{asked.width_px}×{asked.height_px}: set camera.width_px = {width_px} and "
                f"camera.height_px = {height_px}, or its binning and region in Micro-Manager's configuration"
            )
        return to_bgr(image, core.getNumberOfComponents(), core.getImageBitDepth(), self._name)


def _elapsed_s(metadata: "pymmcore.Metadata") -> float | None:
    """Return the time that the adapter gives a picture, in seconds from the start; None without one."""
    if not metadata.HasTag(_ELAPSED_MS):
        return None
    return 1e-3 * float(metadata.GetSingleTag(_ELAPSED_MS).GetValue())


def to_bgr(image: NDArray[np.unsignedinteger], components: int, bit_depth: int, name: str) -> ByteArray:
    """Return Micro-Manager's picture as BGR, shape (height, width, 3), uint8.

    Args:
        image: Shape (height, width): uint8, uint16, or uint32 that holds the bytes B, G, R, unused.
        components: 1 for gray, 4 for colour.
        bit_depth: Bits that a gray pixel uses; its upper 8 are kept.
        name: The camera's name in messages.

    Raises:
        DeviceError: If it is of any other kind.
    """
    if components == 4 and image.dtype == np.uint32:
        return np.ascontiguousarray(image.view(np.uint8).reshape(*image.shape, 4)[..., :3])
    if components == 1 and image.dtype in (np.uint8, np.uint16):
        gray: ByteArray = np.minimum(image >> max(bit_depth - 8, 0), 255).astype(np.uint8, copy=False)
        return cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR).astype(np.uint8, copy=False)
    raise DeviceError(
        f"{name} gives pictures of {components} components in {image.dtype}: set its pixel type to 8 or "
        "16 bit gray, or to 32-bit RGB, in Micro-Manager's configuration"
    )
