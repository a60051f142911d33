"""A bench for tests: a simple vessel under the simulated microscope, and a tracker that looks at it."""

from functools import cache

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.frames import Affine2, Calibration, ImagePoint, StagePoint, VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Frame, Track
from mrnav_server.sim.magnetics import Magnets
from mrnav_server.sim.microscope import Microscope, MicroscopeConfig
from mrnav_server.vision.tracker import Tracker, TrackerConfig
from mrnav_server.vision.vessel_model import vessel_map


class Bench:
    """A tracker that is shown rendered frames at 30 fps, unless told otherwise."""

    HEIGHT_UM = 11_720.0
    """The magnet's working height."""
    AWAY = StagePoint(60_000.0, -60_000.0, HEIGHT_UM)
    """A tip so far off that neither magnet nor needle is in the picture."""

    def __init__(self, um_per_image_px: float = 15.0) -> None:
        self.microscope, self.calibration = _rendered(um_per_image_px)
        self.tracker = Tracker(TrackerConfig(), self.calibration)
        self.number = 0
        self.last: ByteArray | None = None

    def show(self, robot: VesselPoint | None, tip: StagePoint = AWAY) -> Track:
        return self.feed(self.microscope.render(robot, tip))

    def feed(self, image: ByteArray) -> Track:
        self.last = image
        track = self.tracker.update(Frame(self.number, self.number / 30.0, image))
        self.number += 1
        return track

    def skip(self, frames: int) -> None:
        self.number += frames

    def error_px(self, track: Track, robot: VesselPoint) -> float:
        assert track.image is not None
        true = self.calibration.image_point(robot)
        return float(np.hypot(track.image.x_px - true.x_px, track.image.y_px - true.y_px))

    def tip_hiding(self, robot: VesselPoint) -> StagePoint:
        """Return the tip whose magnet appears right over the robot: parallax undone."""
        seen = self.calibration.image_point(robot)
        depth = self.calibration.working_distance_um
        shrink = (depth - self.HEIGHT_UM) / depth
        cx, cy = self.calibration.image_center_px
        flat = ImagePoint(cx + (seen.x_px - cx) * shrink, cy + (seen.y_px - cy) * shrink)
        x_um, y_um = self.calibration.stage_xy_um(self.calibration.vessel_point(flat))
        return StagePoint(x_um, y_um, self.HEIGHT_UM)


@cache
def _rendered(um_per_image_px: float) -> tuple[Microscope, Calibration]:
    """Return a microscope with the vessel in the middle of the picture; painting its floor takes a while."""
    mask = np.zeros((1800, 1800), np.uint8)
    branches = ([(300, 900), (1000, 900), (1500, 500)], [(1000, 900), (1450, 1300)], [(500, 900), (500, 300)])
    for branch in branches:
        cv2.polylines(mask, [np.array(branch, np.int32)], False, 255, 260)
    scale = 10.0 / um_per_image_px
    calibration = Calibration(
        image_from_vessel=Affine2.scale(scale, 800.0 - 900.0 * scale, 600.0 - 900.0 * scale),
        stage_from_vessel=Affine2.scale(10.0, 1000.0, 1000.0),
        um_per_px=10.0,
        floor_z_um=0.0,
        magnet_offset_um=(0.0, 0.0),
        critical_height_um=11_270.0,
    )
    vessel = vessel_map("bench", mask)
    microscope = Microscope(MicroscopeConfig(), PictureFormat(), Magnets(), vessel, calibration, seed=7)
    return microscope, calibration
