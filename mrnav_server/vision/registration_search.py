"""Where a vessel model may lie in a picture: every shift and turn within reach, compared by its walls."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mrnav_server.core.arrays import ByteArray, Float32Array, FloatArray
from mrnav_server.core.frames import Calibration
from mrnav_server.core.vessel import VesselMap
from mrnav_server.vision.walls import gray_at, image_px

_STEP_UM = 90.0
_TURN_STEP_DEG = 1.0
_APART_UM = 500.0
"""Poses that move the walls by less are the same."""
_RIVAL = 0.8
"""A rival whose walls are found worse than this, relative to the best, needs no closer look."""
_LEAST_SEEN = 0.4
"""So much of the walls must lie in the picture."""
_STRONG = 3.0
"""Edges count no more than this many times the median one: a needle's edge is no better than a wall's."""

_Field = NDArray[np.complex64]


@dataclass(frozen=True, slots=True)
class Candidate:
    """A pose of the model's grid, relative to where it was supposed to lie.

    Attributes:
        x_um, y_um: Displacement of the grid's middle, in the grid's axes.
        turn_deg: Turn about it, from x towards y.
        scale: Size of the grid over what it was supposed to be.
        score: Share of the walls that lie on edges of their direction, about 0..1.
    """

    x_um: float
    y_um: float
    turn_deg: float
    scale: float
    score: float

    def apart_um(self, other: "Candidate", reach_um: float) -> float:
        """Return how far the walls lie apart, for walls at ``reach_um`` from the grid's middle."""
        turn_um = math.radians(self.turn_deg - other.turn_deg) * reach_um
        scale_um = (self.scale - other.scale) * reach_um
        return math.hypot(self.x_um - other.x_um, self.y_um - other.y_um, turn_um, scale_um)


def search(
    picture: ByteArray,
    calibration: Calibration,
    vessel: VesselMap,
    reach_um: float,
    turn_deg: float,
    scales: tuple[float, ...] = (1.0,),
) -> list[Candidate]:
    """Return the best pose and its rivals, best first; empty if the walls are not in the picture.

    Edges and walls are compared by direction, not by which side is bright, so that any lighting will do.
    Every shift is tried at once, by Fourier transforms, for each turn and scale.

    Args:
        picture: BGR or gray, uint8.
        calibration: Where the model is supposed to lie.
        vessel: The model.
        reach_um: Largest shift along x and along y.
        turn_deg: Largest turn.
        scales: Sizes to try, relative to the supposed one.
    """
    half_um = vessel.size_px * vessel.um_per_px / 2.0
    margin = math.ceil(1.2 * reach_um / _STEP_UM)
    side = 2 * math.ceil(half_um / _STEP_UM)
    size = cv2.getOptimalDFTSize(side + 2 * margin)
    offsets_um = (np.arange(size) - (size - 1) / 2.0) * _STEP_UM
    grid_px = np.stack(np.meshgrid(offsets_um, offsets_um), -1) / vessel.um_per_px + vessel.size_px / 2.0
    edges, seen = _edges(picture, calibration, grid_px)
    edges_f, seen_f = np.fft.fft2(edges), np.fft.fft2(seen)
    most = round(reach_um / _STEP_UM)
    turns = np.arange(-math.ceil(turn_deg), math.ceil(turn_deg) + 1) * _TURN_STEP_DEG
    found: list[Candidate] = []
    for scale in scales:
        for turn in turns:
            walls = _walls(vessel, grid_px, float(turn), scale)
            weight = np.abs(walls)
            agree = np.fft.ifft2(edges_f * np.conj(np.fft.fft2(walls))).real
            visible = np.fft.ifft2(seen_f * np.conj(np.fft.fft2(weight))).real
            score = agree / np.maximum(visible, _LEAST_SEEN * weight.sum())
            near = np.roll(score, (most, most), (0, 1))[: 2 * most + 1, : 2 * most + 1]
            found += _peaks(near, most, float(turn), scale)
    found.sort(key=lambda candidate: -candidate.score)
    kept: list[Candidate] = []
    for candidate in found:
        if candidate.score < _RIVAL * found[0].score or len(kept) == 4:
            break
        if all(candidate.apart_um(other, half_um) > _APART_UM for other in kept):
            kept.append(candidate)
    return kept


def _edges(picture: ByteArray, calibration: Calibration, grid_px: FloatArray) -> tuple[_Field, Float32Array]:
    """Return edges over the floor as doubled directions (``g²/|g|``), and where the floor is seen."""
    at_px = image_px(calibration, grid_px)
    step_px = float(np.linalg.norm(at_px[1, 1] - at_px[0, 0]) / math.sqrt(2.0))
    soft = cv2.GaussianBlur(picture, (0, 0), max(0.5 * step_px, 0.5)).astype(np.uint8)
    gray = gray_at(soft, at_px)
    seen = np.isfinite(gray)
    gray = np.where(seen, gray, np.float32(np.nanmean(gray) if seen.any() else 0.0))
    inner = cv2.erode(seen.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(np.float32)
    gradient = _gradient(gray) * inner
    strength = np.abs(gradient)
    # Relative to what is usual around, so that neither shade nor a bright reflection decides.
    usual = cv2.GaussianBlur(strength, (0, 0), 12.0) / np.maximum(cv2.GaussianBlur(inner, (0, 0), 12.0), 0.05)
    share = np.minimum(strength / np.maximum(usual, 0.5) / _STRONG, 1.0)
    return (share * (gradient / np.maximum(strength, 1e-6)) ** 2).astype(np.complex64), inner


def _walls(vessel: VesselMap, grid_px: FloatArray, turn_deg: float, scale: float) -> _Field:
    """Return a turned model's walls as doubled directions, 1 on the wall, fading over a step."""
    middle, turn = vessel.size_px / 2.0, math.radians(turn_deg)
    x, y = (grid_px[..., axis] - middle for axis in (0, 1))
    back_x = (x * math.cos(turn) + y * math.sin(turn)) / scale + middle
    back_y = (y * math.cos(turn) - x * math.sin(turn)) / scale + middle
    step_px = _STEP_UM / vessel.um_per_px
    soft = cv2.GaussianBlur(vessel.distance_px, (0, 0), 0.4 * step_px)
    distance = cv2.remap(
        soft,
        back_x.astype(np.float32),
        back_y.astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=-1e3,
    ).astype(np.float32)
    # At the grid's border a vessel is cut off, which is no wall.
    rim = (np.minimum(back_x, back_y) > step_px) & (np.maximum(back_x, back_y) < vessel.size_px - 1 - step_px)
    slope = _gradient(distance)
    band = np.exp(-((distance / step_px) ** 2)) * rim
    field = band * (slope / np.maximum(np.abs(slope), 1e-6)) ** 2
    return np.asarray(field, np.complex64)


def _gradient(values: Float32Array) -> _Field:
    gx, gy = (cv2.Sobel(values, cv2.CV_32F, *d, scale=1 / 8) for d in ((1, 0), (0, 1)))
    return np.asarray(gx + 1j * gy, np.complex64)


def _peaks(score: FloatArray, most: int, turn_deg: float, scale: float) -> list[Candidate]:
    """Return the highest places that are higher than all around them."""
    score = score.astype(np.float32)
    high = (cv2.dilate(score, np.ones((3, 3), np.uint8)) == score) & (score > 0)
    rows, columns = np.nonzero(high)
    best = np.argsort(-score[rows, columns])[:20]
    return [
        Candidate(
            float(columns[k] - most) * _STEP_UM,
            float(rows[k] - most) * _STEP_UM,
            turn_deg,
            scale,
            float(score[rows[k], columns[k]]),
        )
        for k in best
    ]
