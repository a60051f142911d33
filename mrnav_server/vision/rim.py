"""Sub-pixel fit of a disc of known radius, from the edge along rays through its rim."""

import math
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from mrnav_server.core.arrays import BoolArray, ByteArray, Float32Array, FloatArray, IntArray

Polarity = Literal["dark", "bright"]
"""Whether the robot is darker or brighter than what surrounds it."""

_RAYS = 72
_REACH = 0.32
"""Rays search this share of the radius on either side of the expected rim."""
_TOLERANCES_PX = (8.0, 3.0, 1.5, 1.5, 1.5)
"""Scale of the robust weight, step by step: wide to be captured, narrow to be exact."""
_CASTS = 4
_RECAST_PX = 0.05
"""Rays are cast anew from a centre that lies further off: the error of not doing so is d²/2R."""
_PULL_MAX_PX = 0.15
"""Uneven shade moves an edge by no more; a wall beside it is no shade."""
_SHADE_SIGMA = 2.5
"""What a sphere's own shade leaves of an error, in shifts that correcting for it made: shade from one side
grows steeper towards the rim than it is where it is sampled. Drawn spheres showed 0.7 to 3.2."""
_EDGE_MIN = 6.0
"""Weakest edge that counts, in gray levels over two pixels: about two sigma of the noise."""
_FEWEST_RAYS = 10
_ALIKE = 8.0
"""Neighbouring rays that err alike, beside a bubble or a wall; bare noise would be 1."""
_RADIUS_PRIOR = 25.0
"""How firmly the radius is held, in rays."""


@dataclass(frozen=True, slots=True)
class RimEstimate:
    """What a rim fit found.

    Attributes:
        x_px, y_px: Centre, in pixels of the picture that was fitted.
        radius_px: Radius that fits best, held near the known one by a weak prior.
        confidence: Share of rays that agree, times how strong their edges are, 0..1.
        sigma_px: Standard deviation of the centre along its worst direction.
        radius_sigma_px: Standard deviation of the radius, by what the rays in agreement differ.
    """

    x_px: float
    y_px: float
    radius_px: float
    confidence: float
    sigma_px: float
    radius_sigma_px: float


class RimFit:
    """Fits a disc of known radius that is darker, or brighter, than what surrounds it.

    Args:
        radius_px: The known radius.
        edge_strength: Gray levels over two pixels at which an edge counts in full.
        systematic_px: Error of a whole rim's centre that no noise explains (shadow, uneven light).
        polarity: Whether the disc is the darker or the brighter side of its rim.
    """

    def __init__(
        self, radius_px: float, edge_strength: float, systematic_px: float, polarity: Polarity = "dark"
    ) -> None:
        self.radius_px = radius_px
        self.polarity: Polarity = polarity
        self.reach_px = max(4, round(_REACH * radius_px))
        self._systematic_px = systematic_px
        self._edge_strength = edge_strength
        # Outwards, gray rises over two pixels by this times the difference of two pairs of samples.
        self._rise = np.float32((1.0 if polarity == "dark" else -1.0) / 3.0)
        angles = 2.0 * np.pi * np.arange(_RAYS) / _RAYS
        cos, sin = np.cos(angles), np.sin(angles)
        rho_px = radius_px + np.arange(-self.reach_px, self.reach_px + 1, dtype=np.float64)
        self._ray_x = np.outer(cos, rho_px).astype(np.float32)
        self._ray_y = np.outer(sin, rho_px).astype(np.float32)
        self._design = np.column_stack([cos, sin, np.ones(_RAYS)])
        self._moments = np.stack([cos * cos, cos * sin, cos, sin * sin, sin, np.ones(_RAYS)])
        # The slope's element k is that of sample k + 2.
        self._first_px = 2.0 - self.reach_px
        self._sample_row = np.arange(_RAYS) * (2 * self.reach_px + 1)
        self._five_rows = self._sample_row + np.arange(5)[:, None]
        near_px = max(2, round(0.27 * self.reach_px))
        self._beside_px = max(1, round(0.27 * self.reach_px))
        self._beside = np.array([-near_px - self._beside_px, -near_px, near_px, near_px + self._beside_px])[
            :, None
        ]
        self._slope_row = np.arange(_RAYS) * (2 * self.reach_px - 3)

    def fit_in(self, image: ByteArray, x_px: float, y_px: float) -> RimEstimate:
        """Fit the disc near a first guess in a colour picture; only what the rays can reach is made gray.

        Args:
            image: Shape (height, width, 3), BGR, uint8.
            x_px: First guess of the centre, inside the picture.
            y_px: First guess of the centre, inside the picture.
        """
        half_px = self.radius_px + 2.0 * self.reach_px + 2.0
        left, top = max(0, int(x_px - half_px)), max(0, int(y_px - half_px))
        region = image[top : int(y_px + half_px) + 1, left : int(x_px + half_px) + 1]
        gray = cv2.cvtColor(region, cv2.COLOR_BGR2GRAY).astype(np.uint8, copy=False)
        found = self.fit(gray, x_px - left, y_px - top)
        return RimEstimate(
            found.x_px + left,
            found.y_px + top,
            found.radius_px,
            found.confidence,
            found.sigma_px,
            found.radius_sigma_px,
        )

    def fit(self, gray: ByteArray, x_px: float, y_px: float) -> RimEstimate:
        """Fit the disc near a first guess, which may be off by ``reach_px``.

        Args:
            gray: Shape (height, width), uint8.
            x_px: First guess of the centre.
            y_px: First guess of the centre.
        """
        nothing = RimEstimate(x_px, y_px, self.radius_px, 0.0, self.radius_px, self.radius_px)
        excess_px, shade_px, seen, reference = self._cast(gray, x_px, y_px)
        if np.count_nonzero(seen) < _FEWEST_RAYS:
            return nothing
        casts = 1
        weight = seen.astype(np.float64)
        dx = dy = dr = 0.0
        for tolerance_px in _TOLERANCES_PX:
            if math.hypot(dx, dy) > _RECAST_PX and casts < _CASTS:
                x_px, y_px = x_px + dx, y_px + dy
                excess_px, shade_px, seen, reference = self._cast(gray, x_px, y_px)
                if np.count_nonzero(seen) < _FEWEST_RAYS:
                    return nothing
                casts += 1
                weight = seen / (1.0 + ((excess_px - dr) / tolerance_px) ** 2) ** 2
            dx, dy, dr = self._solve(excess_px, weight)
            residual_px = excess_px - self._design @ (dx, dy, dr)
            weight = seen / (1.0 + (residual_px / tolerance_px) ** 2) ** 2
        agree = seen & (np.abs(residual_px) < 1.2)
        count = int(np.count_nonzero(agree))
        if count < _FEWEST_RAYS:
            return nothing
        confidence = count / _RAYS * min(1.0, reference / self._edge_strength)
        sigma_px, radius_sigma_px = self._sigmas_px(agree, residual_px, shade_px)
        return RimEstimate(x_px + dx, y_px + dy, self.radius_px + dr, confidence, sigma_px, radius_sigma_px)

    def _cast(
        self, gray: ByteArray, x_px: float, y_px: float
    ) -> tuple[FloatArray, Float32Array, BoolArray, float]:
        """Cast rays from a centre.

        Returns:
            How far beyond the known radius each ray's strongest edge lies in px, how far the robot's own
            shade has moved it, whether that edge is strong enough to be believed, and the strength of the
            stronger edges.
        """
        samples = cv2.remap(
            gray,
            self._ray_x + np.float32(x_px),
            self._ray_y + np.float32(y_px),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        ).astype(np.float32)
        pairs = samples[:, :-1] + samples[:, 1:]
        slope = (pairs[:, 3:] - pairs[:, :-3]) * self._rise
        peak = slope.argmax(axis=1)
        strength = slope.ravel().take(self._slope_row + peak)
        # The smooth slope tells edges from noise; the bare one is less pulled by what lies beside the edge.
        flat = samples.ravel()
        first, second, third, fourth, fifth = flat.take(self._five_rows + peak)
        left, middle, right = third - first, fourth - second, fifth - third
        bend = left - 2.0 * middle + right
        bend = np.where(np.abs(bend) < 1e-3, np.inf, bend)
        vertex = np.minimum(np.maximum(0.5 * (left - right) / bend, -1.0), 1.0)
        shade_px, floor_px = self._pulls_px(flat, peak, middle)
        vertex -= np.minimum(np.maximum(shade_px + floor_px, -_PULL_MAX_PX), _PULL_MAX_PX)
        ranked = np.partition(strength, int(0.8 * _RAYS))
        reference = float(ranked[int(0.8 * _RAYS)])
        seen = strength > max(_EDGE_MIN, 0.4 * reference)
        return self._first_px + peak + vertex, shade_px, seen, reference

    def _pulls_px(
        self, samples: Float32Array, peak: IntArray, middle: Float32Array
    ) -> tuple[Float32Array, Float32Array]:
        """Return how far shade inside an edge, and outside, has moved the edge's steepest place.

        An edge of height A, blurred by sigma, between gray that changes by b inside and b' outside a pixel:
        the slope A·G + b·(1 - C) + b'·C is steepest at (b' - b)·sigma²/A, where sigma follows from the
        slope there, A/(sigma·√2π).
        """
        at = np.minimum(np.maximum(peak + 2 + self._beside, 0), 2 * self.reach_px) + self._sample_row
        deep, inside, outside, far = samples.take(at)
        gain = np.float32(2.0 / math.pi / self._beside_px) * (outside - inside)
        gain /= np.maximum(middle * middle, np.float32(1.0))
        return gain * (deep - inside), gain * (far - outside)

    def _solve(self, excess_px: FloatArray | Float32Array, weight: FloatArray) -> tuple[float, float, float]:
        """Return the shift (dx, dy, dr) by weighted least squares, in closed form."""
        a, b, c, d, e, f = (self._moments @ weight).tolist()
        a, d, f = a + 1e-3, d + 1e-3, f + _RADIUS_PRIOR
        u, v, w = ((weight * excess_px) @ self._design).tolist()
        # Cofactors of [[a, b, c], [b, d, e], [c, e, f]].
        ca, cb, cc = d * f - e * e, c * e - b * f, b * e - c * d
        cd, ce, cf = a * f - c * c, b * c - a * e, a * d - b * b
        scale = 1.0 / (a * ca + b * cb + c * cc)
        return (
            scale * (ca * u + cb * v + cc * w),
            scale * (cb * u + cd * v + ce * w),
            scale * (cc * u + ce * v + cf * w),
        )

    def _sigmas_px(
        self, agree: BoolArray, residual_px: FloatArray, shade_px: Float32Array
    ) -> tuple[float, float]:
        """Return the errors of the centre, along the direction that agreeing rays see least of, and radius.

        What moves an edge moves its neighbours alike; a systematic error is common to a side, so it grows
        with the full inverse of what is seen, which is half the rays when the whole rim is. Light from one
        side shows in the robot's shade beside its rim; the error grows with the shift that this made.
        """
        capped_px = np.minimum(np.maximum(shade_px, -_PULL_MAX_PX), _PULL_MAX_PX)
        shift_px = math.hypot(*self._solve(capped_px, agree.astype(np.float64))[:2])
        a, b, _, d, _, count = (self._moments @ agree).tolist()
        least = max(0.5 * (a + d) - math.hypot(0.5 * (a - d), b), 1e-3)
        kept_px = residual_px[agree]
        variance = _ALIKE * float(kept_px @ kept_px) / count
        systematic_px = self._systematic_px * 0.5 * _RAYS / least
        sigma_px = math.hypot(math.sqrt(variance / least), systematic_px, _SHADE_SIGMA * shift_px)
        return sigma_px, math.sqrt(variance / count)
