"""What a calibration sees: the robot by what is calibrated so far, and the tip at the raster's places."""

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray, FloatArray
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import Affine2, Calibration, ImagePoint, StagePoint
from mrnav_server.vision.calibration_parts import FloorPart, HeldOut, TipPart, WaterPart, assembled
from mrnav_server.vision.calibration_plan import Answer, CalibrationConfig, Pictures
from mrnav_server.vision.tip_fit import floor_z_um
from mrnav_server.vision.tip_silhouette import locate_tip, plain_background
from mrnav_server.vision.tracker import Tracker, TrackerConfig

_GRID_UM = 10.0
"""Grid of the provisional calibration by which the robot is seen; no vessel lies there yet."""


class RobotSight:
    """Sees the robot by what was calibrated so far, with a tracker of its own for every look.

    Args:
        floor, tip, water: What was calibrated.
        tracker: How the robot is recognised.

    Attributes:
        calibration: Provisional: no vessel, no offset, no critical height.
    """

    def __init__(self, floor: FloorPart, tip: TipPart, water: WaterPart, tracker: TrackerConfig) -> None:
        self.calibration: Calibration = assembled(
            floor,
            tip,
            Affine2.scale(_GRID_UM),
            _GRID_UM,
            1,
            floor_z_um=floor_z_um(tip.map, water.rise_um),
            offset_um=(0.0, 0.0),
            critical_height_um=1.0,
        )
        self._tracker = tracker

    def robot(self, seen: Answer) -> ImagePoint | None:
        """Return where the robot was seen last; None if the last picture does not show it."""
        tracker = Tracker(self._tracker, self.calibration)
        found = None
        for frame in pictures_of(seen).frames:
            found = tracker.update(frame).image
        return found

    def stage_um(self, robot: ImagePoint) -> tuple[float, float]:
        """Return the stage x, y right above the robot."""
        return self.calibration.stage_xy_um(self.calibration.vessel_point(robot))


def raster_points(config: CalibrationConfig) -> list[StagePoint]:
    """Return the 3 x 3 places at every height, the highest first, so that the tip never dives."""
    (cx, cy), half = config.raster_center_um, config.raster_span_um / 2.0
    return [
        StagePoint(cx + i * half, cy + j * half, z)
        for z in config.raster_z_um
        for j in (-1, 0, 1)
        for i in ((-1, 0, 1) if j != 0 else (1, 0, -1))
    ]


def held_out_points(config: CalibrationConfig) -> list[StagePoint]:
    """Return places between those of the raster, within 1 mm of the middle of its heights."""
    (cx, cy), half = config.raster_center_um, config.raster_span_um / 2.0
    z_um = 0.5 * (max(config.raster_z_um) + min(config.raster_z_um))
    places = [
        (-0.6, -0.5, 1000.0),
        (0.45, -0.7, 0.0),
        (-0.3, 0.35, -1000.0),
        (0.55, 0.6, 500.0),
        (-0.7, 0.7, -500.0),
    ]
    return [StagePoint(cx + x * half, cy + y * half, z_um + dz) for x, y, dz in places]


def located_tips(grays: list[ByteArray], tips: list[tuple[float, float, float]]) -> FloatArray:
    """Return where the tip was seen at many places, shape (n, 2), in pixels.

    Raises:
        RefusedError: If it was not seen at one of them.
    """
    background = plain_background(grays)
    found = []
    for gray, tip in zip(grays, tips, strict=True):
        point = locate_tip(gray, background)
        if point is None:
            raise RefusedError(
                "no_tip",
                f"the tip was not seen at stage ({tip[0]:.0f}, {tip[1]:.0f}, {tip[2]:.0f}) µm: move the"
                " raster into view (calibration.raster_center_um, raster_span_um), with even light",
            )
        found.append((point.x_px, point.y_px))
    return np.array(found)


def held_out_figures(misses_um: FloatArray) -> HeldOut:
    """Return the figures of distances in µm."""
    rms_um = float(np.sqrt(np.mean(misses_um**2)))
    return HeldOut(points=len(misses_um), rms_um=rms_um, max_um=float(misses_um.max()))


def pictures_of(answer: Answer) -> Pictures:
    """Return the pictures that a step was answered with.

    Raises:
        RefusedError: If it was answered with none.
    """
    if not isinstance(answer, Pictures) or not answer.frames:
        raise RefusedError("no_pictures", "this step is answered with pictures")
    return answer


def tip_at(answer: Answer, target: StagePoint) -> tuple[float, float, float]:
    """Return where the manipulator said that it was; where it was sent if it cannot tell."""
    tip = pictures_of(answer).tip or target
    return tip.x_um, tip.y_um, tip.z_um


def grays_of(answer: Answer) -> list[ByteArray]:
    """Return the pictures in gray, shape (height, width) each, uint8."""
    return [_gray(frame.image) for frame in pictures_of(answer).frames]


def mean_gray(answer: Answer) -> ByteArray:
    """Return the mean of the pictures in gray."""
    return np.asarray(np.mean(np.stack(grays_of(answer)), axis=0).round(), np.uint8)


def _gray(image: ByteArray) -> ByteArray:
    if image.ndim == 2:
        return image
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.uint8, copy=False)
