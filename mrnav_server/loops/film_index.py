"""Finds the pictures in a trial's film (loops/matroska.py wrote it), so that one can be shown by itself."""

import re
import struct
from dataclasses import dataclass
from pathlib import Path

from mrnav_server.loops.matroska import TICKS_PER_S
from mrnav_server.loops.video_recorder import FIRST_TAKEN_KEY

_ENTERED = {0x18538067, 0x1F43B675}
"""Segment and cluster: their content is looked at, everything else is jumped over."""
_TAGS, _TIMESTAMP, _SIMPLE_BLOCK = 0x1254C367, 0xE7, 0xA3
_HEAD_BYTES = 12
_BLOCK_HEAD_BYTES = 4
_FIRST_TAKEN = re.compile(FIRST_TAKEN_KEY.encode() + rb".{1,12}?(\d+\.\d{6})", re.DOTALL)


@dataclass(frozen=True, slots=True)
class FilmFrame:
    """Where a picture lies in a film.

    Attributes:
        taken_s: Capture time, monotonic, in seconds, 1 ms fine.
        offset: Of its JPEG in the file.
        size: Of its JPEG in bytes.
    """

    taken_s: float
    offset: int
    size: int


def film_frames(path: Path) -> list[FilmFrame]:
    """Return a film's pictures in order; none without a film. A cluster that a crash cut off ends it."""
    if not path.is_file():
        return []
    frames: list[FilmFrame] = []
    first_s, cluster, at, end = 0.0, 0, 0, path.stat().st_size
    with path.open("rb") as file:
        while at < end:
            file.seek(at)
            head = file.read(_HEAD_BYTES)
            if len(head) < 2:
                break
            number, length = _number(head, 0, marked=True)
            size, body = _number(head, length, marked=False)
            if number in _ENTERED:
                at += body
                continue
            if at + body + size > end:
                break
            if number in (_TAGS, _TIMESTAMP, _SIMPLE_BLOCK):
                file.seek(at + body)
                content = file.read(_BLOCK_HEAD_BYTES if number == _SIMPLE_BLOCK else size)
                if number == _TAGS:
                    found = _FIRST_TAKEN.search(content)
                    first_s = float(found[1]) if found else 0.0
                elif number == _TIMESTAMP:
                    cluster = int.from_bytes(content, "big")
                else:
                    ticks = cluster + struct.unpack(">h", content[1:3])[0]
                    offset = at + body + _BLOCK_HEAD_BYTES
                    frames.append(FilmFrame(first_s + ticks / TICKS_PER_S, offset, size - _BLOCK_HEAD_BYTES))
            at += body + size
    return frames


def film_picture(path: Path, frame: FilmFrame) -> bytes:
    """Return a picture's JPEG."""
    with path.open("rb") as file:
        file.seek(frame.offset)
        return file.read(frame.size)


def _number(head: bytes, at: int, *, marked: bool) -> tuple[int, int]:
    """Return a number of variable length, with or without its length's marker, and where it ends."""
    length = 9 - head[at].bit_length()
    value = int.from_bytes(head[at : at + length], "big")
    return value if marked else value & ~(1 << 7 * length), at + length
