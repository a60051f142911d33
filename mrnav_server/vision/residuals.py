"""Least squares with residuals that mean something: corrected for what was fitted, and leave-one-out."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mrnav_server.core.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Residuals:
    """How well a fit explains its points; all distances on the floor, in µm.

    Attributes:
        points: Points that were fitted.
        rejected: Points that were left out as outliers.
        parameters: Numbers that were fitted.
        rms_um: Root mean square distance, corrected for the degrees of freedom that the fit used up.
        max_um: Largest distance.
        leave_one_out_um: Root mean square distance of each point from the fit to all others.
        leave_one_out_max_um: Largest of these.
    """

    points: int
    rejected: int
    parameters: int
    rms_um: float
    max_um: float
    leave_one_out_um: float
    leave_one_out_max_um: float


@dataclass(frozen=True)
class Solution:
    """A least-squares fit to points in the plane.

    Attributes:
        parameters: What was fitted, shape (p,).
        misses_um: Residual of each point, shape (n, 2).
        left_out_um: Residual of each point from the fit to all others, shape (n, 2).
        covariance: Of the parameters, shape (p, p).
    """

    parameters: FloatArray
    misses_um: FloatArray
    left_out_um: FloatArray
    covariance: FloatArray

    def residuals(self, rejected: int = 0) -> Residuals:
        """Return the figures."""
        count, used = len(self.misses_um), len(self.parameters)
        free = max(count - used / 2.0, 0.5)
        distance = np.linalg.norm(self.misses_um, axis=1)
        left_out = np.linalg.norm(self.left_out_um, axis=1)
        return Residuals(
            points=count,
            rejected=rejected,
            parameters=used,
            rms_um=float(np.sqrt(np.sum(distance**2) / free)),
            max_um=float(distance.max()),
            leave_one_out_um=float(np.sqrt(np.mean(left_out**2))),
            leave_one_out_max_um=float(left_out.max()),
        )


def solve(
    misses_um: Callable[[FloatArray], FloatArray],
    start: FloatArray,
    prior: Callable[[FloatArray], FloatArray] | None = None,
) -> Solution:
    """Fit parameters to points by Levenberg and Marquardt.

    The leave-one-out residuals are ``(I - Hᵢᵢ)⁻¹ rᵢ`` with the hat matrix at the solution: exact for a
    linear fit, and for these nearly linear ones without refitting n times.

    Args:
        misses_um: Returns the residual of each point, shape (n, 2), for parameters of shape (p,).
        start: First guess, shape (p,).
        prior: Residuals of what is known beforehand, in the unit of the points' noise.

    Raises:
        ValueError: If the points do not determine the parameters.
    """
    from scipy.optimize import least_squares

    def rows(parameters: FloatArray) -> FloatArray:
        known = prior(parameters) if prior else np.empty(0)
        return np.concatenate([misses_um(parameters).ravel(), known])

    if len(rows(start)) <= len(start):
        raise ValueError("there are not more equations than unknowns")
    found = least_squares(rows, start, x_scale="jac", method="lm")
    misses = misses_um(found.x)
    slope = np.asarray(found.jac, np.float64)
    normal = slope.T @ slope
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    whitened = normal / np.outer(scale, scale)
    if np.linalg.cond(whitened) > 1e12:
        raise ValueError("the points do not determine the map")
    inverse = np.linalg.inv(whitened) / np.outer(scale, scale)
    blocks = slope[: misses.size].reshape(*misses.shape, len(start))
    hat = np.einsum("nip,pq,njq->nij", blocks, inverse, blocks)
    left_out = np.linalg.solve(np.eye(2) - hat + 1e-12 * np.eye(2), misses[..., None])[..., 0]
    variance = float(np.sum(misses**2) / max(misses.size - len(start), 1))
    return Solution(found.x, misses, left_out, inverse * variance)
