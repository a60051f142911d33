"""Motion JPEG in Matroska (RFC 9559): what to write into a file, as bytes.

The file is whole at every moment: the segment has no size until the end, and what is known only then has its
place kept by Void elements. So a file whose writer was killed plays up to its last cluster.
"""

import struct
from collections.abc import Mapping
from typing import NamedTuple

TICKS_PER_S = 1000
"""Matroska's usual resolution, and the one that players expect."""
MAX_CLUSTER_TICKS = 1000
"""So much is lost at most when the writer is killed; also keeps stamps within a cluster in 16 bits."""
MAX_CLUSTER_BYTES = 5_000_000
_APP = b"mrnav-server"
_UNKNOWN_SIZE = 0x01FF_FFFF_FFFF_FFFF.to_bytes(8, "big")
_TRACK, _VIDEO, _PROGRESSIVE, _KEYFRAME = 1, 1, 2, 0x80

_EBML, _SEGMENT, _VOID = 0x1A45DFA3, 0x18538067, 0xEC
_SEEK_HEAD, _SEEK, _SEEK_ID, _SEEK_POSITION = 0x114D9B74, 0x4DBB, 0x53AB, 0x53AC
_INFO, _TIMESTAMP_SCALE, _DURATION, _MUXING_APP, _WRITING_APP = 0x1549A966, 0x2AD7B1, 0x4489, 0x4D80, 0x5741
_TRACKS, _TRACK_ENTRY, _TRACK_NUMBER, _TRACK_UID, _TRACK_TYPE = 0x1654AE6B, 0xAE, 0xD7, 0x73C5, 0x83
_FLAG_LACING, _LANGUAGE, _CODEC_ID = 0x9C, 0x22B59C, 0x86
_VIDEO_SETTINGS, _PIXEL_WIDTH, _PIXEL_HEIGHT, _FLAG_INTERLACED = 0xE0, 0xB0, 0xBA, 0x9A
_TAGS, _TAG, _TARGETS, _SIMPLE_TAG, _TAG_NAME, _TAG_STRING = (
    0x1254C367,
    0x7373,
    0x63C0,
    0x67C8,
    0x45A3,
    0x4487,
)
_CLUSTER, _TIMESTAMP, _SIMPLE_BLOCK = 0x1F43B675, 0xE7, 0xA3
_CUES, _CUE_POINT, _CUE_TIME = 0x1C53BB6B, 0xBB, 0xB3
_CUE_TRACK_POSITIONS, _CUE_TRACK, _CUE_CLUSTER_POSITION = 0xB7, 0xF7, 0xF1


class Patch(NamedTuple):
    """Bytes that replace others of the same number at an offset in the file."""

    offset: int
    content: bytes


class MatroskaMuxer:
    """Turns JPEGs into a Matroska file: write ``head``, what ``add`` gives, ``tail``, then apply ``patches``.

    Args:
        width_px: Width of every picture.
        height_px: Height of every picture.
        tags: Text by name, for the whole film.
    """

    def __init__(self, width_px: int, height_px: int, tags: Mapping[str, str]) -> None:
        header = _element(
            _EBML,
            _uint(0x4286, 1),  # EBMLVersion
            _uint(0x42F7, 1),  # EBMLReadVersion
            _uint(0x42F2, 4),  # EBMLMaxIDLength
            _uint(0x42F3, 8),  # EBMLMaxSizeLength
            _element(0x4282, b"matroska"),  # DocType
            _uint(0x4287, 4),  # DocTypeVersion
            _uint(0x4285, 2),  # DocTypeReadVersion
        )
        self._start = len(header) + len(_id(_SEGMENT)) + len(_UNKNOWN_SIZE)
        apps = _element(_MUXING_APP, _APP), _element(_WRITING_APP, _APP)
        scale = _uint(_TIMESTAMP_SCALE, 1_000_000_000 // TICKS_PER_S)
        info = _element(_INFO, _void(len(_duration(1))), scale, *apps)
        seek_head = _void(len(_seek_head(0)))
        self._duration_at = self._start + len(seek_head) + len(_element(_INFO))
        self.head = b"".join(
            (
                header,
                _id(_SEGMENT) + _UNKNOWN_SIZE,
                seek_head,
                info,
                _element(_TRACKS, _track(width_px, height_px)),
                _element(_TAGS, _element(_TAG, _element(_TARGETS), *(_tag(*tag) for tag in tags.items()))),
            )
        )
        """The file's beginning."""
        self.frames = 0
        """Frames in the bytes that were given so far."""
        self._size = len(self.head)
        self._blocks: list[bytes] = []
        self._blocks_bytes = 0
        self._first = self._last = self._gap = 0
        self._cues: list[bytes] = []
        self._cues_at = 0

    def add(self, ticks: int, jpeg: bytes) -> bytes:
        """Add a picture; return the cluster that it does not fit into any more, or nothing.

        Args:
            ticks: Its time since the film's beginning, in 1 / ``TICKS_PER_S``, later than the one before.
            jpeg: The picture.
        """
        full = ticks - self._first > MAX_CLUSTER_TICKS or self._blocks_bytes + len(jpeg) > MAX_CLUSTER_BYTES
        cluster = self._cluster() if full else b""
        if not self._blocks:
            self._first = ticks
        block = struct.pack(">BhB", 0x80 | _TRACK, ticks - self._first, _KEYFRAME)
        self._blocks.append(_element(_SIMPLE_BLOCK, block, jpeg))
        self._blocks_bytes += len(jpeg)
        self._gap, self._last = ticks - self._last, ticks
        return cluster

    def tail(self) -> bytes:
        """Return the last cluster and the index, which end the file."""
        cluster = self._cluster()
        self._cues_at = self._size - self._start
        cues = _element(_CUES, *self._cues) if self._cues else b""
        self._size += len(cues)
        return cluster + cues

    def patches(self) -> tuple[Patch, ...]:
        """Return what the file's beginning could not know, once the tail is written."""
        size = Patch(self._start - len(_UNKNOWN_SIZE), _size(self._size - self._start))
        if not self._cues:
            return (size,)
        index = Patch(self._start, _seek_head(self._cues_at))
        return size, index, Patch(self._duration_at, _duration(self._last + max(1, self._gap)))

    def _cluster(self) -> bytes:
        if not self._blocks:
            return b""
        cluster = _element(_CLUSTER, _uint(_TIMESTAMP, self._first), *self._blocks)
        place = _uint(_CUE_TRACK, _TRACK), _uint(_CUE_CLUSTER_POSITION, self._size - self._start)
        cue = _uint(_CUE_TIME, self._first), _element(_CUE_TRACK_POSITIONS, *place)
        self._cues.append(_element(_CUE_POINT, *cue))
        self._size += len(cluster)
        self.frames += len(self._blocks)
        self._blocks, self._blocks_bytes = [], 0
        return cluster


def _id(number: int) -> bytes:
    return number.to_bytes((number.bit_length() + 7) // 8, "big")


def _size(length: int) -> bytes:
    """Return an element's size; always in 8 bytes, so that what is patched keeps its length."""
    return (1 << 56 | length).to_bytes(8, "big")


def _element(number: int, *content: bytes) -> bytes:
    body = b"".join(content)
    return _id(number) + _size(len(body)) + body


def _uint(number: int, value: int) -> bytes:
    return _element(number, value.to_bytes(max(1, (value.bit_length() + 7) // 8), "big"))


def _void(length: int) -> bytes:
    """Return an element without meaning, ``length`` bytes long in all."""
    return _element(_VOID, bytes(length - len(_element(_VOID))))


def _duration(ticks: int) -> bytes:
    return _element(_DURATION, struct.pack(">d", ticks))


def _seek_head(cues_at: int) -> bytes:
    position = _element(_SEEK_POSITION, struct.pack(">Q", cues_at))
    return _element(_SEEK_HEAD, _element(_SEEK, _element(_SEEK_ID, _id(_CUES)), position))


def _track(width_px: int, height_px: int) -> bytes:
    size = _uint(_PIXEL_WIDTH, width_px), _uint(_PIXEL_HEIGHT, height_px)
    return _element(
        _TRACK_ENTRY,
        _uint(_TRACK_NUMBER, _TRACK),
        _uint(_TRACK_UID, _TRACK),
        _uint(_TRACK_TYPE, _VIDEO),
        _uint(_FLAG_LACING, 0),
        _element(_LANGUAGE, b"und"),
        _element(_CODEC_ID, b"V_MJPEG"),
        _element(_VIDEO_SETTINGS, _uint(_FLAG_INTERLACED, _PROGRESSIVE), *size),
    )


def _tag(name: str, text: str) -> bytes:
    return _element(_SIMPLE_TAG, _element(_TAG_NAME, name.encode()), _element(_TAG_STRING, text.encode()))
