"""One viewer's pictures as H.264."""

import cv2

from mrnav_server.app.openh264 import H264Encoder, OpenH264
from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.records import Frame


class H264Stream:
    """Encodes what one viewer is sent, and nothing else: frames that it misses are missed by its encoder too.

    So whoever is slow sees the newest picture whole, and nobody pays for the key pictures of others.

    Args:
        openh264: The library.
        width_px: Width of the pictures; frames are never enlarged.
    """

    def __init__(self, openh264: OpenH264, width_px: int) -> None:
        self._openh264 = openh264
        self._width_px = width_px
        self._encoder: H264Encoder | None = None
        self._size = (0, 0)

    def encode(self, frame: Frame) -> tuple[bytes, bool]:
        """Return the frame as an Annex B byte stream, and whether it stands by itself."""
        yuv = _i420(frame.image, self._width_px)
        size = yuv.shape[1], yuv.shape[0] * 2 // 3
        if self._encoder is None or size != self._size:
            self.close()
            self._size, self._encoder = size, H264Encoder(self._openh264, *size)
        return self._encoder.encode(yuv, frame.taken_s)

    def close(self) -> None:
        """Give the encoder back."""
        if self._encoder is not None:
            self._encoder.close()
            self._encoder = None


def _i420(image: ByteArray, width_px: int) -> ByteArray:
    """Return a picture shrunk to a width, with even sides, in I420."""
    height, width = image.shape[:2]
    to_width = _even(min(width_px, width))
    size = to_width, _even(height * to_width / width)
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    yuv: ByteArray = cv2.cvtColor(small, cv2.COLOR_BGR2YUV_I420)  # type: ignore[assignment]
    return yuv


def _even(length: float) -> int:
    return max(2, 2 * int(length / 2.0))
