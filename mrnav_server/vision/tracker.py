"""Tracks the robot from frame to frame: Kalman prediction, a detector where it is expected, gate, states."""

import math
from dataclasses import dataclass, fields
from typing import Literal

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import Calibration, ImagePoint
from mrnav_server.core.records import Frame, Track, TrackState
from mrnav_server.vision.detector import Detector, Sighting
from mrnav_server.vision.frame_watch import PictureWatch
from mrnav_server.vision.kalman import PointFilter
from mrnav_server.vision.moving_shape import MovingShapeDetector
from mrnav_server.vision.rim import Polarity, RimFit
from mrnav_server.vision.sphere import SphereDetector


@dataclass(frozen=True)
class TrackerConfig:
    """How the robot is recognised and followed.

    Attributes:
        detector: ``"sphere"`` fits the rim of a disc of known radius; ``"moving-shape"`` sees any shape that
            differs from a background that it learns, such as a helix or a swarm, less exactly.
        polarity: Whether the robot is darker or brighter than what surrounds it.
        robot_radius_um: The robot's radius, or that of the smallest circle round it, in µm, 10..5000;
            ``vision.measure`` measures it in a picture.
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
        learning_frames: Pictures from which ``"moving-shape"`` learns its background, 1..1000.
        darkest_gray: A picture with hardly a pixel this bright is black and not believed, in gray levels,
            0..100; set it to 0 if the background is black by design.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    detector: Literal["sphere", "moving-shape"] = "sphere"
    polarity: Polarity = "dark"
    robot_radius_um: float = 500.0
    confidence_min: float = 0.4
    radius_tolerance: float = 0.05
    edge_strength: float = 25.0
    gate_um: float = 60.0
    misses_to_lose: int = 3
    good_to_acquire: int = 10
    speed_sigma_um_per_s: float = 2000.0
    acceleration_density_um2_per_s3: float = 6e6
    systematic_um: float = 0.45
    learning_frames: int = 30
    darkest_gray: float = 12.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in _CHOICES:
                if value not in _CHOICES[field.name]:
                    raise ConfigError(
                        f"tracker {field.name} is {value!r}: set it to {' or '.join(_CHOICES[field.name])}"
                    )
                continue
            low, high = _RANGES[field.name]
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
    "learning_frames": (1, 1000),
    "darkest_gray": (0, 100),
}
_CHOICES = {"detector": ("sphere", "moving-shape"), "polarity": ("dark", "bright")}


class Tracker:
    """Follows one robot: SEARCHING -> ACQUIRING -> TRACKING, and back when it is lost.

    A frame is rejected when the detector does not see the robot where it is expected, when it is not
    confident, or when the robot lies outside the gate around the prediction. After ``misses_to_lose`` of
    them in a row the robot is lost and each frame is searched as a whole. A frozen or black picture is a
    miss too, and no detector sees it.

    Args:
        config: How the robot is recognised.
        calibration: Where the vessel appears in the image.
        detector: Sees the robot; None for the one that ``config.detector`` names.
        live: Whether the pictures are a camera's, which is frozen when they repeat; those of a film do where
            it was compressed.
    """

    def __init__(
        self,
        config: TrackerConfig,
        calibration: Calibration,
        detector: Detector | None = None,
        *,
        live: bool = True,
    ) -> None:
        self._config = config
        self._calibration = calibration
        self._um_per_px = calibration.um_per_px / calibration.image_from_vessel.linear_scale
        self._filter: PointFilter | None
        self._detector = detector or _detector(config, self._um_per_px)
        self._pictures = PictureWatch(config.darkest_gray) if live else None
        self.reset()

    def recalibrate(self, calibration: Calibration) -> None:
        """Go by another calibration from the next frame on; any thread may ask. The image stays the same."""
        self._calibration = calibration

    def reset(self) -> None:
        """Forget the robot; the next frame is searched as a whole."""
        self._lose()
        self._taken_s = -math.inf

    def update(self, frame: Frame) -> Track:
        """Return what a frame shows of the robot; frames come in order of their capture time."""
        believed = self._pictures is None or not self._pictures.fault(frame.image)
        if self._filter is not None:
            self._filter.predict(max(frame.taken_s - self._taken_s, 0.0))
        self._taken_s = frame.taken_s
        found = self._look(frame) if believed else None
        if found is None:
            self._miss()
        else:
            self._accept(found)
        return self._track(frame, found)

    def _look(self, frame: Frame) -> Sighting | None:
        """Return the robot if this frame shows it beyond doubt."""
        if self._filter is None:
            found = self._detector.find(frame.image)
            off_px = gate_px = 0.0
        else:
            x_px, y_px = self._filter.position_px
            found = self._detector.follow(frame.image, ImagePoint(x_px, y_px))
            off_px = 0.0 if found is None else math.hypot(found.x_px - x_px, found.y_px - y_px)
            gate_px = self._config.gate_um / self._um_per_px + 4.0 * self._filter.sigma_px
        if found is None or found.confidence < self._config.confidence_min or off_px > gate_px:
            return None
        return found

    def _accept(self, found: Sighting) -> None:
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

    def _track(self, frame: Frame, found: Sighting | None) -> Track:
        image = None if found is None or self._filter is None else ImagePoint(*self._filter.position_px)
        sigma_px = self._detector.radius_px if self._filter is None else self._filter.sigma_px
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


def _detector(config: TrackerConfig, um_per_px: float) -> Detector:
    """Return the detector that the settings name."""
    radius_px = config.robot_radius_um / um_per_px
    if config.detector == "moving-shape":
        return MovingShapeDetector(radius_px, config.edge_strength, config.polarity, config.learning_frames)
    rim = RimFit(radius_px, config.edge_strength, config.systematic_um / um_per_px, config.polarity)
    return SphereDetector(rim, config.radius_tolerance)
