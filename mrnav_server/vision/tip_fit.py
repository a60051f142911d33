"""From places where the tip was seen to its map, and to how the manipulator stands to the floor."""

from dataclasses import dataclass

import numpy as np

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.camera_map import TipMap
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import Affine2
from mrnav_server.vision.residuals import Residuals, solve

PARAMETERS = 9
FEWEST_POINTS = 12
"""Nine parameters take five points; what is left over is what the residual is made of."""
LEAST_SPAN_UM = 1000.0
"""Least spread of the points across their narrowest direction, and of their heights."""
RMS_MAX_UM = 15.0
"""A tip map that misses its own points by more is refused."""
MAX_UM = 45.0
"""A single point that is missed by more was seen wrongly; it is visited again rather than left out."""


@dataclass(frozen=True, slots=True)
class TipFit:
    """The tip's map and what it is worth.

    Attributes:
        map: Floor µm that the tip hides, from stage µm.
        residuals: How well the points follow it.
    """

    map: TipMap
    residuals: Residuals


def fit_tip(tips_um: FloatArray, hidden_um: FloatArray) -> TipFit:
    """Fit ``u = (A·[x y z]) / (1 - z / WD) + u₀``, nine parameters.

    An affine map through three points has no residual whatever its error: fewer than ``FEWEST_POINTS`` are
    refused, as are points on a line or at one height.

    Args:
        tips_um: Stage x, y, z of the tip, shape (n, 3).
        hidden_um: The floor points where it was seen, shape (n, 2).

    Raises:
        RefusedError: If the points cannot determine the map, or do not follow it.
    """
    count = len(tips_um)
    if count < FEWEST_POINTS:
        raise RefusedError(
            "few_points",
            f"the tip was seen at {count} places, {FEWEST_POINTS} are needed: an affine map through three"
            " points has residual 0 whatever its error",
        )
    middle = tips_um.mean(axis=0)
    across = np.linalg.svd(tips_um[:, :2] - middle[:2], compute_uv=False)[-1] / np.sqrt(count)
    if 2.0 * across < LEAST_SPAN_UM:
        raise RefusedError(
            "collinear", "the places where the tip was seen lie on a line: visit a square of them"
        )
    if np.ptp(tips_um[:, 2]) < LEAST_SPAN_UM:
        raise RefusedError(
            "one_height",
            f"the tip was seen at heights within {np.ptp(tips_um[:, 2]):.0f} µm: visit at least two heights,"
            f" {LEAST_SPAN_UM:.0f} µm or more apart",
        )
    try:
        # Centred and scaled: q·(1 - w·z) = M·xy + a·z + b is linear and gives the first guess.
        unit = float(np.abs(tips_um - middle).max())
        local, hidden = (tips_um - middle) / unit, hidden_um / unit
        solution = solve(lambda p: (_apparent(p, local) - hidden) * unit, _first_guess(local, hidden))
    except (ValueError, np.linalg.LinAlgError) as error:
        raise RefusedError("degenerate", f"the raster does not determine the tip's map ({error})") from None
    residuals = solution.residuals()
    if residuals.rms_um > RMS_MAX_UM or residuals.max_um > MAX_UM:
        raise RefusedError(
            "tip_residual",
            f"the tip's map misses its points by {residuals.rms_um:.1f} µm RMS, {residuals.max_um:.0f} µm at"
            f" most; {RMS_MAX_UM:g} and {MAX_UM:g} µm are allowed: let it rest, clear the view, try again",
        )
    return TipFit(_tip_map(solution.parameters, middle, unit), residuals)


def stage_from_floor(tip: TipMap) -> Affine2:
    """Return how the manipulator's axes lie over the floor, from floor µm.

    It is the tip's map at the height at which its motion appears in true size.
    """
    return Affine2.of_rows(tip.at_height(tip.true_size_z_um())).inverse()


def floor_z_um(tip: TipMap, water_rise_um: float) -> float:
    """Return the stage z of the floor's plane.

    Args:
        tip: The tip's map, from a raster above the water.
        water_rise_um: How far the water lifts the floor for an eye above it, ``d·(1 - 1/n)``.
    """
    return tip.true_size_z_um() - water_rise_um


def _apparent(p: FloatArray, local: FloatArray) -> FloatArray:
    flat = local[:, :2] @ p[:4].reshape(2, 2).T + local[:, 2:] * p[4:6] + p[6:8]
    return np.asarray(flat / (1.0 - p[8] * local[:, 2:]))


def _first_guess(local: FloatArray, hidden: FloatArray) -> FloatArray:
    count = len(local)
    x, y, z = local.T
    one, zero = np.ones(count), np.zeros(count)
    for_x = np.column_stack([x, y, zero, zero, z, zero, one, zero, z * hidden[:, 0]])
    for_y = np.column_stack([zero, zero, x, y, zero, z, zero, one, z * hidden[:, 1]])
    guess, *_ = np.linalg.lstsq(np.vstack([for_x, for_y]), np.concatenate([hidden[:, 0], hidden[:, 1]]))
    return np.asarray(guess)


def _tip_map(p: FloatArray, middle: FloatArray, unit: float) -> TipMap:
    """Return the map in stage coordinates: 1 - w·(z - z̄)/u = s·(1 - z / WD)."""
    share = 1.0 + p[8] * middle[2] / unit
    camera_z_um = share * unit / p[8]
    linear = np.column_stack([p[:4].reshape(2, 2), p[4:6]])
    constant = p[6:8] * unit - linear @ middle
    offset = constant / share
    # The constant term rides on the same denominator: u₀·(1 - z / WD) leaves u₀·z / WD to A.
    matrix = linear / share
    matrix[:, 2] += offset / camera_z_um
    return TipMap(tuple(matrix.ravel().tolist()), (float(offset[0]), float(offset[1])), float(camera_z_um))
