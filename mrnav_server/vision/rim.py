"""Sub-pixel fit of a dark disc of known radius, from the edge along rays through its rim."""

from dataclasses import dataclass

import cv2
import numpy as np

from mrnav_server.core.arrays import BoolArray, ByteArray, FloatArray

_RAYS = 72
_REACH = 0.32
"""Rays search this share of the radius on either side of the expected rim."""
_ROUNDS = 3
"""Each round casts the rays from the centre that the round before has found."""
_TOLERANCES_PX = (8.0, 3.0, 1.5)
"""Scale of the robust weight by round: wide to be captured, narrow to be exact."""
_EDGE_MIN = 6.0
"""Weakest edge that counts, in gray levels over two pixels: about two sigma of the noise."""
_FEWEST_RAYS = 10


@dataclass(frozen=True, slots=True)
class RimEstimate:
    """What a rim fit found.

    Attributes:
        x_px, y_px: Centre, in pixels of the picture that was fitted.
        radius_px: Radius that fits best, held near the known one by a weak prior.
        confidence: Share of rays that agree, times how strong their edges are, 0..1.
        sigma_px: Standard deviation of the centre along its worst direction.
    """

    x_px: float
    y_px: float
    radius_px: float
    confidence: float
    sigma_px: float


class RimFit:
    """Fits a disc of known radius that is darker than what surrounds it.

    Args:
        radius_px: The known radius.
        edge_strength: Gray levels over two pixels at which an edge counts in full.
        systematic_px: Error of a whole rim's centre that no noise explains (shadow, uneven light).
    """

    def __init__(self, radius_px: float, edge_strength: float, systematic_px: float) -> None:
        self.radius_px = radius_px
        self._systematic_px = systematic_px
        self.reach_px = max(4, round(_REACH * radius_px))
        self._edge_strength = edge_strength
        angles = 2.0 * np.pi * np.arange(_RAYS) / _RAYS
        self._cos, self._sin = np.cos(angles), np.sin(angles)
        self._rho_px = radius_px + np.arange(-self.reach_px, self.reach_px + 1, dtype=np.float64)
        self._ray_x = np.outer(self._cos, self._rho_px).astype(np.float32)
        self._ray_y = np.outer(self._sin, self._rho_px).astype(np.float32)
        self._design = np.column_stack([self._cos, self._sin, np.ones(_RAYS)])
        self._rays = np.arange(_RAYS)

    def fit(self, gray: ByteArray, x_px: float, y_px: float) -> RimEstimate:
        """Fit the disc near a first guess, which may be off by ``reach_px``.

        Args:
            gray: Shape (height, width), uint8.
            x_px: First guess of the centre.
            y_px: First guess of the centre.
        """
        start_x, start_y = x_px, y_px
        for tolerance_px in _TOLERANCES_PX:
            edge_px, strength = self._edges(gray, x_px, y_px)
            reference = float(np.partition(strength, int(0.8 * _RAYS))[int(0.8 * _RAYS)])
            seen = strength > max(_EDGE_MIN, 0.4 * reference)
            if np.count_nonzero(seen) < _FEWEST_RAYS:
                return RimEstimate(start_x, start_y, self.radius_px, 0.0, self.radius_px)
            shift, residual_px = self._solve(edge_px - self.radius_px, seen, tolerance_px)
            x_px, y_px = x_px + float(shift[0]), y_px + float(shift[1])
        agree = seen & (np.abs(residual_px) < 1.2)
        count = int(np.count_nonzero(agree))
        if count < _FEWEST_RAYS:
            return RimEstimate(start_x, start_y, self.radius_px, 0.0, self.radius_px)
        confidence = count / _RAYS * min(1.0, reference / self._edge_strength)
        sigma_px = self._sigma_px(agree, residual_px)
        return RimEstimate(x_px, y_px, self.radius_px + float(shift[2]), confidence, sigma_px)

    def _edges(self, gray: ByteArray, x_px: float, y_px: float) -> tuple[FloatArray, FloatArray]:
        """Return the radius of the strongest dark-to-bright edge on each ray, and its strength."""
        samples = cv2.remap(
            gray,
            self._ray_x + np.float32(x_px),
            self._ray_y + np.float32(y_px),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        ).astype(np.float64)
        smooth = (samples[:, :-2] + samples[:, 1:-1] + samples[:, 2:]) / 3.0
        slope = smooth[:, 2:] - smooth[:, :-2]
        peak = np.clip(slope.argmax(axis=1), 1, slope.shape[1] - 2)
        left, strength, right = (slope[self._rays, peak + k] for k in (-1, 0, 1))
        bend = left - 2.0 * strength + right
        vertex = np.where(bend < -1e-3, 0.5 * (left - right) / np.minimum(bend, -1e-3), 0.0)
        return self._rho_px[0] + 2.0 + peak + np.clip(vertex, -1.0, 1.0), strength

    def _solve(
        self, excess_px: FloatArray, seen: BoolArray, tolerance_px: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return the shift (dx, dy, dr) and each ray's residual, by iteratively reweighted least squares."""
        weight = seen.astype(np.float64)
        prior = np.diag([1e-3, 1e-3, 25.0])
        for _ in range(4):
            weighted = self._design.T * weight
            shift = np.linalg.solve(weighted @ self._design + prior, weighted @ excess_px)
            residual_px = excess_px - self._design @ shift
            weight = seen / (1.0 + (residual_px / tolerance_px) ** 2) ** 2
        return shift, residual_px

    def _sigma_px(self, agree: BoolArray, residual_px: FloatArray) -> float:
        """Return the centre's error along the direction that the rays in agreement see least of.

        Noise is independent from ray to ray; a systematic error is common to a side, so it grows with
        the full inverse of what is seen, which is half the rays when the whole rim is.
        """
        design = self._design[agree, :2]
        least = max(float(np.linalg.eigvalsh(design.T @ design)[0]), 1e-3)
        noise_px = float(np.sqrt(np.mean(residual_px[agree] ** 2) / least))
        return float(np.hypot(noise_px, self._systematic_px * 0.5 * _RAYS / least))
