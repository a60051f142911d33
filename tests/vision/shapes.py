"""Robots that are no spheres, drawn onto rendered pictures: a helix and a swarm."""

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray, FloatArray


class Shape:
    """A flat dark shape; its true centre is the centroid of its area.

    Args:
        cover: Share of each fine pixel that it covers, shape (4n, 4n), centred on the picture.
    """

    def __init__(self, cover: FloatArray) -> None:
        self._cover = cover
        y, x = np.mgrid[0 : cover.shape[0], 0 : cover.shape[1]]
        self._middle = np.array([np.sum(x * cover), np.sum(y * cover)]) / np.sum(cover)

    def paint(self, image: ByteArray, x_px: float, y_px: float, gray: float = 45.0) -> ByteArray:
        """Return the picture with the shape's centroid at a point."""
        side = self._cover.shape[0] // 4 + 8
        left, top = int(x_px) - side // 2, int(y_px) - side // 2
        # Fine pixel (u, v) is centred on image pixel ((u + 0.5)/4 - 0.5).
        shift = 4.0 * (np.array([x_px - left, y_px - top]) + 0.5) - 0.5 - self._middle
        fine = cv2.warpAffine(
            self._cover, np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]]), (4 * side, 4 * side)
        )
        cover = cv2.resize(fine, (side, side), interpolation=cv2.INTER_AREA)[..., None]
        painted = image.copy()
        box = painted[top : top + side, left : left + side]
        box[:] = np.rint(box * (1.0 - cover) + gray * cover).astype(np.uint8)
        return painted


def helix(turned: float = 0.4) -> Shape:
    """Return a helical robot seen from the side: 66 px long, 22 px wide."""
    t = np.linspace(-1.0, 1.0, 200)
    along, across = 31.0 * t, 8.0 * np.sin(2.0 * np.pi * 2.5 * t)
    x = np.cos(turned) * along - np.sin(turned) * across
    y = np.sin(turned) * along + np.cos(turned) * across
    cover = np.zeros((400, 400), np.uint8)
    points = np.rint(np.column_stack([x, y]) * 4.0 * 16.0 + 200.0 * 16.0).astype(np.int32)
    cv2.polylines(cover, [points], False, 255, 22, cv2.LINE_AA, shift=4)
    return Shape(np.asarray(cv2.GaussianBlur(cover / 255.0, (0, 0), 3.0), np.float64))


def swarm(seed: int, count: int = 60) -> Shape:
    """Return particles of 5 px in a cloud of about 60 px."""
    rng = np.random.default_rng(seed)
    cover = np.zeros((400, 400), np.uint8)
    for x, y in rng.uniform(-1.0, 1.0, (count, 2)):
        if np.hypot(x, y) < 1.0:
            cv2.circle(cover, (round(200.0 + 110.0 * x), round(200.0 + 110.0 * y)), 10, 255, -1, cv2.LINE_AA)
    return Shape(np.asarray(cv2.GaussianBlur(cover / 255.0, (0, 0), 3.0), np.float64))
