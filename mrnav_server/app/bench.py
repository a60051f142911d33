"""The devices on the bench, chosen by settings. Building touches none of them."""

from collections.abc import Callable
from dataclasses import dataclass

from mrnav_server.core.frames import Calibration
from mrnav_server.core.vessel import VesselMap
from mrnav_server.devices.base import Camera, Manipulator
from mrnav_server.devices.cameras import UsbCamera
from mrnav_server.settings import Settings
from mrnav_server.sim.clock import WorldClock
from mrnav_server.sim.devices import SimulatedCamera, SimulatedManipulator
from mrnav_server.sim.microscope import Microscope
from mrnav_server.sim.world import SimulatedWorld


@dataclass(frozen=True, slots=True)
class Bench:
    """Devices and what is known of how they stand to each other.

    Attributes:
        manipulator: Moves the magnet.
        camera: Looks down on the vessel.
        calibration: What the server goes by.
        world: The simulated world behind simulated devices; None without them.
        world_clock: Keeps that world on real time.
    """

    manipulator: Manipulator
    camera: Camera
    calibration: Calibration
    world: SimulatedWorld | None
    world_clock: WorldClock | None


def build_bench(settings: Settings, vessel: VesselMap, clock: Callable[[], float]) -> Bench:
    """Build the devices that the settings name.

    Args:
        settings: ``rig.manipulator`` and ``rig.camera`` choose the drivers, ``camera`` the picture.
        vessel: The vessel model.
        clock: Monotonic time in seconds.
    """
    world = SimulatedWorld(settings.sim, vessel, settings.camera)
    if settings.rig.camera == "usb":
        camera: Camera = build_usb_camera(settings, clock)
    else:
        camera = _simulated_camera(settings, vessel, world, clock)
    return Bench(SimulatedManipulator(world), camera, world.calibration, world, WorldClock(world, clock))


def build_usb_camera(settings: Settings, clock: Callable[[], float]) -> UsbCamera:
    """Build the USB camera that ``camera`` describes, chosen or not."""
    return UsbCamera(settings.camera.index, settings.camera, clock)


def _simulated_camera(
    settings: Settings, vessel: VesselMap, world: SimulatedWorld, clock: Callable[[], float]
) -> SimulatedCamera:
    sim, picture = settings.sim, settings.camera
    microscope = Microscope(
        settings.microscope, picture, sim.magnets, vessel, world.true_calibration, sim.seed
    )
    return SimulatedCamera(sim, picture, world.snapshot, microscope.render, clock)
