"""The vendor's C library from the ``sensapex`` wheel: its functions, and nothing else of the wheel."""

import ctypes
import importlib.util
import platform
import sys
from dataclasses import replace
from pathlib import Path

from mrnav_server.core.errors import DeviceError
from mrnav_server.devices.sensapex.goto import Goto

_FILE = "libum.so"
_WAY_OUT = 'or set manipulator.driver = "sensapex-udp", which needs no library'
_FORCE_READ = -1
_TOGETHER = 1
_MAX_DEVICES = 50
_BUSY = 1
_NO_AXIS = ctypes.c_float(float("nan"))


def library_path() -> Path:
    """Return where the library lies.

    Raises:
        DeviceError: If this computer cannot run it, or it is not installed, with the remedy.
    """
    if sys.platform != "linux" or platform.machine() != "x86_64":
        raise DeviceError(
            f"the vendor's library runs on Linux x86_64, not on {sys.platform} {platform.machine()}: "
            f"use such a computer, {_WAY_OUT}"
        )
    spec = importlib.util.find_spec("sensapex")
    folders = list(spec.submodule_search_locations or ()) if spec else []
    for folder in folders:
        if (path := Path(folder) / _FILE).is_file():
            return path
    raise DeviceError(
        f"the vendor's library is not installed: pip install 'mrnav-server[sensapex]', {_WAY_OUT}"
    )


class SdkLibrary:
    """The library's functions with a handle of its own; one thread at a time.

    Every function raises DeviceError with the library's own words if its call fails.

    Raises:
        DeviceError: If the library cannot be used here, with the remedy.
    """

    def __init__(self) -> None:
        path = library_path()
        try:
            self._lib = ctypes.CDLL(str(path))
            self._lib.um_open.restype = ctypes.c_void_p
            self._lib.um_close.restype = None
            self._lib.um_errorstr.restype = ctypes.c_char_p
            self._lib.um_get_version.restype = ctypes.c_char_p
            # Looked up once: the first look-up of a name costs more than a call.
            self._goto, self._read = self._lib.um_goto_position_ext, self._lib.um_get_positions
        except (OSError, AttributeError) as error:
            raise DeviceError(f"the vendor's library {path} cannot be loaded: {error}; {_WAY_OUT}") from None
        self._handle: ctypes.c_void_p | None = None

    @property
    def version(self) -> str:
        """The library's version."""
        return bytes(self._lib.um_get_version()).decode()

    def open(self, address: str, group: int, timeout_ms: int) -> None:
        """Make a handle.

        Raises:
            DeviceError: If the library makes none.
        """
        handle = self._lib.um_open(address.encode(), ctypes.c_uint(timeout_ms), ctypes.c_int(group))
        if not handle:
            raise DeviceError(f"the vendor's library cannot open {address}, group {group}")
        self._handle = ctypes.c_void_p(handle)
        self._check(self._lib.um_set_timeout(self._handle, ctypes.c_int(timeout_ms)))

    def close(self) -> None:
        """Give the handle back."""
        if self._handle is not None:
            self._lib.um_close(self._handle)
            self._handle = None

    def list_devices(self) -> list[int]:
        """Look for devices; one that is known by its serial number is not reached before."""
        found = (ctypes.c_int * _MAX_DEVICES)()
        count = self._check(
            self._lib.um_get_device_list(self._handle, ctypes.byref(found), ctypes.c_int(_MAX_DEVICES))
        )
        return list(found[:count])

    def axis_count(self, device_id: int) -> int:
        """Ask for the number of axes."""
        return self._check(self._lib.um_get_axis_count(self._handle, ctypes.c_int(device_id)))

    def position_um(self, device_id: int, axes: int) -> tuple[float, ...]:
        """Ask for the position of each axis, in µm; never from the library's memory."""
        values = [ctypes.c_float() for _ in range(4)]
        age_ms = ctypes.c_int()
        self._check(
            self._read(
                self._handle,
                ctypes.c_int(device_id),
                ctypes.c_int(_FORCE_READ),
                *map(ctypes.byref, values),
                ctypes.byref(age_ms),
            )
        )
        return tuple(value.value for value in values[:axes])

    def status(self, device_id: int) -> int:
        """Return the status that was heard last; asks nothing."""
        return self._check(self._lib.um_get_status(self._handle, ctypes.c_int(device_id)))

    def drives(self, device_id: int) -> int:
        """Return 1 while a move is under way, 0 after its end, −1 if it failed; asks nothing.

        Nothing may rely on it for arrival: without news the library calls a move ended after one second.
        """
        return int(self._lib.um_get_drive_status(self._handle, ctypes.c_int(device_id)))

    def goto(self, device_id: int, move: Goto) -> None:
        """Send a move and wait for its acknowledgement; what goes out is ``as_sent(move)``."""
        self._check(
            self._goto(
                self._handle,
                ctypes.c_int(device_id),
                *map(_single, move.positions_nm),
                _NO_AXIS,
                *map(ctypes.c_float, move.speeds_um_per_s),
                ctypes.c_float(0.0),
                ctypes.c_int(_TOGETHER),
                ctypes.c_int(0),
            )
        )

    def _check(self, code: int) -> int:
        if code < 0:
            text = bytes(self._lib.um_errorstr(ctypes.c_int(code))).decode()
            raise DeviceError(f"{text} ({code})")
        return code


def as_sent(move: Goto) -> Goto:
    """Return the move that goes out: the library takes µm in single precision and cuts to whole nm."""
    x_nm, y_nm, z_nm = (int(_single(value_nm).value * 1000) for value_nm in move.positions_nm)
    return replace(move, positions_nm=(x_nm, y_nm, z_nm))


def _single(value_nm: int) -> ctypes.c_float:
    return ctypes.c_float(value_nm / 1000)
