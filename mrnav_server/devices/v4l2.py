"""What a V4L2 camera is asked for through ``cv2.VideoCapture``, and what it makes of it."""

from dataclasses import dataclass
from typing import Protocol

import cv2

from mrnav_server.core.errors import DeviceError
from mrnav_server.core.picture import PictureFormat

_PREFERRED = ("YUYV", "NV12", "MJPG")
"""Raw first: it costs a tenth of decoding a JPEG and has no artefacts; few cameras carry it at full rate."""
_RATE_TOLERANCE_FPS = 0.5
_EXPOSURE_MANUAL, _EXPOSURE_AUTOMATIC = 1, 3
"""V4L2_EXPOSURE_MANUAL and V4L2_EXPOSURE_APERTURE_PRIORITY, the two that UVC cameras have."""
_EXPOSURE_UNITS_PER_MS = 10.0
"""V4L2_CID_EXPOSURE_ABSOLUTE counts 100 µs."""


class Capture(Protocol):
    """An opened ``cv2.VideoCapture``."""

    def set(self, propId: int, value: float) -> bool:  # noqa: N803 - OpenCV's name
        """Ask for a property; tells whether the driver takes it."""

    def get(self, propId: int) -> float:  # noqa: N803 - OpenCV's name
        """Return a property; 0 or less where the driver does not tell."""

    def grab(self) -> bool:
        """Wait for the next picture; False if there is none."""

    def retrieve(self) -> tuple[bool, object]:
        """Decode the picture that was grabbed."""

    def release(self) -> None:
        """Give the camera back."""


@dataclass(frozen=True, slots=True)
class Controls:
    """What is set on a camera beside its format.

    Attributes:
        exposure_ms: Exposure time in ms; 0 leaves it to the camera.
        gain: Gain in the camera's own units; None leaves it to the camera.
    """

    exposure_ms: float = 0.0
    gain: float | None = None


AUTOMATIC = Controls()


@dataclass(frozen=True, slots=True)
class Mode:
    """What a camera is set to.

    Attributes:
        code: Its pixel format, four characters; "" where the driver does not tell.
        width_px: Picture width.
        height_px: Picture height.
        fps: Frames a second that the driver promises; 0 where it does not tell.
    """

    code: str
    width_px: int
    height_px: int
    fps: float

    def __str__(self) -> str:
        rate = f"{self.fps:g} fps" if self.fps > 0.0 else "an untold rate"
        return f"{self.code or 'an untold format'} {self.width_px}×{self.height_px} at {rate}"

    def has_size(self, asked: PictureFormat) -> bool:
        """Whether its pictures have the size that was asked for."""
        return (self.width_px, self.height_px) == (asked.width_px, asked.height_px)


def open_capture(index: int) -> Capture | None:
    """Open a camera through V4L2; None if that fails. OpenCV's own lines on stderr are silenced."""
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    capture = cv2.VideoCapture(index, cv2.CAP_V4L2)
    return capture if capture.isOpened() else None


def choose_mode(capture: Capture, asked: PictureFormat) -> Mode:
    """Set a camera to raw pictures if it promises them at size and rate, else to Motion JPEG.

    A camera that promises size and rate in no format is set to the fastest that has the size.
    """
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    found: dict[str, Mode] = {}
    for code in _PREFERRED:
        mode = found[code] = _set_mode(capture, asked, code)
        if mode.code == code and mode.has_size(asked) and mode.fps >= asked.fps - _RATE_TOLERANCE_FPS:
            return mode
    # Among equals the last one, Motion JPEG: a rate that is not told is kept with less data.
    best = max(reversed(_PREFERRED), key=lambda code: (found[code].has_size(asked), found[code].fps))
    return found[best] if best == _PREFERRED[-1] else _set_mode(capture, asked, best)


def set_controls(capture: Capture, controls: Controls, name: str) -> str:
    """Set exposure and gain; return what the camera made of them, in words, "" if both are its own.

    Args:
        capture: The camera.
        controls: What to set.
        name: The camera's name in messages.

    Raises:
        DeviceError: If the camera does not take one of them.
    """
    told = []
    automatic = controls.exposure_ms == 0.0
    taken = capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _EXPOSURE_AUTOMATIC if automatic else _EXPOSURE_MANUAL)
    if not automatic:
        asked_units = round(_EXPOSURE_UNITS_PER_MS * controls.exposure_ms)
        # Some cameras have no switch for automatic exposure, and take a time all the same.
        if not capture.set(cv2.CAP_PROP_EXPOSURE, asked_units):
            because = "" if taken else ", nor a manual exposure at all"
            raise DeviceError(
                f"{name} does not take camera.exposure_ms = {controls.exposure_ms:g}{because}: choose a time "
                "that it has (`v4l2-ctl --list-ctrls` tells them), or 0 for automatic exposure"
            )
        units = capture.get(cv2.CAP_PROP_EXPOSURE)
        told.append(f"exposure {units / _EXPOSURE_UNITS_PER_MS:g} ms" if units > 0.0 else "exposure untold")
    if controls.gain is not None:
        if not capture.set(cv2.CAP_PROP_GAIN, controls.gain):
            raise DeviceError(
                f"{name} does not take camera.gain = {controls.gain:g}: choose a value that it has "
                "(`v4l2-ctl --list-ctrls` tells them), or leave camera.gain out"
            )
        told.append(f"gain {capture.get(cv2.CAP_PROP_GAIN):g}")
    return ", ".join(told)


def _set_mode(capture: Capture, asked: PictureFormat, code: str) -> Mode:
    capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*code))
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, asked.width_px)
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, asked.height_px)
    capture.set(cv2.CAP_PROP_FPS, asked.fps)
    return Mode(
        _code(capture.get(cv2.CAP_PROP_FOURCC)),
        round(capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
        round(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        max(0.0, capture.get(cv2.CAP_PROP_FPS)),
    )


def _code(number: float) -> str:
    return int(number).to_bytes(4, "little").decode("latin-1").strip() if number > 0.0 else ""
