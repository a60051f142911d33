"""How a camera over the bench sees the channel's floor, and the tip above it.

Both maps are frozen tuples of floats, so calibrations compare and hash; arrays come in and out.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from mrnav_server.core.arrays import FloatArray

STRONGEST_RADIAL = 0.2
"""A stronger distortion folds the picture over, within its corners or little outside."""
_ROUNDS = 30
"""Most of Newton's steps from the distorted radius; near the fold, outside any picture, it takes many."""
_SETTLED = 1e-13
"""A step this small, as a share of the radius, ends the search."""


@dataclass(frozen=True, slots=True)
class FloorMap:
    """The channel's floor in the image: a homography, then radial distortion about the optical axis.

    ``u = c + (p - c)·(1 + k·r²)`` with ``p = H·floor`` and ``r = |p - c| / radius_px``. An affine map is
    the case without perspective and with ``k = 0``.

    Attributes:
        homography: Undistorted image pixels from floor coordinates, row-major, nine numbers.
        center_px: Where the optical axis meets the image.
        radial: k, the share by which a point at ``radius_px`` from the axis is moved outwards.
        radius_px: Radius at which ``radial`` is stated; half the picture's diagonal.

    Raises:
        ValueError: If a number is not finite, or the map cannot be inverted.
    """

    homography: tuple[float, ...]
    center_px: tuple[float, float] = (0.0, 0.0)
    radial: float = 0.0
    radius_px: float = 1000.0

    def __post_init__(self) -> None:
        numbers = (*self.homography, *self.center_px, self.radial, self.radius_px)
        if len(self.homography) != 9 or not np.all(np.isfinite(numbers)):
            raise ValueError("a floor map takes nine finite numbers, a centre, a radial share and a radius")
        if abs(self.radial) > STRONGEST_RADIAL or self.radius_px <= 0.0:
            raise ValueError(f"a radial share of {self.radial:g} is beyond ±{STRONGEST_RADIAL:g}")
        if abs(np.linalg.det(self._matrix)) < 1e-300:
            raise ValueError("a singular homography has no inverse")

    @classmethod
    def affine(cls, rows: FloatArray) -> Self:
        """Return the map that is affine.

        Args:
            rows: ``[[a, b, tx], [c, d, ty]]``, shape (2, 3).
        """
        return cls((*np.asarray(rows, np.float64).ravel().tolist(), 0.0, 0.0, 1.0))

    @property
    def _matrix(self) -> FloatArray:
        return np.array(self.homography).reshape(3, 3)

    def image(self, floor: FloatArray) -> FloatArray:
        """Return where floor points appear, in pixels.

        Args:
            floor: Shape (..., 2), in the unit that the map was made for.

        Returns:
            Shape (..., 2). Where the distortion would fold over, outside any picture, its edge.
        """
        offset = _homogeneous(self._matrix, floor) - self.center_px
        r = np.linalg.norm(offset, axis=-1, keepdims=True) / self.radius_px
        inside = np.minimum(r, self._fold)
        share = (inside + self.radial * inside**3) / np.maximum(r, 1e-300)
        return np.asarray(self.center_px + offset * np.where(r < 1e-12, 1.0, share))

    def floor(self, image: FloatArray) -> FloatArray:
        """Return the floor points that pixels show: Newton on the radius, then the inverse homography.

        Args:
            image: Shape (..., 2), in pixels.

        Returns:
            Shape (..., 2).
        """
        offset: FloatArray = np.asarray(image, np.float64) - self.center_px
        distorted = np.linalg.norm(offset, axis=-1, keepdims=True) / self.radius_px
        fold = self._fold
        reachable = np.minimum(distorted, fold + self.radial * fold**3) if np.isfinite(fold) else distorted
        r = np.minimum(reachable, fold)
        for _ in range(_ROUNDS if self.radial else 0):
            slope = np.maximum(1.0 + 3.0 * self.radial * r * r, 1e-9)
            step = (r + self.radial * r**3 - reachable) / slope
            r = np.clip(r - step, 0.0, fold)
            if np.abs(step).max(initial=0.0) < _SETTLED:
                break
        share = np.where(distorted < 1e-12, 1.0, r / np.maximum(distorted, 1e-300))
        plain = np.asarray(self.center_px + offset * share, np.float64)
        inverse: FloatArray = np.linalg.inv(self._matrix).astype(np.float64)
        return _homogeneous(inverse, plain)

    def jacobian(self, floor: FloatArray) -> FloatArray:
        """Return the derivative of ``image`` at floor points, shape (..., 2, 2), in px per unit."""
        points = np.asarray(floor, np.float64)
        matrix = self._matrix
        depth = (points @ matrix[2, :2] + matrix[2, 2])[..., None]
        plain = (points @ matrix[:2, :2].T + matrix[:2, 2]) / depth
        flat = (matrix[:2, :2] - plain[..., :, None] * matrix[2, :2]) / depth[..., None]
        offset = (plain - self.center_px) / self.radius_px
        square = np.sum(offset * offset, axis=-1)[..., None, None]
        outer = offset[..., :, None] * offset[..., None, :]
        radial = (1.0 + self.radial * square) * np.eye(2) + 2.0 * self.radial * outer
        return np.asarray(radial @ flat)

    def scale(self, floor: FloatArray) -> FloatArray:
        """Return how many pixels one floor unit spans at floor points: the root of the determinant."""
        return np.asarray(np.sqrt(np.abs(np.linalg.det(self.jacobian(floor)))))

    def after(self, rows: FloatArray) -> "FloorMap":
        """Return the map from another floor frame.

        Args:
            rows: This map's frame from the other one, ``[[a, b, tx], [c, d, ty]]``, shape (2, 3).
        """
        whole = self._matrix @ np.vstack([rows, (0.0, 0.0, 1.0)])
        whole /= whole[2, 2]
        return FloorMap(tuple(whole.ravel().tolist()), self.center_px, self.radial, self.radius_px)

    def best_affine(self, size: float) -> FloatArray:
        """Return the affine map nearest to this one over the square from 0 to ``size``, shape (2, 3)."""
        line = np.linspace(0.0, size, 9)
        points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
        design = np.column_stack([points, np.ones(len(points))])
        rows, *_ = np.linalg.lstsq(design, self.image(points), rcond=None)
        return np.asarray(rows.T)

    @property
    def _fold(self) -> float:
        """The undistorted radius at which a negative distortion would fold over."""
        return float(1.0 / np.sqrt(-3.0 * self.radial)) if self.radial < -1e-12 else np.inf


@dataclass(frozen=True, slots=True)
class TipMap:
    """Where the tip appears: the floor point that it hides from the camera.

    ``u = (A·[x y z]) / (1 - z / WD) + u₀``, nine numbers, in stage coordinates. On the floor (not in the
    image) this is exact for a camera at any tilt and with any lens; the floor map has tilt and lens.

    Attributes:
        matrix: A, row-major, six numbers, floor units per µm.
        offset: u₀, in floor units.
        camera_z_um: WD, the stage z of the camera's entrance pupil.

    Raises:
        ValueError: If a number is not finite, or the map is singular.
    """

    matrix: tuple[float, ...]
    offset: tuple[float, float]
    camera_z_um: float

    def __post_init__(self) -> None:
        if len(self.matrix) != 6 or not np.all(np.isfinite((*self.matrix, *self.offset, self.camera_z_um))):
            raise ValueError("a tip map takes six finite numbers, an offset and the camera's height")
        if self.camera_z_um == 0.0 or abs(np.linalg.det(self._rows[:, :2])) < 1e-300:
            raise ValueError("a tip map that is singular has no inverse")

    @property
    def _rows(self) -> FloatArray:
        return np.array(self.matrix).reshape(2, 3)

    def floor(self, tip_um: FloatArray) -> FloatArray:
        """Return the floor points that tips hide.

        Args:
            tip_um: Stage x, y, z, shape (..., 3).

        Returns:
            Shape (..., 2).
        """
        tip_um = np.asarray(tip_um, np.float64)
        share = np.maximum(1.0 - tip_um[..., 2:] / self.camera_z_um, 1e-6)
        return np.asarray(tip_um @ self._rows.T / share + self.offset)

    def stage_xy_um(self, floor: FloatArray, z_um: float) -> FloatArray:
        """Return the stage x, y at which a tip at a height hides floor points, shape (..., 2)."""
        rows, share = self._rows, 1.0 - z_um / self.camera_z_um
        flat = (np.asarray(floor, np.float64) - self.offset) * share - rows[:, 2] * z_um
        return np.asarray(flat @ np.linalg.inv(rows[:, :2]).T)

    def at_height(self, z_um: float) -> FloatArray:
        """Return the affine floor from stage x, y for tips at a height, shape (2, 3)."""
        rows, share = self._rows, 1.0 - z_um / self.camera_z_um
        return np.column_stack([rows[:, :2] / share, rows[:, 2] * z_um / share + self.offset])

    def true_size_z_um(self) -> float:
        """Return the stage z at which the tip's motion appears in true size, for a floor in µm.

        That is the floor's plane seen without water: the plane of the apparent floor.
        """
        return float(self.camera_z_um * (1.0 - np.sqrt(abs(np.linalg.det(self._rows[:, :2])))))

    def then(self, rows: FloatArray) -> "TipMap":
        """Return the map into another floor frame.

        Args:
            rows: The other frame from this map's, ``[[a, b, tx], [c, d, ty]]``, shape (2, 3).
        """
        linear = np.asarray(rows)[:, :2]
        offset = linear @ self.offset + np.asarray(rows)[:, 2]
        matrix = (linear @ self._rows).ravel()
        return TipMap(tuple(matrix.tolist()), (float(offset[0]), float(offset[1])), self.camera_z_um)


def _homogeneous(matrix: FloatArray, points: FloatArray) -> FloatArray:
    points = np.asarray(points, np.float64)
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(mapped[..., :2] / mapped[..., 2:])
