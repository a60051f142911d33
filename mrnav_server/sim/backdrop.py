"""The still part of the simulated picture: a printed vessel model in a dish, under a ring light.

Everything is a closed form of the signed distance to the wall, so any vessel at any scale gets walls.
"""

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray, Float32Array, FloatArray
from mrnav_server.core.frames import Affine2
from mrnav_server.core.vessel import VesselMap

_LIGHT = (-0.6, -0.8)
"""Where the light comes from, in the image; the sphere's highlight and shadow agree with it."""
_BODY_BGR = (146.0, 150.0, 150.0)
_LUMEN_BGR = (211.0, 209.0, 198.0)
_DISH_BGR = (98.0, 92.0, 87.0)


def backdrop(
    vessel: VesselMap,
    image_from_vessel: Affine2,
    width_px: int,
    height_px: int,
    rng: np.random.Generator,
    seen_px: FloatArray | None = None,
) -> ByteArray:
    """Paint the channel's floor, walls, print texture and illumination.

    Args:
        vessel: The vessel model.
        image_from_vessel: Where its grid appears, at least nearly.
        width_px: Image width.
        height_px: Image height.
        rng: Draws the texture and the dust.
        seen_px: The grid point that each pixel shows, shape (height, width, 2), where that is not affine.

    Returns:
        Shape (height, width, 3), BGR, uint8.
    """
    size = (width_px, height_px)
    um_per_px = vessel.um_per_px / image_from_vessel.linear_scale
    matrix = np.array(image_from_vessel.rows())

    def seen(grid: Float32Array, outside: float) -> Float32Array:
        if seen_px is None:
            return _warp(grid, matrix, size, outside)
        return sampled(grid, seen_px, outside)

    wall_um = seen(vessel.distance_px * np.float32(vessel.um_per_px), -600.0)
    model = seen(np.ones_like(vessel.distance_px), 0.0)
    lumen = _smooth_step(wall_um, -12.0, 12.0)

    body = np.empty((height_px, width_px, 3), np.float32)
    body[:] = _BODY_BGR
    body += _print_texture(size, um_per_px, rng)[..., None]
    picture = _mix(body, _LUMEN_BGR, lumen)
    picture += _wall_shading(wall_um, um_per_px)[..., None]
    picture *= _cast_shadow(lumen, um_per_px)[..., None]
    picture += _grain(size, 350.0 / um_per_px, rng)[..., None] * 1.6
    picture = _mix(np.full_like(picture, _DISH_BGR), picture, model)
    _block_edge(picture, model, um_per_px)
    _dust(picture, um_per_px, rng)
    picture *= _illumination(size)[..., None]
    picture = cv2.GaussianBlur(picture, (0, 0), 1.0).astype(np.float32)
    return np.clip(picture, 0.0, 255.0).astype(np.uint8)


def sampled(grid: Float32Array, at_px: FloatArray, outside: float) -> Float32Array:
    """Return a grid's values at points, shape (height, width); beyond the grid ``outside``."""
    x, y = (np.ascontiguousarray(at_px[..., axis], np.float32) for axis in (0, 1))
    values = cv2.remap(
        grid, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=float(outside)
    )
    return values.astype(np.float32)


def _warp(array: Float32Array, matrix: np.ndarray, size: tuple[int, int], outside: float) -> Float32Array:
    warped = cv2.warpAffine(
        array, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=outside
    )
    return warped.astype(np.float32)


def _smooth_step(values: Float32Array, low: float, high: float) -> Float32Array:
    t = np.clip((values - np.float32(low)) / np.float32(high - low), 0.0, 1.0)
    step: Float32Array = t * t * (3.0 - 2.0 * t)
    return step


def _mix(
    below: Float32Array, above: Float32Array | tuple[float, float, float], share: Float32Array
) -> Float32Array:
    return below + (np.asarray(above, np.float32) - below) * share[..., None]


def _grain(size: tuple[int, int], sigma_px: float, rng: np.random.Generator) -> Float32Array:
    """Return a smooth random field of unit variance; drawn coarse, since it holds no fine detail."""
    step = max(1.0, sigma_px / 2.0)
    shape = (int(size[1] / step) + 2, int(size[0] / step) + 2)
    coarse = cv2.GaussianBlur(rng.standard_normal(shape).astype(np.float32), (0, 0), sigma_px / step)
    field = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC).astype(np.float32)
    return field / np.float32(field.std())


def _print_texture(size: tuple[int, int], um_per_px: float, rng: np.random.Generator) -> Float32Array:
    """Return the layer lines and blotches that 3D printing leaves on the model's body."""
    y_um = np.arange(size[1], dtype=np.float32)[:, None] * np.float32(um_per_px)
    x_um = np.arange(size[0], dtype=np.float32)[None, :] * np.float32(um_per_px)
    phase = _grain(size, 2500.0 / um_per_px, rng) * np.float32(0.5)
    raster = np.sin((x_um * 0.35 + y_um) * np.float32(2 * np.pi / 210.0) + phase)
    lines: Float32Array = 1.5 * raster + 1.7 * _grain(size, 40.0 / um_per_px, rng)
    return lines + 2.0 * _grain(size, 900.0 / um_per_px, rng)


def _wall_shading(wall_um: Float32Array, um_per_px: float) -> Float32Array:
    """Return gray levels for the wall: a dark refracting line, a bright lip, one flank lit, one in shade."""
    smooth = cv2.GaussianBlur(wall_um, (0, 0), 30.0 / um_per_px)
    gx = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1.0 / (8.0 * um_per_px))
    gy = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1.0 / (8.0 * um_per_px))
    # The distance grows into the channel, so its gradient is the wall's normal.
    facing = np.clip(gx * np.float32(_LIGHT[0]) + gy * np.float32(_LIGHT[1]), -1.0, 1.0)
    flank = np.exp(-(((wall_um - 70.0) / 130.0) ** 2))
    line = np.exp(-(((wall_um - 8.0) / 38.0) ** 2))
    lip = np.exp(-(((wall_um + 75.0) / 40.0) ** 2))
    inner = np.exp(-((np.maximum(wall_um, 0.0) / 420.0) ** 2)) * (wall_um > 0)
    shading: Float32Array = -66.0 * line + 24.0 * lip * (0.55 - 0.45 * facing) - 11.0 * inner
    shading += flank * np.where(facing > 0, 13.0, 20.0).astype(np.float32) * facing
    return shading


def _cast_shadow(lumen: Float32Array, um_per_px: float) -> Float32Array:
    """Return the light that is left in the channel behind the wall on the light's side."""
    reach_px = 330.0 / um_per_px
    shift = np.array([[1.0, 0.0, -_LIGHT[0] * reach_px], [0.0, 1.0, -_LIGHT[1] * reach_px]])
    lit = cv2.warpAffine(lumen, shift, lumen.shape[::-1], flags=cv2.INTER_LINEAR)
    lit = cv2.GaussianBlur(lit, (0, 0), 150.0 / um_per_px)
    return (1.0 - 0.17 * lumen * (1.0 - lit)).astype(np.float32)


def _block_edge(picture: Float32Array, model: Float32Array, um_per_px: float) -> None:
    """Shade the rim of the printed block, where it meets the dish."""
    soft = cv2.GaussianBlur(model, (0, 0), 160.0 / um_per_px)
    shade = np.where(model > 0.5, (1.0 - soft) * 0.22, soft * 0.45).astype(np.float32)
    picture *= (1.0 - shade)[..., None]


def _dust(picture: Float32Array, um_per_px: float, rng: np.random.Generator) -> None:
    """Add specks, far smaller than the robot."""
    height, width = picture.shape[:2]
    veil = np.zeros((height, width), np.float32)
    for _ in range(46):
        center = (int(rng.integers(width)), int(rng.integers(height)))
        radius = max(1, round(float(rng.uniform(8.0, 34.0)) / um_per_px))
        cv2.circle(veil, center, radius, float(rng.uniform(0.1, 0.4)), -1, cv2.LINE_AA)
    picture *= (1.0 - cv2.GaussianBlur(veil, (0, 0), 1.1))[..., None]


def _illumination(size: tuple[int, int]) -> Float32Array:
    x = np.linspace(-0.46, 0.54, size[0], dtype=np.float32)[None, :]
    y = np.linspace(-0.47, 0.53, size[1], dtype=np.float32)[:, None]
    light: Float32Array = np.float32(1.05) - np.float32(0.52) * (x * x + y * y)
    return light
