"""What every camera's pictures must be, and how fast they really come."""

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import DeviceError
from mrnav_server.core.picture import PictureFormat

RATE_TOLERANCE = 0.1
"""A rate is another one when it differs by more than this share."""
_SETTLING_FRAMES = 5
FRAMES_TO_MEASURE = 25
"""So many frames after opening, the rate is known."""


def to_bgr(image: ByteArray, asked: PictureFormat, name: str) -> ByteArray:
    """Return a picture as BGR, shape (height, width, 3), uint8.

    Args:
        image: Shape (height, width), (height, width, 1) or (height, width, 3).
        asked: The size that it must have.
        name: The camera's name in messages.

    Raises:
        DeviceError: If it is of any other size or kind, with the remedy.
    """
    height_px, width_px = image.shape[:2]
    if (width_px, height_px) != (asked.width_px, asked.height_px):
        raise DeviceError(
            f"{name} gives pictures of {width_px}×{height_px} px; asked for "
            f"{asked.width_px}×{asked.height_px}: set camera.width_px = {width_px} and "
            f"camera.height_px = {height_px}, or take a camera that has this size"
        )
    channels = 1 if image.ndim == 2 else image.shape[2]
    if image.dtype != np.uint8 or channels not in (1, 3):
        kind = f"{channels} channels of {image.dtype}"
        raise DeviceError(f"{name} gives pictures of {kind}: take one that gives 8-bit gray or colour")
    if channels == 1:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR).astype(np.uint8, copy=False)
    return image


def is_another_rate(fps: float, asked: PictureFormat) -> bool:
    """Whether a rate in frames a second is not the one that was asked for; 0 or less is unknown."""
    return fps > 0.0 and abs(fps - asked.fps) > RATE_TOLERANCE * asked.fps


class RateMeter:
    """Measures a camera's rate over its first frames, once the very first ones are past."""

    def __init__(self) -> None:
        self._frames = 0
        self._first_s = 0.0

    def add(self, taken_s: float) -> float | None:
        """Note a frame's capture time; with the one that completes it, return the rate in fps."""
        self._frames += 1
        if self._frames == _SETTLING_FRAMES:
            self._first_s = taken_s
        if self._frames != FRAMES_TO_MEASURE:
            return None
        span_s = taken_s - self._first_s
        return (FRAMES_TO_MEASURE - _SETTLING_FRAMES) / span_s if span_s > 0.0 else None
