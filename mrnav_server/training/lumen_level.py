"""Which part of a photograph is lumen: a map that is positive inside it."""

from typing import Literal

import cv2
import numpy as np

from mrnav_server.core.arrays import BoolArray, Float32Array, FloatArray
from mrnav_server.core.errors import ConfigError

Polarity = Literal["auto", "bright", "dark"]
Side = Literal["bright", "dark"]

_SMOOTH_UM = 60.0
"""Noise and print layers are finer than this; the robot is 1000 µm wide."""
_LIGHT_UM = 3000.0
"""Light varies more slowly than this; vessels are narrower than about twice as much."""
_LIGHT_SAMPLE_UM = 80.0
_LEAST_SPREAD = 0.004
"""Standard deviation of the flattened brightness (0..1) below which a picture shows nothing."""


def is_mask(gray: Float32Array) -> bool:
    """Tell whether a picture is black and white already: nearly all of it at the ends of its range."""
    low, high = float(gray.min()), float(gray.max())
    if high - low < 0.5:
        return False
    return bool(np.mean(np.abs(gray - (low + high) / 2) > 0.45 * (high - low)) > 0.95)


def mask_level(gray: Float32Array, polarity: Polarity) -> tuple[Float32Array, Side]:
    """Return the level of a picture that is a mask: brightness above or below its middle."""
    level = gray - (float(gray.min()) + float(gray.max())) / 2
    side = _side(level > 0, np.ones(gray.shape, dtype=bool), polarity)
    return (level if side == "bright" else -level), side


def photograph_level(
    picture: Float32Array, field: BoolArray, um_per_px: float, polarity: Polarity
) -> tuple[Float32Array, Side]:
    """Return the level of a photograph.

    The light is flattened, the lumen starts from Otsu's threshold on the colour channel that separates best,
    and its wall is then put half-way between the local brightness of lumen and background, so that neither
    uneven light nor wide vessels shift it.

    Args:
        picture: Shape (height, width, 3), 0..1.
        field: Where it shows anything, shape (height, width).
        um_per_px: Size of one of its pixels in µm.
        polarity: Whether the lumen is bright or dark; ``auto`` takes what covers less of the field's edge.

    Returns:
        The level, shape (height, width), and which part is the lumen.

    Raises:
        ConfigError: If the picture is uniform.
    """
    sigma_px = max(_SMOOTH_UM / um_per_px, 0.3)
    planes = [
        cv2.GaussianBlur(plane, (0, 0), sigma_px).astype(np.float32, copy=False)
        for plane in cv2.split(picture)
    ]
    flat = [plane - _local_mean(plane, field, um_per_px) for plane in planes]
    spread = [float(plane[field].std()) for plane in flat]
    if max(spread) < _LEAST_SPREAD:
        raise ConfigError("photograph: no lumen found, the picture is uniform; use one with more contrast")
    worth = [each * _separability(plane[field]) for each, plane in zip(spread, flat, strict=True)]
    best = flat[int(np.argmax(worth))]
    side = _side(best > _otsu(best[field]), field, polarity)
    contrast = best if side == "bright" else -best
    lumen = field & (contrast > _otsu(contrast[field]))
    level = contrast
    for _ in range(3):
        inside = _local_level(contrast, lumen, field, um_per_px)
        outside = _local_level(contrast, field & ~lumen, field, um_per_px)
        level = contrast - (inside + outside) / 2
        lumen = field & (level > 0)
    level[~field] = -np.abs(level).max()
    return level, side


def _side(bright: BoolArray, field: BoolArray, polarity: Polarity) -> Side:
    if polarity != "auto":
        return polarity
    inner = cv2.erode(field.astype(np.uint8), np.ones((3, 3)), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return "bright" if bright[field & (inner == 0)].mean() < 0.5 else "dark"


def _local_mean(values: Float32Array, weight: BoolArray, um_per_px: float) -> Float32Array:
    """Return the Gaussian mean of the weighted pixels around each pixel."""
    near = np.maximum(_blurred(weight, um_per_px), 1e-6)
    return (_blurred(values * weight, um_per_px) / near).astype(np.float32)


def _local_level(values: Float32Array, part: BoolArray, field: BoolArray, um_per_px: float) -> Float32Array:
    """Return a part's brightness around each pixel, drawn to its mean where little of the part is near."""
    mean = np.float32(values[part].mean() if part.any() else 0.0)
    trust = np.float32(0.1) * _blurred(field, um_per_px)
    near = _blurred(part, um_per_px) + trust + np.float32(1e-6)
    return ((_blurred(values * part, um_per_px) + mean * trust) / near).astype(np.float32)


def _blurred(values: Float32Array | BoolArray, um_per_px: float) -> Float32Array:
    """Blur over the scale on which light varies; outside the picture counts as zero."""
    height, width = values.shape
    factor = min(1.0, um_per_px / _LIGHT_SAMPLE_UM)
    small = cv2.resize(
        values.astype(np.float32),
        (max(round(width * factor), 1), max(round(height * factor), 1)),
        interpolation=cv2.INTER_AREA,
    )
    sigma_px = _LIGHT_UM / um_per_px * factor
    blurred = cv2.GaussianBlur(small, (0, 0), sigma_px, borderType=cv2.BORDER_CONSTANT)
    return cv2.resize(blurred, (width, height), interpolation=cv2.INTER_LINEAR).astype(np.float32)


def _between_variance(values: Float32Array) -> tuple[FloatArray, FloatArray]:
    """Return Otsu's between-class variance for each threshold, and the thresholds."""
    counts, edges = np.histogram(values, 512)
    share, centre = counts / counts.sum(), (edges[:-1] + edges[1:]) / 2
    low, moment = np.cumsum(share), np.cumsum(share * centre)
    return (moment[-1] * low - moment) ** 2 / np.maximum(low * (1 - low), 1e-12), centre


def _otsu(values: Float32Array) -> float:
    variance, threshold = _between_variance(values)
    return float(threshold[int(np.argmax(variance))])


def _separability(values: Float32Array) -> float:
    variance, _ = _between_variance(values)
    return float(variance.max() / max(float(values.var()), 1e-12))
