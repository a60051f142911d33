"""What a calibration does, in numbers, and the steps that it asks for."""

from dataclasses import dataclass, field, fields

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.records import Frame
from mrnav_server.vision.charuco import SheetConfig

_RANGES = {
    "water_depth_um": (0.0, 20_000.0),
    "water_index": (1.0, 1.6),
    "raster_span_um": (2000.0, 50_000.0),
    "travel_z_um": (0.0, 100_000.0),
    "speed_um_per_s": (10.0, 5000.0),
    "descent_speed_um_per_s": (10.0, 1000.0),
    "descent_step_um": (5.0, 500.0),
    "descent_to_z_um": (0.0, 100_000.0),
    "height_factor": (1.0, 1.2),
    "approaches": (4, 16),
    "approach_run_um": (500.0, 10_000.0),
    "approach_speed_um_per_s": (100.0, 3000.0),
    "settle_s": (0.0, 10.0),
    "sheet_pictures": (1, 50),
    "pictures": (1, 20),
}


@dataclass(frozen=True, slots=True)
class CalibrationConfig:
    """How the guided calibration moves and looks.

    Attributes:
        sheet: The calibration sheet.
        water_depth_um: Water over the robot's centre in µm, 0..20000; the tip's raster stays above it.
        water_index: Refractive index of the water, 1..1.6.
        raster_center_um: Stage x, y over the middle of the picture.
        raster_span_um: Side of the square that the tip visits in µm, 2000..50000; all of it in view.
        raster_z_um: Stage z of the raster's heights, falling; the working height lies between them.
        travel_z_um: Stage z at which the tip travels, where no robot can jump, in µm.
        speed_um_per_s: Speed of travel, 10..5000.
        descent_speed_um_per_s: Speed of lowering, 10..1000.
        descent_step_um: Step of the search for the critical height in µm, 5..500.
        descent_to_z_um: Stage z below which the search is given up, in µm.
        rough_offset_um: Where the tip stands over a robot that it holds, stage x, y in µm, to about 500 µm:
            a sixth of the height towards the needle's shank if it leans by 45°, nothing if it is upright.
        height_factor: Working height over the critical height, 1..1.2.
        approaches: Directions from which the magnet comes, 4..16.
        approach_run_um: Length of an approach in µm, 500..10000.
        approach_speed_um_per_s: Its speed, 100..3000.
        settle_s: Rest before pictures are taken, in s, 0..10.
        sheet_pictures: Pictures of the sheet, 1..50.
        pictures: Pictures of tip or robot at each place, 1..20.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    sheet: SheetConfig = field(default_factory=SheetConfig)
    water_depth_um: float = 0.0
    water_index: float = 1.333
    raster_center_um: tuple[float, float] = (10_000.0, 10_000.0)
    raster_span_um: float = 7000.0
    raster_z_um: tuple[float, ...] = (16_000.0, 12_500.0, 9000.0)
    travel_z_um: float = 16_000.0
    speed_um_per_s: float = 2000.0
    descent_speed_um_per_s: float = 500.0
    descent_step_um: float = 50.0
    descent_to_z_um: float = 8000.0
    rough_offset_um: tuple[float, float] = (1800.0, -480.0)
    height_factor: float = 1.04
    approaches: int = 4
    approach_run_um: float = 2500.0
    approach_speed_um_per_s: float = 1000.0
    settle_s: float = 0.5
    sheet_pictures: int = 10
    pictures: int = 3

    def __post_init__(self) -> None:
        for entry in fields(self):
            if entry.name not in _RANGES:
                continue
            low, high = _RANGES[entry.name]
            value = getattr(self, entry.name)
            if not low <= value <= high:
                raise ConfigError(
                    f"calibration.{entry.name} is {value:g}; choose it within {low:g}..{high:g}"
                )
        if len(self.raster_z_um) < 2 or any(
            upper <= lower for upper, lower in zip(self.raster_z_um, self.raster_z_um[1:], strict=False)
        ):
            raise ConfigError("calibration.raster_z_um takes two or more heights, the highest first")
        if self.travel_z_um < max(self.raster_z_um):
            raise ConfigError("calibration.travel_z_um is below the raster: travel above it")


@dataclass(frozen=True, slots=True)
class Step:
    """Something that is to be done next.

    Attributes:
        stage: floor, tip, height or magnet.
        text: What is to be done, for a person.
        share: How much of the stage is done, 0..1.
    """

    stage: str
    text: str
    share: float


@dataclass(frozen=True, slots=True)
class Prepare(Step):
    """A person changes the bench; answered with None.

    Attributes:
        scene: What is to lie under the camera: sheet, plate (nothing on it) or robot (on the plate).
    """

    scene: str


@dataclass(frozen=True, slots=True)
class MoveTip(Step):
    """The tip goes somewhere and comes to rest; answered with None."""

    target: StagePoint
    speed_um_per_s: float


@dataclass(frozen=True, slots=True)
class TakePictures(Step):
    """Pictures of the bench at rest; answered with ``Pictures``."""

    count: int
    settle_s: float


@dataclass(frozen=True, slots=True)
class Pictures:
    """What was seen, and where the manipulator said that its tip was."""

    frames: tuple[Frame, ...]
    tip: StagePoint | None


Answer = Pictures | None
