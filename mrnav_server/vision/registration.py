"""The vessel model onto the picture: where the vessel lies, how well that is known, and whether to use it.

Rough first (``registration_search``), then exact (``registration_fit``), then judged here.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from mrnav_server.core.arrays import BoolArray, ByteArray, Float32Array, FloatArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import Calibration
from mrnav_server.core.vessel import VesselMap
from mrnav_server.vision.calibration_parts import VesselPose
from mrnav_server.vision.registration_fit import Fit, fit, old_from_new
from mrnav_server.vision.registration_search import Candidate, search
from mrnav_server.vision.walls import Walls, gray_at, image_px

_WALL_UM = 150.0
_OVERLAP_STEP_UM = 40.0
_NEAR_WALL_UM = 150.0
"""Nearer to the wall gray levels belong to neither side."""
_AROUND_UM = 1500.0
"""Lumen and tissue are compared with what they are like within about this distance."""
_LEAST_CONTRAST = 6.0
"""Gray levels between lumen and tissue under which only the walls tell them apart."""
_BEYOND = 0.5
"""What is beyond both by so much of their contrast is neither: the robot, the line along the wall."""
_LUMEN = 0.3
"""Where lumen begins between tissue (0) and lumen (1): tissue is even, the lumen lies in its walls' shade."""
_SAME_UM = 100.0
_AS_GOOD = 0.95
"""A rival that finds so much of the wall that the best one finds is as good."""
_NO_TURN = 0.9
"""A direction that is a turn by more than this is told as one."""


@dataclass(frozen=True, slots=True)
class RegistrationConfig:
    """How far off the vessel may lie, and what counts as found.

    Attributes:
        reach_um: Largest shift that is looked for, along x and along y, in µm, 100..5000.
        turn_deg: Largest turn, in °, 1..15.
        overlap_min: A pose with a smaller overlap of seen and modelled lumen is refused, 0.5..1.
        wall_share_min: ... and one by which a smaller share of the walls in the picture is found, 0.3..1.
        residual_max_um: ... and one that leaves walls further than this from the model (rms), in µm, 5..200.
        sigma_max_um: ... and one that leaves more doubt (one standard deviation), in µm, 5..200.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    reach_um: float = 2500.0
    turn_deg: float = 7.0
    overlap_min: float = 0.8
    wall_share_min: float = 0.5
    residual_max_um: float = 40.0
    sigma_max_um: float = 30.0

    def __post_init__(self) -> None:
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigError(f"registration.{name} is {value:g}; choose it within {low:g}..{high:g}")


_RANGES = {
    "reach_um": (100, 5000),
    "turn_deg": (1, 15),
    "overlap_min": (0.5, 1),
    "wall_share_min": (0.3, 1),
    "residual_max_um": (5, 200),
    "sigma_max_um": (5, 200),
}


@dataclass(frozen=True, slots=True)
class Registration:
    """Where the vessel lies, and how sure that is.

    Attributes:
        pose: The grid's middle and turn, relative to where the calibration had it.
        scale: Size of the model in the picture over what it was supposed to be; 1 if that was not asked.
        overlap: Dice coefficient of the lumen that is seen and the lumen of the model, 0..1. Where both
            look alike and only walls are seen, the share of the walls that was found.
        overlap_by: Which of the two.
        wall_share: Share of the walls within the picture that was found, 0..1: the confidence.
        residual_um: Root mean square distance of seen walls to the model's.
        sigma_um: Standard deviation of the walls' place in the direction that is known least; what shading
            does to all walls alike is not in it.
        reason: Why the pose must not be used; "" if it may.
    """

    pose: VesselPose
    scale: float
    overlap: float
    overlap_by: Literal["lumen", "wall"]
    wall_share: float
    residual_um: float
    sigma_um: float
    reason: str

    @property
    def accepted(self) -> bool:
        """Whether the pose may be used."""
        return not self.reason


def register(
    picture: ByteArray,
    calibration: Calibration,
    vessel: VesselMap,
    config: RegistrationConfig,
    scales: tuple[float, ...] = (),
) -> Registration:
    """Find a vessel in a picture.

    Args:
        picture: BGR or gray, uint8; the median of some frames if something moves (``still``).
        calibration: Where the model is supposed to lie.
        vessel: The model.
        config: Reach and thresholds.
        scales: Sizes to try, relative to the supposed one; then the size is found, too.

    Returns:
        The pose, with the reason if it is refused.
    """
    half_um = vessel.size_px * vessel.um_per_px / 2.0
    walls = Walls.of(vessel, _WALL_UM)
    starts = search(picture, calibration, vessel, config.reach_um, config.turn_deg, scales or (1.0,))
    fits = [fit(picture, calibration, vessel, walls, start, free_scale=bool(scales)) for start in starts]
    found = sorted((f for f in fits if f is not None), key=lambda f: -_evidence(f))
    if not found:
        return Registration(
            VesselPose(), 1.0, 0.0, "wall", 0.0, 0.0, 0.0, "the vessel's walls are not in the picture"
        )
    best = found[0]
    dice = overlap(picture, calibration, vessel, best.pose)
    pose = VesselPose(x_um=best.pose.x_um, y_um=best.pose.y_um, angle_deg=best.pose.turn_deg)
    return Registration(
        pose=pose,
        scale=best.pose.scale,
        overlap=best.wall_share if dice is None else dice,
        overlap_by="wall" if dice is None else "lumen",
        wall_share=best.wall_share,
        residual_um=best.residual_um,
        sigma_um=best.sigma_um,
        reason=_refusal(best, dice, config, half_um) or _ambiguity(found, half_um),
    )


def judge(
    picture: ByteArray, calibration: Calibration, vessel: VesselMap, pose: VesselPose
) -> tuple[float, Literal["lumen", "wall"]]:
    """Return the overlap at a pose that somebody chose, and by what it is measured (``Registration``)."""
    chosen = Candidate(pose.x_um, pose.y_um, pose.angle_deg, 1.0, 0.0)
    dice = overlap(picture, calibration, vessel, chosen)
    if dice is not None:
        return dice, "lumen"
    found = fit(picture, calibration, vessel, Walls.of(vessel, _WALL_UM), chosen, free_scale=False)
    return (found.wall_share if found else 0.0), "wall"


def still(frames: Sequence[ByteArray]) -> ByteArray:
    """Return the median of frames, shape as theirs; what moves and noise vanish from it."""
    return np.asarray(np.median(np.stack(frames), axis=0), np.uint8)


def registered(
    calibration: Calibration, vessel: VesselMap, pose: VesselPose, scale: float = 1.0
) -> Calibration:
    """Return the calibration for a vessel that lies elsewhere than this one says, or is of another size."""
    lies = Candidate(pose.x_um, pose.y_um, pose.angle_deg, scale, 0.0)
    return calibration.registered(old_from_new(vessel, lies))


def outline_px(calibration: Calibration, vessel: VesselMap, step_um: float = 200.0) -> list[FloatArray]:
    """Return the model's walls in the image as closed lines, each of shape (n, 2), in pixels."""
    contours, _ = cv2.findContours(vessel.lumen.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    stride = max(1, round(step_um / vessel.um_per_px))
    return [image_px(calibration, line[::stride, 0].astype(np.float64)) for line in contours]


def overlap(picture: ByteArray, calibration: Calibration, vessel: VesselMap, pose: Candidate) -> float | None:
    """Return the Dice coefficient of the lumen in the picture and in the model; None if they look alike.

    A pixel belongs to whichever of lumen and tissue it resembles as they are around it; what resembles
    neither (robot, magnet, needle) or lies outside the picture is not counted.
    """
    step = max(1, round(_OVERLAP_STEP_UM / vessel.um_per_px))
    axis = np.arange(step // 2, vessel.size_px, step, dtype=np.float64)
    grid = np.stack(np.meshgrid(axis, axis), -1)
    rows = np.array(old_from_new(vessel, pose).rows())
    at_px = image_px(calibration, grid @ rows[:, :2].T + rows[:, 2])
    soft = cv2.GaussianBlur(picture, (0, 0), 1.5).astype(np.uint8)
    gray = gray_at(soft, at_px)
    seen = np.isfinite(gray)
    gray = np.where(seen, gray, np.float32(0.0))
    distance_um = vessel.distance_px[step // 2 :: step, step // 2 :: step] * vessel.um_per_px
    model = distance_um > 0
    # Light falls off towards the picture's corners on both alike, so lumen is a multiple of tissue.
    tissue = _level_around(gray, seen & (distance_um < -_NEAR_WALL_UM))
    inner = seen & (distance_um > _NEAR_WALL_UM) & np.isfinite(tissue)
    counted = seen & np.isfinite(tissue) & (distance_um > -_AROUND_UM)
    if not inner.any():
        return None
    gain = float(np.median(gray[inner] / np.maximum(tissue[inner], 1.0))) - 1.0
    if abs(gain) * float(np.median(tissue[counted])) < _LEAST_CONTRAST:
        return None
    place = np.where(counted, gray / np.maximum(tissue, 1.0) - 1.0, 0.0) / gain
    hidden = (place < -_BEYOND) | (place > 1.0 + _BEYOND)
    counted &= ~hidden
    bright = place > _LUMEN
    both = float((bright & model & counted).sum())
    return 2.0 * both / max(float((bright & counted).sum() + (model & counted).sum()), 1.0)


def _level_around(gray: Float32Array, mask: BoolArray) -> Float32Array:
    """Return the mean gray level of a region around each place; NaN where there is none."""
    sigma = _AROUND_UM / _OVERLAP_STEP_UM
    weight = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), sigma)
    total = cv2.GaussianBlur(gray * mask, (0, 0), sigma)
    level: Float32Array = np.where(weight > 1e-4, total / np.maximum(weight, 1e-4), np.float32(np.nan))
    return level


def _evidence(found: Fit) -> float:
    """Return how much wall was found, as a share of all walls."""
    return found.wall_share * found.seen


def _refusal(best: Fit, dice: float | None, config: RegistrationConfig, half_um: float) -> str:
    x_um, y_um, turn_deg = best.pose.x_um, best.pose.y_um, best.pose.turn_deg
    if not best.determined or best.sigma_um > config.sigma_max_um:
        return f"{_undetermined(best)}; its ends or a junction must be in the picture"
    if best.wall_share < config.wall_share_min:
        return (
            f"only {best.wall_share:.0%} of the walls in the picture are found,"
            f" {config.wall_share_min:.0%} are needed: is it this vessel, in focus and not covered?"
        )
    if dice is not None and dice < config.overlap_min:
        return (
            f"seen and modelled lumen overlap by {dice:.2f}, {config.overlap_min:g} is needed:"
            " is it this vessel?"
        )
    if best.residual_um > config.residual_max_um:
        return (
            f"the walls lie {best.residual_um:.0f} µm (rms) from the model's,"
            f" {config.residual_max_um:g} are allowed: the vessel is deformed, or the calibration is off"
        )
    if max(abs(x_um), abs(y_um)) > config.reach_um + _SAME_UM or abs(turn_deg) > config.turn_deg + 0.5:
        return (
            f"it would lie {math.hypot(x_um, y_um) / 1000:.1f} mm off and turned by {turn_deg:.1f}°: bring"
            f" it within {config.reach_um / 1000:g} mm and {config.turn_deg:g}°"
        )
    return ""


def _undetermined(best: Fit) -> str:
    x, y, turn = best.loose
    if abs(turn) > _NO_TURN:
        return "how the vessel is turned is not determined by what is seen of it"
    angle = math.degrees(math.atan2(y, x)) % 180.0
    return (
        f"the vessel may slide along itself: its place along {angle:.0f}° (from x towards y) is not"
        " determined"
    )


def _ambiguity(found: list[Fit], half_um: float) -> str:
    best = found[0]
    for rival in found[1:]:
        away_um = best.pose.apart_um(rival.pose, half_um)
        if away_um > _SAME_UM and rival.wall_share > _AS_GOOD * best.wall_share:
            dx, dy = rival.pose.x_um - best.pose.x_um, rival.pose.y_um - best.pose.y_um
            return (
                f"the vessel may as well lie {math.hypot(dx, dy) / 1000:.1f} mm further along"
                f" {math.degrees(math.atan2(dy, dx)) % 360.0:.0f}° (from x towards y), turned by"
                f" {rival.pose.turn_deg - best.pose.turn_deg:.1f}°: set its place by hand"
            )
    return ""
