"""Micro-Manager's core, loaded once for all devices of a configuration file."""

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import DeviceError
from mrnav_server.devices.micromanager.config import DEMO, MicroManagerConfig

if TYPE_CHECKING:
    import pymmcore

CORE_ERRORS = (RuntimeError, OSError, ValueError, SystemError)
"""What pymmcore raises; SystemError for images that are asked for once no device is loaded."""
_INSTALL = "pip install 'mrnav-server[micromanager]'"


class Core(Protocol):
    """What is used of ``pymmcore.CMMCore``; every call blocks, may raise ``CORE_ERRORS``, frees the GIL."""

    def getLoadedDevicesOfType(self, devType: int, /) -> Sequence[str]:  # noqa: N802, N803
        """Return the labels of the loaded devices of a type."""

    def unloadAllDevices(self) -> None:  # noqa: N802
        """Unload all devices."""

    def getXYStageDevice(self) -> str:  # noqa: N802
        """Return the default XY stage, "" without one."""

    def getFocusDevice(self) -> str:  # noqa: N802
        """Return the default Z stage, "" without one."""

    def getXYPosition(self, label: str, /) -> Sequence[float]:  # noqa: N802
        """Return x and y in the device's µm."""

    def getPosition(self, label: str, /) -> float:  # noqa: N802
        """Return z in the device's µm."""

    def setXYPosition(self, label: str, x: float, y: float, /) -> None:  # noqa: N802
        """Begin to go to x and y in the device's µm."""

    def setPosition(self, label: str, z: float, /) -> None:  # noqa: N802
        """Begin to go to z in the device's µm."""

    def deviceBusy(self, label: str, /) -> bool:  # noqa: N802
        """Return whether the device moves."""

    def stop(self, label: str, /) -> None:
        """Stop a stage."""

    def getDevicePropertyNames(self, label: str, /) -> Sequence[str]:  # noqa: N802
        """Return the names of the device's properties."""

    def setProperty(self, label: str, name: str, value: str, /) -> None:  # noqa: N802
        """Set a property."""

    def getCameraDevice(self) -> str:  # noqa: N802
        """Return the current camera, "" without one."""

    def setCameraDevice(self, label: str, /) -> None:  # noqa: N802
        """Make a camera the current one."""

    def setExposure(self, label: str, exposure_ms: float, /) -> None:  # noqa: N802
        """Set a camera's exposure in ms."""

    def getExposure(self, label: str, /) -> float:  # noqa: N802
        """Return a camera's exposure in ms."""

    def getImageBitDepth(self) -> int:  # noqa: N802
        """Return how many bits a pixel's component uses."""

    def getNumberOfComponents(self) -> int:  # noqa: N802
        """Return 1 for gray, 4 for colour."""

    def startContinuousSequenceAcquisition(self, interval_ms: float, /) -> None:  # noqa: N802
        """Let the current camera run."""

    def stopSequenceAcquisition(self, label: str, /) -> None:  # noqa: N802
        """Stop a camera."""

    def isSequenceRunning(self, label: str, /) -> bool:  # noqa: N802
        """Return whether a camera runs."""

    def getRemainingImageCount(self) -> int:  # noqa: N802
        """Return how many pictures wait."""

    def popNextImageMD(self, metadata: "pymmcore.Metadata", /) -> ByteArray:  # noqa: N802
        """Take the oldest picture that waits, and fill in what is known of it."""


class SharedCore:
    """One core for the stage and the camera: loaded by whoever comes first, unloaded by whoever leaves last.

    Two cores on one configuration would open the same serial lines twice. CMMCore may be called from several
    threads: it serializes the calls into one adapter library, not those into different ones.

    Args:
        config: Configuration file and adapters.
        load: Makes the core with its devices loaded.
    """

    def __init__(
        self, config: MicroManagerConfig, load: Callable[[MicroManagerConfig], Core] | None = None
    ) -> None:
        self._config = config
        self._load = load or load_core
        self._lock = threading.Lock()
        self._core: Core | None = None
        self._users = 0

    def acquire(self) -> Core:
        """Return the core, with every device of the configuration loaded; blocks as long as that takes.

        Raises:
            DeviceError: If that fails, with the remedy.
        """
        with self._lock:
            if self._core is None:
                self._core = self._load(self._config)
            self._users += 1
            return self._core

    def release(self) -> None:
        """Give the core back, once for every ``acquire``."""
        with self._lock:
            self._users -= 1
            if self._users == 0 and self._core is not None:
                core, self._core = self._core, None
                _unload(core)


def load_core(config: MicroManagerConfig) -> Core:
    """Load a configuration into a new core.

    Raises:
        DeviceError: If pymmcore, the file, an adapter or a device is missing, or an adapter does not fit.
    """
    try:
        import pymmcore
    except ImportError as error:
        raise DeviceError(f"Micro-Manager needs pymmcore ({error}): {_INSTALL}") from None
    adapters = _adapters(config.adapters)
    file = _demo_folder() / "MMConfig_demo.cfg" if config.config_file == DEMO else Path(config.config_file)
    if not file.is_file():
        raise DeviceError(
            f"micromanager.config_file {file} does not exist: save one with Micro-Manager's Hardware "
            "Configuration Wizard and give its path"
        )
    core = pymmcore.CMMCore()
    core.setDeviceAdapterSearchPaths([str(adapters)])
    try:
        core.loadSystemConfiguration(str(file))
    except CORE_ERRORS as error:
        _unload(core)
        raise DeviceError(_why_not(file, adapters, one_line(error), pymmcore.__version__)) from None
    return core


def device_label(core: Core, wanted: str, default: str, kind: int, words: str, setting: str) -> str:
    """Return the label of a device that is loaded and of the right kind.

    Args:
        core: Loaded.
        wanted: Label from the settings, "" for the default.
        default: The configuration's default, "" without one.
        kind: MMDevice's number of the device type.
        words: What people call that kind.
        setting: Name of the setting.

    Raises:
        DeviceError: If there is none of that name and kind.
    """
    label = wanted or default
    there = sorted(core.getLoadedDevicesOfType(kind))
    if label in there:
        return label
    choice = f"set {setting} to {' or '.join(there)}" if there else f"the configuration has no {words} at all"
    if label:
        raise DeviceError(f"Micro-Manager's configuration has no {words} named {label}: {choice}")
    raise DeviceError(f"Micro-Manager's configuration has no default {words}: {choice}")


def one_line(error: Exception) -> str:
    """Return an error's text; the core's texts have several lines."""
    return " ".join(str(error).split())


def _adapters(setting: str) -> Path:
    folder = _demo_folder() if setting == DEMO else Path(setting)
    if not folder.is_dir():
        raise DeviceError(
            f"micromanager.adapters {folder} is not a folder: give the one that Micro-Manager is installed in"
        )
    return folder


def _demo_folder() -> Path:
    try:
        import mm_test_adapters
    except ImportError:
        raise DeviceError(
            "Micro-Manager's demo devices are not installed: pip install mm-test-adapters, or set "
            "micromanager.config_file and micromanager.adapters to your own"
        ) from None
    return Path(mm_test_adapters.device_adapter_path())


def _why_not(file: Path, adapters: Path, reason: str, version: str) -> str:
    if "interface version" in reason.lower():
        remedy = (
            f"pymmcore {version} and the adapters in {adapters} do not fit: install the pymmcore whose "
            "version has the adapters' device interface number in the fourth place"
        )
    else:
        remedy = "check that every device is powered, connected and used by no other program"
    return f"Micro-Manager cannot load {file}: {reason}: {remedy}"


def _unload(core: Core) -> None:
    try:
        core.unloadAllDevices()
    except CORE_ERRORS:
        # A device that fails to shut down must not hide why it failed to load.
        return
