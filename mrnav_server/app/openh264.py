"""OpenH264, Cisco's H.264 encoder (BSD licence), through its C interface.

The system brings the library: no package on PyPI holds an H.264 encoder under a licence without copyleft.
Source of the structures: ``codec_app_def.h`` and ``codec_api.h`` of OpenH264 2.3 and 2.6.
"""

import ctypes
from ctypes.util import find_library
from typing import Any

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import ConfigError

_FILES = ("libopenh264.so.8", "libopenh264.so.7", "libopenh264.so.6", "libopenh264.dylib", "openh264.dll")
_I420 = 23
_CAMERA = 0
_BY_QUALITY = 0
_TARGET_BPS = 1_000_000
_WITH_PSNR = (2, 6)
"""From this version on each layer's record is longer."""
_OLDEST, _NEXT_MAJOR = (2, 0), (3, 0)
_MAX_LAYERS = 128
_KEY_TYPES = (1, 2)
_SKIPPED = 5
_TRACE_LEVEL, _ERRORS = 25, 1
_INITIALIZE, _UNINITIALIZE, _ENCODE, _SET_OPTION = 0, 3, 4, 7
"""Places in the encoder's table of functions."""
_KINDS: dict[type, Any] = {ctypes.c_int: ctypes.c_int}
"""How values are passed that are no references."""


class _Version(ctypes.Structure):
    _fields_ = [(name, ctypes.c_uint) for name in ("major", "minor", "revision", "reserved")]


class _Parameters(ctypes.Structure):
    _fields_ = [
        ("usage", ctypes.c_int),
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
        ("target_bps", ctypes.c_int),
        ("rate_control", ctypes.c_int),
        ("max_fps", ctypes.c_float),
    ]


class _Picture(ctypes.Structure):
    _fields_ = [
        ("format", ctypes.c_int),
        ("stride", ctypes.c_int * 4),
        ("plane", ctypes.c_void_p * 4),
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
        ("time_ms", ctypes.c_longlong),
        ("added_later", ctypes.c_ubyte * 64),
    ]


_LAYER: list[Any] = [
    ("temporal", ctypes.c_ubyte),
    ("spatial", ctypes.c_ubyte),
    ("quality", ctypes.c_ubyte),
    ("type", ctypes.c_int),
    ("layer_type", ctypes.c_ubyte),
    ("sub_sequence", ctypes.c_int),
    ("units", ctypes.c_int),
    ("unit_bytes", ctypes.POINTER(ctypes.c_int)),
    ("data", ctypes.POINTER(ctypes.c_ubyte)),
]


class _Layer(ctypes.Structure):
    _fields_ = _LAYER


class _LayerWithPsnr(ctypes.Structure):
    _fields_ = [*_LAYER, ("psnr", ctypes.c_float * 3)]


def _output(layer: type[ctypes.Structure]) -> type[ctypes.Structure]:
    fields = [
        ("layers", ctypes.c_int),
        ("layer", layer * _MAX_LAYERS),
        ("type", ctypes.c_int),
        ("bytes", ctypes.c_int),
        ("time_ms", ctypes.c_longlong),
    ]
    return type("_Output", (ctypes.Structure,), {"_fields_": fields})


class OpenH264:
    """The library.

    Raises:
        ConfigError: If this machine has none, or one whose interface is not known.
    """

    def __init__(self) -> None:
        self.library = _load()
        version = _Version()
        self.library.WelsGetCodecVersionEx(ctypes.byref(version))
        found = version.major, version.minor
        self.version = f"{version.major}.{version.minor}.{version.revision}"
        if not _OLDEST <= found < _NEXT_MAJOR:
            raise ConfigError(f"server.h264: OpenH264 {self.version} is not known here: install 2.x")
        self.output = _output(_LayerWithPsnr if found >= _WITH_PSNR else _Layer)


class H264Encoder:
    """Encodes pictures that follow each other; each but the first builds on the one before.

    Not for several threads at once.

    Args:
        openh264: The library.
        width_px: Of every picture, even.
        height_px: Of every picture, even.

    Raises:
        RuntimeError: If the library refuses.
    """

    def __init__(self, openh264: OpenH264, width_px: int, height_px: int) -> None:
        self._openh264 = openh264
        self._size = width_px, height_px
        self._handle = ctypes.c_void_p()
        if openh264.library.WelsCreateSVCEncoder(ctypes.byref(self._handle)):
            raise RuntimeError("OpenH264 gives no encoder")
        self._call(_SET_OPTION, ctypes.c_int(_TRACE_LEVEL), ctypes.byref(ctypes.c_int(_ERRORS)))
        parameters = _Parameters(_CAMERA, width_px, height_px, _TARGET_BPS, _BY_QUALITY, 30.0)
        self._call(_INITIALIZE, ctypes.byref(parameters))
        self._output = openh264.output()

    def encode(self, yuv: ByteArray, time_s: float) -> tuple[bytes, bool]:
        """Encode the next picture.

        Args:
            yuv: I420 as OpenCV gives it, shape (3/2 height, width), uint8, contiguous.
            time_s: When it was taken.

        Returns:
            The picture as an Annex B byte stream, b"" if nothing changed; and whether it stands by itself.

        Raises:
            RuntimeError: If the library fails.
        """
        width_px, height_px = self._size
        if yuv.shape != (height_px * 3 // 2, width_px) or not yuv.flags.c_contiguous:
            raise ValueError(f"a picture of shape {yuv.shape} is none of {width_px}×{height_px} in I420")
        luma, chroma = width_px * height_px, width_px * height_px // 4
        first = yuv.ctypes.data
        picture = _Picture(_I420, width=width_px, height=height_px, time_ms=round(1000.0 * time_s))
        picture.stride[:3] = (width_px, width_px // 2, width_px // 2)
        picture.plane[:3] = (first, first + luma, first + luma + chroma)
        output: Any = self._output
        self._call(_ENCODE, ctypes.byref(picture), ctypes.byref(output))
        if output.type == _SKIPPED:
            return b"", False
        parts = (output.layer[i] for i in range(output.layers))
        data = b"".join(ctypes.string_at(part.data, sum(part.unit_bytes[: part.units])) for part in parts)
        return data, output.type in _KEY_TYPES

    def close(self) -> None:
        """Give the encoder back."""
        if self._handle.value:
            self._call(_UNINITIALIZE)
            self._openh264.library.WelsDestroySVCEncoder(self._handle)
            self._handle = ctypes.c_void_p()

    def _call(self, place: int, *arguments: Any) -> None:  # noqa: ANN401 - what the C function takes
        table = ctypes.cast(self._handle, ctypes.POINTER(ctypes.POINTER(ctypes.c_void_p))).contents
        kinds = [ctypes.c_void_p, *(_KINDS.get(type(value), ctypes.c_void_p) for value in arguments)]
        if ctypes.CFUNCTYPE(ctypes.c_int, *kinds)(table[place])(self._handle, *arguments):
            raise RuntimeError(f"OpenH264 {self._openh264.version} refuses call {place}")


def _load() -> ctypes.CDLL:
    for name in filter(None, (find_library("openh264"), *_FILES)):
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    raise ConfigError(
        "server.h264 needs OpenH264, which this machine has not: install it (Debian: libopenh264-7 or -8,"
        " macOS: brew install openh264, Windows: Cisco's openh264.dll), or set server.h264 = false"
    )
