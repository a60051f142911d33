"""The pictures that ``mrnav track`` looks at: a film with its time stamps, or a folder of images in order."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.records import Frame

_IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm", ".webp")
_SMALLEST_PX = 32


@dataclass(frozen=True, slots=True)
class Film:
    """Pictures in order.

    Attributes:
        name: What they are, for people.
        frames: The pictures; numbers count from 0, times are in seconds from the first.
        count: How many there are; None where the film does not say.
    """

    name: str
    frames: Iterator[Frame]
    count: int | None


def open_film(source: Path, fps: float) -> Film:
    """Open a film or a folder of images.

    Args:
        source: A video file that OpenCV reads, or a folder.
        fps: Pictures a second where nothing tells: in a folder, and in a film without time stamps.

    Raises:
        ConfigError: If there is nothing to be read; from ``frames``, if a picture cannot be used.
    """
    if not 0.01 <= fps <= 1e5:
        raise ConfigError(f"--fps is {fps:g}: choose it within 0.01..100000")
    # OpenCV tells of damaged pictures on the error stream; the errors here say what to do.
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    if source.is_dir():
        paths = sorted(
            (path for path in source.iterdir() if path.suffix.lower() in _IMAGES), key=_natural_order
        )
        if not paths:
            raise ConfigError(f"the folder {source} holds no images: put in files {', '.join(_IMAGES)}")
        return Film(f"{len(paths)} images in {source}", _images(paths, fps), len(paths))
    if not source.is_file():
        raise ConfigError(f"{source} does not exist: name a video file or a folder of images")
    # FFmpeg alone: other readers of OpenCV take a name with digits for a series of pictures.
    capture = cv2.VideoCapture(str(source), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise ConfigError(
            f"{source} cannot be read as a film: name an AVI, MP4 or Matroska file, or a folder of images"
        )
    told = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    return Film(str(source), _played(capture, source, fps), told if 0 < told < 1e9 else None)


def _natural_order(path: Path) -> list[tuple[int, str]]:
    """Return a key by which image2 comes before image10."""
    parts = re.split(r"(\d+)", path.name.lower())
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


def _images(paths: list[Path], fps: float) -> Iterator[Frame]:
    size: tuple[int, ...] = ()
    for number, path in enumerate(paths):
        read = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if read is None:
            raise ConfigError(f"{path} is damaged or no picture: repair it, or take it out of the folder")
        image = _usable(np.asarray(read), str(path))
        size = size or image.shape
        if image.shape != size:
            raise ConfigError(
                f"{path} has {image.shape[1]}x{image.shape[0]} px, {paths[0].name} {size[1]}x{size[0]}: one"
                " folder holds pictures of one camera"
            )
        yield Frame(number, number / fps, image)


def _played(capture: cv2.VideoCapture, source: Path, fps: float) -> Iterator[Frame]:
    told_fps = float(capture.get(cv2.CAP_PROP_FPS))
    period_s = 1.0 / (told_fps if 0.01 <= told_fps <= 1e5 else fps)
    number, taken_s, first_s = 0, 0.0, 0.0
    try:
        while capture.grab():
            stamp_s = 1e-3 * float(capture.get(cv2.CAP_PROP_POS_MSEC))
            decoded, read = capture.retrieve()
            if not decoded:
                raise ConfigError(f"{source} is damaged at frame {number}: cut it before, or convert it anew")
            if number == 0:
                first_s = stamp_s
            else:
                # Some films have no stamps.
                since_s = stamp_s - first_s
                taken_s = since_s if since_s > taken_s else taken_s + period_s
            yield Frame(number, taken_s, _usable(np.asarray(read), str(source)))
            number += 1
    finally:
        capture.release()
    if number == 0:
        raise ConfigError(f"{source} holds no picture that can be read: convert it to MP4 or Matroska")


def _usable(image: ByteArray, name: str) -> ByteArray:
    """Return a picture as BGR."""
    height_px, width_px = image.shape[:2]
    if min(height_px, width_px) < _SMALLEST_PX:
        raise ConfigError(
            f"{name} has {width_px}x{height_px} px: no robot is seen in fewer than {_SMALLEST_PX} px"
        )
    if image.ndim == 2 or image.shape[2] == 1:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR).astype(np.uint8, copy=False)
    return image.astype(np.uint8, copy=False)
