"""Rendered vessels that lie elsewhere than the calibration says; all of it simulated."""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.frames import Calibration, StagePoint, VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.vessel import VesselMap
from mrnav_server.sim.microscope import Microscope, MicroscopeConfig
from mrnav_server.sim.optics import OpticsConfig
from mrnav_server.sim.world import SimConfig, SimulatedWorld
from mrnav_server.vision.calibration_parts import VesselPose
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.registration import registered
from mrnav_server.vision.vessel_model import load_vessel_model, vessel_map
from mrnav_server.vision.walls import Walls, image_px

UM_PER_IMAGE_PX = 15.0
LENS = OpticsConfig(radial=-0.01, tilt_deg=2.0, water_depth_um=3000.0)


@cache
def shipped(name: str) -> VesselMap:
    return load_vessel_model(find_model(name))


def drawn(*lines: tuple[tuple[int, int], tuple[int, int]], width_px: int = 130) -> VesselMap:
    """Return a vessel of straight tubes on a grid of 18 mm."""
    mask = np.zeros((1800, 1800), np.uint8)
    for start, end in lines:
        cv2.line(mask, start, end, 255, width_px)
    return vessel_map("drawn", mask)


@dataclass(frozen=True)
class Scene:
    """A simulated bench whose vessel lies somewhere.

    Attributes:
        vessel: The model.
        told: What the server goes by.
        true: Where things are.
        world: The world.
        microscope: Sees it.
    """

    vessel: VesselMap
    told: Calibration
    true: Calibration
    world: SimulatedWorld
    microscope: Microscope

    @classmethod
    def of(
        cls,
        vessel: VesselMap,
        shift_um: tuple[float, float] = (0.0, 0.0),
        turn_deg: float = 0.0,
        optics: OpticsConfig | None = None,
    ) -> "Scene":
        sim = SimConfig(vessel_shift_um=shift_um, vessel_turn_deg=turn_deg, optics=optics or OpticsConfig())
        picture = PictureFormat()
        world = SimulatedWorld(sim, vessel, picture)
        truth = world.true_calibration
        microscope = Microscope(MicroscopeConfig(), picture, sim.magnets, vessel, truth, 0, world.optics)
        return cls(vessel, world.calibration, truth, world, microscope)

    def picture(self) -> ByteArray:
        """Return a picture with robot and needle in view."""
        return self.microscope.render(self.world.robot, self.world.tip)

    def over(self, robot: VesselPoint) -> ByteArray:
        """Return a picture with the magnet above a robot somewhere."""
        x_um, y_um = self.true.stage_xy_um(robot)
        dx_um, dy_um = self.true.magnet_offset_um
        return self.microscope.render(robot, StagePoint(x_um + dx_um, y_um + dy_um, self.world.tip.z_um))

    def error_um(self, pose: VesselPose) -> float:
        """Return how far a registered model's walls are from the true ones in the picture, the largest."""
        found = registered(self.told, self.vessel, pose)
        points = Walls.of(self.vessel, 300.0).points_px
        miss_px = np.linalg.norm(image_px(found, points) - image_px(self.true, points), axis=1)
        return float(miss_px.max()) * UM_PER_IMAGE_PX
