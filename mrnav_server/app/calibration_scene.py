"""What lies under the simulated microscope while the running server is calibrated: sheet, plate or vessel."""

import asyncio
from functools import cached_property

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.frames import StagePoint, VesselPoint
from mrnav_server.core.vessel import VesselMap
from mrnav_server.settings import Settings
from mrnav_server.sim.microscope import Microscope, floor_seen_um
from mrnav_server.sim.sheet import sheet_picture
from mrnav_server.sim.world import SimulatedWorld
from mrnav_server.vision.charuco import SheetConfig, board_picture
from mrnav_server.vision.vessel_model import vessel_map

_AWAY = StagePoint(60_000.0, -60_000.0, 12_000.0)
"""A tip that is out of view with its needle."""
_PLATE_GRAY = 196


class SimulatedScene:
    """Draws the simulated world, and changes it as a person at the bench would.

    Args:
        settings: The rig.
        vessel: The vessel model.
        world: The world.
    """

    def __init__(self, settings: Settings, vessel: VesselMap, world: SimulatedWorld) -> None:
        self._settings = settings
        self._vessel = vessel
        self._world = world
        self._scene = "vessel"
        self._microscope = self._over(vessel)
        self._bench: Microscope | None = None
        self._start: VesselPoint | None = None

    def render(self, robot: VesselPoint | None, tip: StagePoint) -> ByteArray:
        """Return the picture of what lies there."""
        scene, bench = self._scene, self._bench
        if scene == "vessel" or bench is None:
            return self._microscope.render(robot, tip)
        if scene == "sheet":
            return bench.render(None, _AWAY)
        return bench.render(robot if scene == "robot" else None, tip)

    async def lay(self, scene: str, sheet: SheetConfig) -> None:
        """Do what a person would do who is asked for the sheet, the plate, or the robot on the plate."""
        bench = self._bench
        if bench is None:
            bench = await asyncio.to_thread(lambda: self._over(self._plate))
        bench.lay(await asyncio.to_thread(self._floor, scene, sheet))
        if self._scene == "vessel":
            self._start = self._world.robot
        middle = VesselPoint(self._plate.size_px / 2.0, self._plate.size_px / 2.0)
        self._world.lay(self._plate, middle)
        if scene == "robot":
            self._world.place_robot(middle)
        self._bench, self._scene = bench, scene

    def put_back(self) -> None:
        """Lay the vessel back, with the robot where it was."""
        if self._start is not None:
            self._world.lay(self._vessel, self._start)
            self._world.place_robot(self._start)
        self._start, self._scene = None, "vessel"

    @cached_property
    def _plate(self) -> VesselMap:
        blank = np.full((self._vessel.size_px, self._vessel.size_px), 255, np.uint8)
        radius_um = self._settings.sim.magnets.robot_radius_um
        return vessel_map("plate", blank, self._vessel.um_per_px, radius_um)

    def _over(self, vessel: VesselMap) -> Microscope:
        settings, world = self._settings, self._world
        return Microscope(
            settings.microscope,
            settings.camera,
            settings.sim.magnets,
            vessel,
            world.true_calibration,
            settings.sim.seed,
            world.optics,
        )

    def _floor(self, scene: str, sheet: SheetConfig) -> ByteArray:
        """Draw the sheet, or a plain plate."""
        picture, optics, truth = self._settings.camera, self._world.optics, self._world.true_calibration
        width, height = picture.width_px, picture.height_px
        if scene != "sheet":
            return np.full((height, width, 3), _PLATE_GRAY, np.uint8)
        if optics is not None:
            seen_um = floor_seen_um(optics, width, height)
        else:
            x, y = np.meshgrid(np.arange(float(width)), np.arange(float(height)))
            inverse = np.array(truth.image_from_vessel.inverse().rows())
            seen_px = cv2.transform(np.stack([x, y], -1), inverse)
            seen_um = truth.um_per_px * np.asarray(seen_px, np.float64)
        half_um = 0.5 * self._vessel.size_px * self._vessel.um_per_px
        return sheet_picture(board_picture(sheet), sheet.module_um, seen_um, (half_um, half_um))
