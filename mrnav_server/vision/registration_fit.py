"""A pose made exact: one profile is sought across every wall, and least squares moves the model to it."""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from mrnav_server.core.arrays import BoolArray, ByteArray, Float32Array, FloatArray
from mrnav_server.core.frames import Affine2, Calibration
from mrnav_server.core.vessel import VesselMap
from mrnav_server.vision.registration_search import Candidate
from mrnav_server.vision.walls import Walls, best_shift, gray_at, image_px

_STEP_UM = 15.0
_PATTERN_UM = 150.0
"""Half of the profile that is compared."""
_FIRST_SEARCH_UM = 240.0
"""How far to either side of the wall it is sought, at first and in the end."""
_LAST_SEARCH_UM = 120.0
_CONTRAST_UM = 60.0
_ROUNDS = 10
_LEAST_MATCH = 0.6
"""A profile that resembles the median one less is hidden, or no wall."""
_LEAST_SIGMA_UM = 8.0
_FOUND_UM = 100.0
"""A wall further from the model's is not found."""
_INDEPENDENT_UM = 500.0
"""Errors of the wall's shape and light are alike over this length, so that it counts as one point."""
_LOOSE = 0.01
"""A direction that so small a share of the walls holds is not determined by them."""


@dataclass(frozen=True)
class Fit:
    """A model on a picture's walls.

    Attributes:
        pose: Where the model lies.
        residual_um: Root mean square distance of walls to the model, along their normals.
        wall_share: Share of the walls within the picture that were found.
        seen: Share of all walls that lie within the picture.
        sigma_um: Standard deviation of the walls' place in the direction that is known least.
        loose: That direction: shift x, shift y and turn (at the grid's edge), a unit vector.
        determined: Whether the walls hold it.
    """

    pose: Candidate
    residual_um: float
    wall_share: float
    seen: float
    sigma_um: float
    loose: tuple[float, float, float]
    determined: bool


def old_from_new(vessel: VesselMap, pose: Candidate) -> Affine2:
    """Return where grid pixels lie in the grid that was supposed."""
    turn, half = math.radians(pose.turn_deg), vessel.size_px / 2.0
    a, c = pose.scale * math.cos(turn), pose.scale * math.sin(turn)
    x_px, y_px = pose.x_um / vessel.um_per_px, pose.y_um / vessel.um_per_px
    return Affine2(a, -c, c, a, half - half * (a - c) + x_px, half - half * (a + c) + y_px)


def fit(
    picture: ByteArray,
    calibration: Calibration,
    vessel: VesselMap,
    walls: Walls,
    start: Candidate,
    *,
    free_scale: bool,
) -> Fit | None:
    """Return the exact pose near a rough one; None if there are too few walls in the picture.

    The profile is the median of what the picture itself shows, so no assumption is made of lumen or
    lighting. What shifts all walls alike along their normals is taken out: it is no motion of the model.
    """
    pose, half_um = start, vessel.size_px * vessel.um_per_px / 2.0
    for index in range(_ROUNDS):
        rough = index < _ROUNDS // 2
        search_um = _FIRST_SEARCH_UM if rough else _LAST_SEARCH_UM
        reach = round((_PATTERN_UM + search_um) / _STEP_UM)
        offsets_um = np.arange(-reach, reach + 1) * _STEP_UM
        rows = np.array(old_from_new(vessel, pose).rows())
        grid_px = walls.across(offsets_um / pose.scale, vessel.um_per_px) @ rows[:, :2].T + rows[:, 2]
        profiles = gray_at(picture, image_px(calibration, grid_px))
        inside = np.isfinite(profiles).all(axis=1)
        if inside.sum() < 30:
            return None
        cut = round(search_um / _STEP_UM)
        centred = profiles[:, cut:-cut]
        if rough:
            # Too far off for a common profile: a wall is where most contrast is.
            bump = np.exp(-0.5 * (offsets_um[cut:-cut] / _CONTRAST_UM) ** 2).astype(np.float32)
            shift_um, match = best_shift(_contrast(profiles), bump, _STEP_UM)
        else:
            usual = np.median(centred[inside] - centred[inside].mean(axis=1, keepdims=True), axis=0)
            shift_um, match = best_shift(profiles, usual, _STEP_UM)
        normals = walls.normals @ (rows[:, :2] / pose.scale).T
        arm_um = (grid_px[:, reach] - vessel.size_px / 2.0) * vessel.um_per_px
        arm_um = arm_um - (pose.x_um, pose.y_um)
        good = inside & (match > _LEAST_MATCH)
        if good.sum() < 15:
            return None
        step = _solve(normals, arm_um / half_um, shift_um, good, free_scale=free_scale)
        dx, dy, turn, grow = step.move
        pose = replace(
            pose,
            x_um=pose.x_um + dx,
            y_um=pose.y_um + dy,
            turn_deg=pose.turn_deg + math.degrees(turn / half_um),
            scale=pose.scale * (1.0 + grow / half_um),
        )
    spread_um = math.sqrt(float(np.mean(step.left_um[step.kept] ** 2))) if step.kept.any() else math.inf
    points = max(step.kept.sum() * walls.spacing_um / _INDEPENDENT_UM, 1.0)
    held, direction = step.weakest
    return Fit(
        pose=pose,
        residual_um=spread_um,
        wall_share=float(step.kept.sum() / inside.sum()),
        seen=float(inside.mean()),
        sigma_um=max(spread_um, _LEAST_SIGMA_UM) / math.sqrt(points * max(held, 1e-6)),
        loose=direction,
        determined=held > _LOOSE,
    )


def _contrast(profiles: Float32Array) -> Float32Array:
    """Return how much gray levels change along profiles, smoothed; the sign does not matter."""
    change = np.gradient(profiles, axis=1) ** 2
    return np.asarray(np.sqrt(cv2.GaussianBlur(change, (25, 1), _CONTRAST_UM / _STEP_UM)), np.float32)


@dataclass(frozen=True)
class _Step:
    """Attributes: the move (x, y, turn, growth, each in µm, the latter at the grid's edge); what is left."""

    move: tuple[float, float, float, float]
    left_um: FloatArray
    kept: BoolArray
    weakest: tuple[float, tuple[float, float, float]]


def _solve(
    normals: FloatArray, arm: FloatArray, shift_um: FloatArray, good: BoolArray, *, free_scale: bool
) -> _Step:
    """Find the move that explains shifts along normals; robust, by weights that fall with the misfit."""
    turning = normals[:, 1] * arm[:, 0] - normals[:, 0] * arm[:, 1]
    growing = np.sum(normals * arm, axis=1)
    columns = [normals[:, 0], normals[:, 1], turning, *([growing] if free_scale else []), np.ones(len(arm))]
    matrix = np.stack(columns, axis=1)
    weight = good.astype(np.float64)
    left = shift_um
    solution = np.zeros(matrix.shape[1])
    for _ in range(8):
        normal_matrix = (matrix * weight[:, None]).T @ matrix / max(weight.sum(), 1e-9)
        values, vectors = np.linalg.eigh(normal_matrix)
        # What the walls do not hold stays as it was.
        inverse = np.where(values > _LOOSE / 4.0, 1.0 / np.maximum(values, 1e-12), 0.0)
        target = (matrix * weight[:, None]).T @ shift_um / max(weight.sum(), 1e-9)
        solution = vectors @ (inverse * (vectors.T @ target))
        left = shift_um - matrix @ solution
        sigma = max(1.4826 * float(np.median(np.abs(left[good]))), _LEAST_SIGMA_UM)
        weight = good * np.maximum(1.0 - (left / (4.0 * sigma)) ** 2, 0.0) ** 2
    kept = good & (np.abs(left) < min(4.0 * sigma, _FOUND_UM))
    # Shift and turn, less what the others could explain in their place.
    others = normal_matrix[3:, 3:]
    mixed = normal_matrix[:3, 3:]
    rigid = normal_matrix[:3, :3] - mixed @ np.linalg.pinv(others) @ mixed.T
    values, vectors = np.linalg.eigh(rigid)
    weak = vectors[:, 0]
    move = (*solution[:3].tolist(), float(solution[3]) if free_scale else 0.0)
    return _Step(move, left, kept, (float(values[0]), (float(weak[0]), float(weak[1]), float(weak[2]))))
