"""The parts of a calibration as they are kept: pydantic models, every number with its unit."""

import math
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from mrnav_server.core.camera_map import FloorMap, TipMap
from mrnav_server.core.frames import Affine2, Calibration
from mrnav_server.core.vessel import VesselMap
from mrnav_server.vision import tip_fit

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0)]
Pair = tuple[Finite, Finite]


class Part(BaseModel):
    """Something that is kept: immutable, and without unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Figures(Part):
    """Residuals of a fit, in µm on the floor (``vision.residuals.Residuals``)."""

    points: Count
    rejected: Count
    parameters: Count
    rms_um: NotNegative
    max_um: NotNegative
    leave_one_out_um: NotNegative
    leave_one_out_max_um: NotNegative


class CameraPart(Part):
    """The pictures that the calibration holds for."""

    width_px: Count
    height_px: Count


class WaterPart(Part):
    """The water over the robot's centre while the calibration was made."""

    depth_um: NotNegative
    index: Annotated[float, Field(ge=1.0, le=2.0)]

    @property
    def rise_um(self) -> float:
        """How far the water lifts the floor for an eye above it."""
        return self.depth_um * (1.0 - 1.0 / self.index)


class FloorPart(Part):
    """Image pixels from floor µm; the floor's origin is where the sheet's centre lay."""

    homography: Annotated[tuple[Finite, ...], Field(min_length=9, max_length=9)]
    center_px: Pair
    radial: Finite
    radius_px: Positive
    square_um: Positive
    coverage: NotNegative
    edge_sigma_um: NotNegative
    residuals: Figures

    @property
    def map(self) -> FloorMap:
        """The map."""
        return FloorMap(self.homography, self.center_px, self.radial, self.radius_px)


class HeldOut(Part):
    """The tip at places that nothing was fitted to."""

    points: Count
    rms_um: NotNegative
    max_um: NotNegative


class TipPart(Part):
    """Floor µm that the tip hides, from stage µm."""

    matrix: Annotated[tuple[Finite, ...], Field(min_length=6, max_length=6)]
    offset_um: Pair
    camera_z_um: Finite
    heights_z_um: tuple[Finite, ...]
    residuals: Figures
    held_out: HeldOut

    @property
    def map(self) -> TipMap:
        """The map."""
        return TipMap(self.matrix, self.offset_um, self.camera_z_um)


class HeightPart(Part):
    """The critical height and the floor's plane."""

    floor_z_um: Finite
    critical_height_um: Positive
    step_um: NotNegative
    jump_z_um: Finite


class MagnetPart(Part):
    """The magnet's offset and the robot's friction, at the height at which they were found."""

    offset_um: Pair
    friction_lead_um: NotNegative
    approaches: Count
    rms_um: NotNegative
    height_um: Positive


class VesselPose(Part):
    """Where the middle of the vessel model's grid lies on the floor, and how the grid is turned."""

    x_um: Finite = 0.0
    y_um: Finite = 0.0
    angle_deg: Finite = 0.0

    def floor_from_vessel(self, vessel: VesselMap) -> Affine2:
        """Return floor µm from the vessel's grid pixels."""
        turn, um, half = math.radians(self.angle_deg), vessel.um_per_px, vessel.size_px / 2.0
        a, c = um * math.cos(turn), um * math.sin(turn)
        return Affine2(a, -c, c, a, self.x_um - half * (a - c), self.y_um - half * (a + c))


class Draft(Part):
    """What has been measured so far; each part builds on those before it."""

    camera: CameraPart
    water: WaterPart
    floor: FloorPart | None = None
    tip: TipPart | None = None
    height: HeightPart | None = None
    magnet: MagnetPart | None = None


def assembled(
    floor: FloorPart,
    tip: TipPart,
    floor_from_vessel: Affine2,
    um_per_px: float,
    size_px: int,
    *,
    floor_z_um: float,
    offset_um: tuple[float, float],
    critical_height_um: float,
) -> Calibration:
    """Put measured parts together for a vessel grid of ``size_px`` that lies somewhere on the floor."""
    pixels = floor.map.after(np.array(floor_from_vessel.rows()))
    return Calibration(
        image_from_vessel=Affine2.of_rows(pixels.best_affine(size_px)),
        stage_from_vessel=tip_fit.stage_from_floor(tip.map).after(floor_from_vessel),
        um_per_px=um_per_px,
        floor_z_um=floor_z_um,
        magnet_offset_um=offset_um,
        critical_height_um=critical_height_um,
        working_distance_um=tip.camera_z_um - floor_z_um,
        image_center_px=floor.center_px,
        floor=pixels,
        tip=tip.map.then(np.array(floor_from_vessel.inverse().rows())),
    )
