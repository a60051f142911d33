"""From the corners of a calibration sheet to the camera's map of the channel's floor."""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from mrnav_server.core.arrays import BoolArray, FloatArray
from mrnav_server.core.camera_map import STRONGEST_RADIAL, FloorMap
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.picture import PictureFormat
from mrnav_server.vision.charuco import SheetCorners
from mrnav_server.vision.residuals import Residuals, Solution, solve

RMS_MAX_UM = 5.0
"""A floor map that misses its own corners by more is refused."""
FEWEST_CORNERS = 40
LEAST_COVERAGE = 0.15
"""Least share of the picture that the corners must span."""
MOST_REJECTED = 0.2
"""With more outliers than this share, the sheet is bent, wet or out of focus."""
_CENTER_SIGMA = 0.05
"""How far the optical axis may be from the picture's centre, as a share of its width."""
_ROUNDS = 5


@dataclass(frozen=True, slots=True)
class FloorFit:
    """The floor map and what it is worth.

    Attributes:
        map: Image pixels from floor µm.
        residuals: How well the corners follow it.
        coverage: Share of the picture that the corners span.
        edge_sigma_um: Standard deviation of the map where it is worst: in a corner of the picture.
    """

    map: FloorMap
    residuals: Residuals
    coverage: float
    edge_sigma_um: float


def fit_floor(corners: SheetCorners, picture: PictureFormat) -> FloorFit:
    """Fit homography and radial distortion; outliers are left out.

    Args:
        corners: What was found of the sheet.
        picture: The camera's pictures.

    Raises:
        RefusedError: If there are too few corners, they span too little, too many are outliers, or the
            residual is above ``RMS_MAX_UM``.
    """
    count = len(corners.image_px)
    if count < FEWEST_CORNERS:
        raise RefusedError(
            "few_corners",
            f"{count} of {corners.expected} corners of the sheet were found, {FEWEST_CORNERS} are needed:"
            " bring it into view and into focus, without glare",
        )
    coverage = _hull_px(corners.image_px) / (picture.width_px * picture.height_px)
    if coverage < LEAST_COVERAGE:
        raise RefusedError(
            "little_coverage",
            f"the sheet's corners span {100 * coverage:.0f} % of the picture, {100 * LEAST_COVERAGE:.0f} %"
            " are needed: use a larger sheet, or bring all of it into view",
        )
    scaling = _Scaling(corners, picture)
    kept = _inliers(corners, picture)
    for _ in range(_ROUNDS):
        solution = _solved(corners, kept, scaling)
        misses = scaling.map(solution.parameters).floor(corners.image_px) - corners.floor_um
        distance = np.linalg.norm(misses, axis=1)
        spread = 1.4826 * float(np.median(distance[kept])) / 1.18
        again = distance <= max(5.0 * spread, 0.5)
        if np.array_equal(again, kept):
            break
        kept = again
    rejected = count - int(np.count_nonzero(kept))
    if rejected > MOST_REJECTED * count:
        raise RefusedError(
            "outliers",
            f"{rejected} of {count} corners contradict the others: flatten the sheet, remove drops and glare",
        )
    residuals = solution.residuals(rejected)
    if residuals.rms_um > RMS_MAX_UM:
        raise RefusedError(
            "floor_residual",
            f"the floor map misses the sheet's corners by {residuals.rms_um:.1f} µm RMS, {RMS_MAX_UM:g} µm"
            " are allowed: check that the sheet is flat, still, in focus and printed true",
        )
    found = scaling.map(solution.parameters)
    return FloorFit(found, residuals, coverage, _edge_sigma_um(solution, scaling, picture))


class _Scaling:
    """Parameters near 1: eight of the homography on scaled coordinates, the axis and the distortion."""

    def __init__(self, corners: SheetCorners, picture: PictureFormat) -> None:
        self.unit_um = float(np.abs(corners.floor_um).max())
        self.center_px = np.array(picture.center_px)
        self.radius_px = math.hypot(picture.width_px, picture.height_px) / 2.0
        self.axis_sigma = _CENTER_SIGMA * picture.width_px / self.radius_px

    def map(self, parameters: FloatArray) -> FloorMap:
        axis_px = self.center_px + parameters[8:10] * self.radius_px
        from_unit = np.array(
            [
                [self.radius_px, 0.0, self.center_px[0]],
                [0.0, self.radius_px, self.center_px[1]],
                [0.0, 0.0, 1.0],
            ]
        )
        whole = from_unit @ np.append(parameters[:8], 1.0).reshape(3, 3)
        whole = whole @ np.diag([1.0 / self.unit_um, 1.0 / self.unit_um, 1.0])
        radial = float(np.clip(parameters[10], -STRONGEST_RADIAL, STRONGEST_RADIAL))
        center = (float(axis_px[0]), float(axis_px[1]))
        return FloorMap(tuple((whole / whole[2, 2]).ravel().tolist()), center, radial, self.radius_px)

    def start(self, corners: SheetCorners, kept: BoolArray) -> FloatArray:
        image = (corners.image_px[kept] - self.center_px) / self.radius_px
        whole, _ = cv2.findHomography(corners.floor_um[kept] / self.unit_um, image, 0)
        return np.append((whole / whole[2, 2]).ravel()[:8], [0.0, 0.0, 0.0])


def _solved(corners: SheetCorners, kept: BoolArray, scaling: _Scaling) -> Solution:
    image_px, floor_um = corners.image_px[kept], corners.floor_um[kept]
    return solve(
        lambda parameters: scaling.map(parameters).floor(image_px) - floor_um,
        scaling.start(corners, kept),
        # Without distortion nothing shows where the axis is; one µm of noise weighs against this.
        prior=lambda parameters: parameters[8:10] / scaling.axis_sigma,
    )


def _inliers(corners: SheetCorners, picture: PictureFormat) -> BoolArray:
    """Return the corners that a homography explains as well as an undistorted lens would."""
    _, mask = cv2.findHomography(corners.floor_um, corners.image_px, cv2.RANSAC, 0.004 * picture.width_px)
    return np.asarray(mask).ravel().astype(bool)


def _hull_px(points_px: FloatArray) -> float:
    return float(cv2.contourArea(cv2.convexHull(points_px.astype(np.float32))))


def _edge_sigma_um(solution: Solution, scaling: _Scaling, picture: PictureFormat) -> float:
    """Propagate the parameters' covariance to the picture's corners, along the worst direction."""
    x, y = picture.width_px - 1.0, picture.height_px - 1.0
    edge_px = np.array([[0.0, 0.0], [x, 0.0], [0.0, y], [x, y]])
    count = len(solution.parameters)
    steps = 1e-6 * np.eye(count)
    derivative = np.stack(
        [
            (
                scaling.map(solution.parameters + step).floor(edge_px)
                - scaling.map(solution.parameters - step).floor(edge_px)
            )
            / 2e-6
            for step in steps
        ],
        axis=-1,
    )
    spread = np.einsum("nip,pq,njq->nij", derivative, solution.covariance, derivative)
    return float(np.sqrt(np.linalg.eigvalsh(spread)[:, -1].max()))
