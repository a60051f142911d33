"""Reads films: as OpenCV plays them, and element by element as RFC 8794 lays them out."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray

MASTERS = {
    0x1A45DFA3: "EBML",
    0x18538067: "Segment",
    0x114D9B74: "SeekHead",
    0x4DBB: "Seek",
    0x1549A966: "Info",
    0x1654AE6B: "Tracks",
    0xAE: "TrackEntry",
    0xE0: "Video",
    0x1254C367: "Tags",
    0x7373: "Tag",
    0x67C8: "SimpleTag",
    0x1F43B675: "Cluster",
    0x1C53BB6B: "Cues",
    0xBB: "CuePoint",
    0xB7: "CueTrackPositions",
}
LEAVES = {
    0x4282: "DocType",
    0x2AD7B1: "TimestampScale",
    0x4489: "Duration",
    0xD7: "TrackNumber",
    0x23E383: "DefaultDuration",
    0x86: "CodecID",
    0xB0: "PixelWidth",
    0xBA: "PixelHeight",
    0x45A3: "TagName",
    0x4487: "TagString",
    0xE7: "Timestamp",
    0xA3: "SimpleBlock",
    0x53AB: "SeekID",
    0x53AC: "SeekPosition",
    0xB3: "CueTime",
    0xF1: "CueClusterPosition",
}


class Element(NamedTuple):
    """One element; ``size`` is None where it is unknown, and ``content`` then goes to the end of the file."""

    path: str
    offset: int
    size: int | None
    content: bytes


def elements(film: bytes, start: int = 0, end: int | None = None, path: str = "") -> Iterator[Element]:
    """Yield every element, masters before what they hold; raises AssertionError at one that is cut off."""
    end = len(film) if end is None else end
    while start < end:
        number, body = _vint(film, start, marked=True)
        length, body = _vint(film, body, marked=False)
        name = MASTERS.get(number) or LEAVES.get(number, f"{number:X}")
        size = None if length == (1 << 56) - 1 else length
        stop = end if size is None else body + size
        assert stop <= end, f"{path}/{name} at {start} is cut off"
        yield Element(f"{path}/{name}", start, size, film[body:stop])
        if number in MASTERS:
            yield from elements(film, body, stop, f"{path}/{name}")
        start = stop


def _vint(film: bytes, at: int, *, marked: bool) -> tuple[int, int]:
    """Return a number of variable length, with or without its length marker, and where it ends."""
    length = 9 - film[at].bit_length()
    value = int.from_bytes(film[at : at + length], "big")
    return value if marked else value & ~(1 << 7 * length), at + length


def tag(film: bytes, name: str) -> str:
    """Return a tag's text."""
    texts = [found.content.decode() for found in elements(film) if "/SimpleTag/Tag" in found.path]
    return dict(zip(texts[::2], texts[1::2], strict=True))[name]


class Shown(NamedTuple):
    """A frame as it is played."""

    stamp_s: float
    image: ByteArray


def played(path: Path) -> list[Shown]:
    """Play a film with OpenCV."""
    player = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    shown = []
    while (read := player.read())[0]:
        shown.append(Shown(1e-3 * player.get(cv2.CAP_PROP_POS_MSEC), np.asarray(read[1], np.uint8)))
    player.release()
    return shown


def packets(path: Path) -> list[bytes]:
    """Return a film's JPEGs as OpenCV takes them out of the file, not decoded."""
    player = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    player.set(cv2.CAP_PROP_FORMAT, -1)
    taken = []
    while (read := player.read())[0]:
        taken.append(read[1].tobytes())
    player.release()
    return taken
