"""The devices on the bench, chosen by settings. Building touches none of them."""

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mrnav_server.app.calibration_scene import SimulatedScene
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import Calibration, StagePoint
from mrnav_server.core.vessel import VesselMap
from mrnav_server.devices.base import Camera, Manipulator
from mrnav_server.devices.cameras import UsbCamera
from mrnav_server.devices.micromanager.camera import MicroManagerCamera
from mrnav_server.devices.micromanager.manipulator import MicroManagerManipulator
from mrnav_server.devices.micromanager.shared_core import SharedCore
from mrnav_server.devices.sensapex.discovery import is_emulated
from mrnav_server.devices.sensapex.manipulator import SensapexManipulator
from mrnav_server.devices.sensapex.raw_stop import RawStop
from mrnav_server.devices.sensapex.sdk import SdkManipulator
from mrnav_server.devices.sensapex.udp import UdpManipulator
from mrnav_server.devices.v4l2 import Controls
from mrnav_server.devices.video_file import VideoFileCamera
from mrnav_server.settings import Settings
from mrnav_server.sim.clock import WorldClock
from mrnav_server.sim.devices import SimulatedCamera, SimulatedManipulator
from mrnav_server.sim.world import SimulatedWorld
from mrnav_server.vision.calibration_file import load_calibration

_FOLLOWING_LAG_S = 0.005
"""How closely the simulated magnet follows a manipulator outside the world: about one reading's age."""


@dataclass(slots=True)
class Bench:
    """Devices and what is known of how they stand to each other; a registration changes the calibration.

    Attributes:
        manipulator: Moves the magnet.
        camera: Looks down on the vessel.
        calibration: What the server goes by.
        world: The simulated world behind simulated devices; None without them.
        world_clock: Keeps that world on real time.
        name: What stands here, for people.
        scene: What lies under a simulated camera; None under a real one.
    """

    manipulator: Manipulator
    camera: Camera
    calibration: Calibration
    world: SimulatedWorld | None
    world_clock: WorldClock | None
    name: str
    scene: SimulatedScene | None = None

    @property
    def stop_path(self) -> RawStop | None:
        """The way on which another process can stop the manipulator; None without one, or before opening."""
        if isinstance(self.manipulator, SensapexManipulator):
            return self.manipulator.stop_path
        return None

    @property
    def camera_format(self) -> str:
        """What the camera really gives, in words; "" where that is not known, and before opening."""
        return camera_format(self.camera)

    @property
    def simulated(self) -> bool:
        """Whether any part of the rig is not the real thing; known for sure once it is open."""
        path = self.stop_path
        return self.world is not None or (path is not None and is_emulated(path.target[0]))


def build_bench(
    settings: Settings,
    vessel: VesselMap,
    clock: Callable[[], float],
    sleep: Callable[[float], None] = time.sleep,
) -> Bench:
    """Build the devices that the settings name.

    A simulated camera beside a real or emulated manipulator shows a world whose magnet follows the position
    that the manipulator reports.

    Args:
        settings: ``manipulator.driver`` and ``rig.camera`` choose the drivers, ``camera`` the picture.
        vessel: The vessel model.
        clock: Monotonic time in seconds.
        sleep: How a simulated camera waits for a time in seconds, by that clock.
    """
    core = SharedCore(settings.micromanager)
    if "simulated" not in (settings.manipulator.driver, settings.rig.camera):
        manipulator, real = build_manipulator(settings, clock, core), build_camera(settings, clock, core)
        return Bench(manipulator, real, _measured(settings, vessel), None, None, _name(settings))
    follows = settings.manipulator.driver != "simulated"
    sim = dataclasses.replace(settings.sim, manipulator_lag_s=_FOLLOWING_LAG_S) if follows else settings.sim
    world = SimulatedWorld(sim, vessel, settings.camera)
    manipulator = build_manipulator(settings, clock, core) if follows else SimulatedManipulator(world)

    def reported_tip() -> StagePoint:
        return manipulator.tip().position

    scene: SimulatedScene | None = None
    if settings.rig.camera == "simulated":
        scene = SimulatedScene(settings, vessel, world)
        camera: Camera = SimulatedCamera(
            settings.sim, settings.camera, world.snapshot, scene.render, clock, sleep
        )
    else:
        camera = build_camera(settings, clock, core)
    return Bench(
        manipulator,
        camera,
        world.calibration if settings.rig.calibration is None else _measured(settings, vessel),
        world,
        WorldClock(world, clock, reported_tip if follows else None),
        _name(settings),
        scene,
    )


def build_manipulator(settings: Settings, clock: Callable[[], float], core: SharedCore) -> Manipulator:
    """Build the manipulator that ``manipulator.driver`` names, which is not the simulated one.

    Args:
        settings: Sections ``sensapex`` and ``micromanager`` describe it.
        clock: Monotonic time in seconds.
        core: Micro-Manager's core, which a camera may share.

    Raises:
        ValueError: If the driver is the simulated one, which needs a world.
    """
    match settings.manipulator.driver:
        case "sensapex-udp":
            return UdpManipulator(settings.sensapex, clock)
        case "sensapex-sdk":
            return SdkManipulator(settings.sensapex, clock)
        case "micromanager":
            return MicroManagerManipulator(settings.micromanager, core, clock)
        case "simulated":
            raise ValueError("the simulated manipulator belongs to a simulated world")


def build_camera(
    settings: Settings, clock: Callable[[], float], core: SharedCore
) -> UsbCamera | VideoFileCamera | MicroManagerCamera:
    """Build the camera that ``rig.camera`` names, which is not the simulated one.

    Args:
        settings: Sections ``camera`` and ``micromanager`` describe it.
        clock: Monotonic time in seconds.
        core: Micro-Manager's core, which a manipulator may share.

    Raises:
        ValueError: If the camera is the simulated one, which needs a world.
    """
    match settings.rig.camera:
        case "usb":
            asked = settings.camera
            controls = Controls(asked.exposure_ms, asked.gain)
            return UsbCamera(asked.index, asked, clock, controls)
        case "file":
            film = settings.camera
            return VideoFileCamera(Path(film.file), film, clock, loop=film.loop)
        case "micromanager":
            return MicroManagerCamera(settings.micromanager, settings.camera, core, clock)
        case "simulated":
            raise ValueError("the simulated camera belongs to a simulated world")


def camera_format(camera: Camera) -> str:
    """Return what a USB camera or a video file really gives, in words; "" for others and before opening."""
    return camera.format if isinstance(camera, UsbCamera | VideoFileCamera) else ""


def _measured(settings: Settings, vessel: VesselMap) -> Calibration:
    """Return the measured calibration that the settings name.

    Raises:
        ConfigError: If there is none, or it cannot be used.
    """
    if settings.rig.calibration is None:
        raise ConfigError(
            "rig.calibration: a manipulator under a real camera needs a measured calibration: run"
            " `mrnav calibrate run` and name its file"
        )
    simulated = settings.rig.camera == "simulated"
    return load_calibration(Path(settings.rig.calibration), settings.camera, vessel, simulated=simulated)


def _name(settings: Settings) -> str:
    driver, camera = settings.manipulator.driver, settings.rig.camera
    if driver == camera == "simulated":
        return "simulated rig"
    return f"{driver} manipulator, {camera} camera"
