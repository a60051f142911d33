"""Invented photographs of printed vessels, with all that makes them hard."""

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray


def photographed(mask: ByteArray, um_per_px: float, seed: int, *, dark: bool, quality: int = 70) -> ByteArray:
    """Photograph a lumen on a grid of 10 µm: uneven light, reflections, bubbles, dust, blur, noise."""
    random = np.random.default_rng(seed)
    size = round(len(mask) * 10.0 / um_per_px)
    lumen = cv2.resize(mask.astype(np.float32) / 255, (size, size), interpolation=cv2.INTER_AREA)
    y, x = np.mgrid[:size, :size] / size
    angle = random.uniform(0, 2 * np.pi)
    light = 0.75 + 0.5 * (np.cos(angle) * (x - 0.5) + np.sin(angle) * (y - 0.5))
    light *= 1.0 - 0.5 * ((x - 0.5) ** 2 + (y - 0.5) ** 2)
    inside, outside = (0.45, 0.75) if dark else (0.75, 0.45)
    picture = (outside + (inside - outside) * lumen) * light
    per_mm = 1000.0 / um_per_px
    rows, columns = np.nonzero(lumen > 0.99)
    for at in random.integers(len(rows), size=12):  # bubbles: a dark rim and a highlight
        centre, radius = (int(columns[at]), int(rows[at])), int(random.uniform(0.1, 0.3) * per_mm)
        cv2.circle(picture, centre, radius, 0.3, max(radius // 4, 1), cv2.LINE_AA)
        cv2.circle(picture, centre, max(radius // 4, 1), 1.0, -1, cv2.LINE_AA)
    for at in random.integers(len(rows), size=4):  # reflections along the vessel
        start = np.array([columns[at], rows[at]])
        end = start + random.normal(0, 0.6 * per_mm, 2)
        cv2.line(
            picture, start.tolist(), end.astype(int).tolist(), 1.0, max(int(0.1 * per_mm), 1), cv2.LINE_AA
        )
    for _ in range(25):  # dust
        cv2.circle(picture, random.integers(size, size=2).tolist(), max(int(0.06 * per_mm), 1), 0.2, -1)
    picture = cv2.GaussianBlur(picture, (0, 0), 0.05 * per_mm)
    shot = np.stack([picture * gain for gain in (0.8, 0.95, 1.0)], axis=2)
    shot += random.normal(0, 0.03, shot.shape)
    _, encoded = cv2.imencode(
        ".jpg", (shot * 255).clip(0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality]
    )
    return np.frombuffer(encoded.tobytes(), np.uint8)
