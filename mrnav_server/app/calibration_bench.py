"""The simulated rig as a calibration finds it: a sheet or a plate, and a time of its own."""

import math
from dataclasses import dataclass, replace

import numpy as np

from mrnav_server.core.arrays import ByteArray, FloatArray
from mrnav_server.core.frames import Affine2, Calibration, StagePoint, VesselPoint
from mrnav_server.core.vessel import VesselMap
from mrnav_server.settings import Settings
from mrnav_server.sim.devices import SimulatedCamera, SimulatedManipulator
from mrnav_server.sim.microscope import Microscope, floor_seen_um
from mrnav_server.sim.optics import Optics
from mrnav_server.sim.sheet import sheet_picture
from mrnav_server.sim.world import SimulatedWorld
from mrnav_server.vision.calibration_file import CalibrationFile, calibration_of
from mrnav_server.vision.calibration_plan import Prepare
from mrnav_server.vision.charuco import SheetConfig, board_picture
from mrnav_server.vision.vessel_model import vessel_map


@dataclass(frozen=True, slots=True)
class TrueErrors:
    """A simulated calibration against the simulator's truth; all of it simulated.

    Attributes:
        floor_rms_um, floor_max_um: Floor points by their pixels, over the vessel model's square.
        tip_rms_um, tip_max_um: The magnet's centre in the image, within 1 mm of the working height.
        tip_steady_um: The same about its mean: what remains once the offset is measured with the same tip.
        offset_um: The magnet's offset.
        held_um: Where a robot is held, through the whole chain from stage to image.
        critical_height_share: The critical height, as a share of it.
    """

    floor_rms_um: float
    floor_max_um: float
    tip_rms_um: float
    tip_max_um: float
    tip_steady_um: float
    offset_um: float
    held_um: float
    critical_height_share: float


class SimulatedBench:
    """The simulated rig with a plain plate in the vessel's place, on a time of its own.

    Args:
        settings: The rig.
        size_px: Size of the plate in grid pixels, as the vessel model's.
        um_per_px: Size of a grid pixel.
        sheet: The sheet that is laid down when it is asked for.

    Attributes:
        world: The world.
        manipulator, camera: Its devices.
    """

    def __init__(self, settings: Settings, size_px: int, um_per_px: float, sheet: SheetConfig) -> None:
        picture, sim = settings.camera, settings.sim
        self._um = um_per_px
        self._middle = VesselPoint(size_px / 2.0, size_px / 2.0)
        radius_um = sim.magnets.robot_radius_um
        self.plate: VesselMap = vessel_map(
            "plate", np.full((size_px, size_px), 255, np.uint8), um_per_px, radius_um
        )
        # A plate has no place of its own.
        plain = replace(sim, start=self._middle, vessel_shift_um=(0.0, 0.0), vessel_turn_deg=0.0)
        self.world = SimulatedWorld(plain, self.plate, picture)
        optics = self.world.optics
        truth = self.world.true_calibration
        self._microscope = Microscope(
            settings.microscope, picture, sim.magnets, self.plate, truth, sim.seed, optics
        )
        seen_um = _seen_um(optics, truth, picture.width_px, picture.height_px)
        middle_um = (self._middle.x_px * um_per_px, self._middle.y_px * um_per_px)
        self._floors = {
            "sheet": sheet_picture(board_picture(sheet), sheet.module_um, seen_um, middle_um),
            "plate": np.full((picture.height_px, picture.width_px, 3), 196, np.uint8),
        }
        self._scene = "plate"
        self._now_s = 0.0
        self.world.set_time(0.0)
        self.world.drop_robot()
        self.manipulator = SimulatedManipulator(self.world)
        self.camera = SimulatedCamera(
            sim, picture, self.world.snapshot, self._render, self.clock, self._let_pass
        )

    def clock(self) -> float:
        """Return the bench's own time."""
        return self._now_s

    async def sleep(self, duration_s: float) -> None:
        """Let the bench's own time pass."""
        self._let_pass(duration_s)

    async def prepare(self, step: Prepare) -> None:
        """Do what a person would do."""
        self._scene = step.scene
        self._microscope.lay(self._floors["sheet" if step.scene == "sheet" else "plate"])
        if step.scene == "robot":
            self.world.place_robot(self._middle)
        else:
            self.world.drop_robot()

    def true_errors(self, file: CalibrationFile, vessel: VesselMap, height_factor: float) -> TrueErrors:
        """Compare a calibration with the truth, over the vessel's square and its working height."""
        found, truth = calibration_of(file, vessel), self.world.true_calibration
        view = self.world.optics or truth
        um = self._um
        line = np.linspace(0.0, vessel.size_px, 13)
        grid = [VesselPoint(float(x), float(y)) for y in line for x in line]
        floor = [found.vessel_point(view.image_point(p)).distance_px(p) * um for p in grid]
        inner = [VesselPoint(float(x), float(y)) for y in line[3:-3] for x in line[3:-3]]
        tips, held = [], []
        dx, dy = truth.magnet_offset_um
        for number, point in enumerate(inner):
            x_um, y_um = truth.stage_xy_um(point)
            z_um = truth.floor_z_um + height_factor * truth.critical_height_um
            tip = StagePoint(x_um + dx, y_um + dy, z_um + 1000.0 * ((number % 3) - 1))
            # On the floor: the seen point of the tip, which its map predicts.
            seen = found.vessel_point(view.tip_in_image(tip))
            guessed = found.vessel_point(found.tip_in_image(tip))
            tips.append(((guessed.x_px - seen.x_px) * um, (guessed.y_px - seen.y_px) * um))
            held.append(found.held_point(replace(tip, z_um=z_um)).distance_px(point) * um)
        misses = np.array(tips)
        far = np.linalg.norm(misses, axis=1)
        return TrueErrors(
            floor_rms_um=_rms(np.array(floor)),
            floor_max_um=max(floor),
            tip_rms_um=_rms(far),
            tip_max_um=float(far.max()),
            tip_steady_um=_rms(np.linalg.norm(misses - misses.mean(axis=0), axis=1)),
            offset_um=math.dist(found.magnet_offset_um, truth.magnet_offset_um),
            held_um=_rms(np.array(held)),
            critical_height_share=abs(found.critical_height_um / truth.critical_height_um - 1.0),
        )

    def _let_pass(self, duration_s: float) -> None:
        self._now_s += duration_s
        self.world.advance(duration_s)

    def _render(self, robot: VesselPoint | None, tip: StagePoint) -> ByteArray:
        if self._scene == "sheet":
            return self._microscope.render(None, _AWAY)
        return self._microscope.render(robot if self._scene == "robot" else None, tip)


_AWAY = StagePoint(60_000.0, -60_000.0, 12_000.0)
"""A tip that is out of view with its needle."""


def _seen_um(optics: Optics | None, truth: Calibration, width_px: int, height_px: int) -> FloatArray:
    """Return the floor point that each pixel shows, in µm."""
    if optics is not None:
        return floor_seen_um(optics, width_px, height_px)
    inverse: Affine2 = truth.image_from_vessel.inverse()
    columns, rows = np.meshgrid(np.arange(width_px), np.arange(height_px))
    x, y = (np.array(part) for part in inverse.rows())
    return (
        np.stack([x[0] * columns + x[1] * rows + x[2], y[0] * columns + y[1] * rows + y[2]], -1)
        * truth.um_per_px
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
