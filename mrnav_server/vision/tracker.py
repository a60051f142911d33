"""Tracks the robot from frame to frame: Kalman prediction, rim fit, re-detection when it is lost."""

from dataclasses import dataclass, fields

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import Calibration, ImagePoint
from mrnav_server.core.records import Frame, Track, TrackState
from mrnav_server.vision.kalman import PointFilter
from mrnav_server.vision.redetect import Redetector
from mrnav_server.vision.rim import RimEstimate, RimFit


@dataclass(frozen=True)
class TrackerConfig:
    """How the robot is recognised and followed.

    Attributes:
        robot_radius_um: The robot's radius in µm, 10..5000.
        confidence_min: Least confidence that is accepted, 0.3..1; a scene without a robot reaches 0.29.
        radius_tolerance: Share by which the fitted radius may differ from the known one, 0.01..0.2.
        edge_strength: Gray levels over two pixels at which the rim counts in full, 5..100.
        gate_um: How far from the prediction the robot may be, beyond four sigma, in µm, 1..2000.
        misses_to_lose: Rejected frames in a row after which the robot is lost, 1..30.
        good_to_acquire: Accepted frames in a row after which it is tracked, 1..100.
        speed_sigma_um_per_s: Standard deviation of a newly found robot's velocity in µm/s, 1..100000.
        acceleration_density_um2_per_s3: How unsteady the robot's velocity is, 1e3..1e10; 6e6 is a change
            of 450 µm/s within a frame at 30 fps.
        systematic_um: Error of a whole rim's centre that no noise explains (shadow, uneven light) in µm,
            0.01..100; it grows as the rim is hidden.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    robot_radius_um: float = 500.0
    confidence_min: float = 0.4
    radius_tolerance: float = 0.05
    edge_strength: float = 25.0
    gate_um: float = 60.0
    misses_to_lose: int = 3
    good_to_acquire: int = 10
    speed_sigma_um_per_s: float = 2000.0
    acceleration_density_um2_per_s3: float = 6e6
    systematic_um: float = 0.7

    def __post_init__(self) -> None:
        for field in fields(self):
            low, high = _RANGES[field.name]
            value = getattr(self, field.name)
            if not low <= value <= high:
                raise ConfigError(f"tracker {field.name} is {value}: set it to {low:g}..{high:g}")


_RANGES = {
    "robot_radius_um": (10, 5000),
    "confidence_min": (0.3, 1),
    "radius_tolerance": (0.01, 0.2),
    "edge_strength": (5, 100),
    "gate_um": (1, 2000),
    "misses_to_lose": (1, 30),
    "good_to_acquire": (1, 100),
    "speed_sigma_um_per_s": (1, 100_000),
    "acceleration_density_um2_per_s3": (1e3, 1e10),
    "systematic_um": (0.01, 100),
}


class Tracker:
    """Follows one robot: SEARCHING -> ACQUIRING -> TRACKING, and back when it is lost.

    A frame is rejected when the rim's confidence or radius is wrong, or when it lies outside the gate
    around the prediction. After ``misses_to_lose`` of them in a row the robot is lost and each frame is
    searched as a whole. A frame that repeats the one before bit for bit is a miss too: noise alone makes
    two true pictures differ.

    Args:
        config: How the robot is recognised.
        calibration: Where the vessel appears in the image.
    """

    def __init__(self, config: TrackerConfig, calibration: Calibration) -> None:
        affine = calibration.image_from_vessel
        scale = float(np.sqrt(abs(affine.a * affine.d - affine.b * affine.c)))
        self._config = config
        self._calibration = calibration
        self._um_per_px = calibration.um_per_px / scale
        self._filter: PointFilter | None
        self._sample: ByteArray | None
        self._rim = RimFit(
            config.robot_radius_um / self._um_per_px,
            config.edge_strength,
            config.systematic_um / self._um_per_px,
        )
        self._redetector = Redetector(self._rim, config.radius_tolerance)
        self.reset()

    def reset(self) -> None:
        """Forget the robot; the next frame is searched as a whole."""
        self._lose()
        self._taken_s = -np.inf
        self._sample = None

    def update(self, frame: Frame) -> Track:
        """Return what a frame shows of the robot; frames come in order of their capture time."""
        is_new = self._is_new(frame.image)
        if self._filter is not None:
            self._filter.predict(max(frame.taken_s - self._taken_s, 0.0))
        self._taken_s = frame.taken_s
        found = None
        if is_new:
            found = (
                self._search(frame.image) if self._filter is None else self._follow(frame.image, self._filter)
            )
        if found is None:
            self._miss()
        else:
            self._accept(found)
        return self._track(frame, found)

    def _is_new(self, image: ByteArray) -> bool:
        """Tell whether a picture differs from the one before, by a sparse sample."""
        sample = image[7::101, 3::7, 1].copy()
        before, self._sample = self._sample, sample
        return before is None or not np.array_equal(sample, before)

    def _search(self, image: ByteArray) -> RimEstimate | None:
        found = self._redetector.find(image)
        return found if found is not None and found.confidence >= self._config.confidence_min else None

    def _follow(self, image: ByteArray, filtered: PointFilter) -> RimEstimate | None:
        x_px, y_px = filtered.position_px
        half = self._rim.radius_px + 2.0 * self._rim.reach_px + 2.0
        height, width = image.shape[:2]
        if not (0.0 <= x_px < width and 0.0 <= y_px < height):
            return None
        left, top = max(0, int(x_px - half)), max(0, int(y_px - half))
        region = image[top : int(y_px + half) + 1, left : int(x_px + half) + 1]
        gray = cv2.cvtColor(region, cv2.COLOR_BGR2GRAY).astype(np.uint8, copy=False)
        local = self._rim.fit(gray, x_px - left, y_px - top)
        off_px = float(np.hypot(local.x_px + left - x_px, local.y_px + top - y_px))
        good = (
            local.confidence >= self._config.confidence_min
            and abs(local.radius_px - self._rim.radius_px)
            <= self._config.radius_tolerance * self._rim.radius_px
            and off_px <= self._config.gate_um / self._um_per_px + 4.0 * filtered.sigma_px
        )
        if not good:
            return None
        return RimEstimate(
            local.x_px + left, local.y_px + top, local.radius_px, local.confidence, local.sigma_px
        )

    def _accept(self, found: RimEstimate) -> None:
        if self._filter is None:
            self._filter = PointFilter(
                (found.x_px, found.y_px),
                found.sigma_px,
                self._config.speed_sigma_um_per_s / self._um_per_px,
                self._config.acceleration_density_um2_per_s3 / self._um_per_px**2,
            )
            self._state = TrackState.ACQUIRING
        else:
            self._filter.correct((found.x_px, found.y_px), found.sigma_px)
        self._misses = 0
        self._good += 1
        if self._good >= self._config.good_to_acquire:
            self._state = TrackState.TRACKING

    def _miss(self) -> None:
        self._good = 0
        self._misses += 1
        if self._misses >= self._config.misses_to_lose:
            self._lose()

    def _lose(self) -> None:
        self._filter = None
        self._state = TrackState.SEARCHING
        self._misses = 0
        self._good = 0

    def _track(self, frame: Frame, found: RimEstimate | None) -> Track:
        image = None if found is None or self._filter is None else ImagePoint(*self._filter.position_px)
        sigma_px = self._rim.radius_px if self._filter is None else self._filter.sigma_px
        return Track(
            taken_s=frame.taken_s,
            frame_number=frame.number,
            state=self._state,
            image=image,
            vessel=None if image is None else self._calibration.vessel_point(image),
            confidence=0.0 if found is None else found.confidence,
            sigma_um=sigma_px * self._um_per_px,
            good_frames=self._good,
        )
