"""Labelled states for cloning: what the shortest path would do from anywhere to anywhere."""

import numpy as np

from mrnav_server.autonomy.geodesic_policy import GeodesicPolicy
from mrnav_server.core.arrays import Float32Array
from mrnav_server.core.navigation import ARRIVAL_PX, is_free, observation
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.batch import draw_pairs, free_points


def draw_states(
    vessel: VesselMap, count: int, random: np.random.Generator, near_share: float = 0.2
) -> Float32Array:
    """Draw observations uniformly from the free space, some of them close to their target.

    Args:
        vessel: The vessel model.
        count: How many.
        random: Source of all randomness.
        near_share: Share that is drawn 12 to 120 px from the target, where precision counts.

    Returns:
        Shape (count, 6), float32, in grid pixels.
    """
    points = free_points(vessel)
    position, target = draw_pairs(points, count, random)
    near = round(count * near_share)
    angle, reach_px = random.uniform(0, 2 * np.pi, near), random.uniform(12, 120, near)
    close = np.rint(target[:near] + reach_px[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    usable = is_free(vessel.free, close) & (np.hypot(*(close - target[:near]).T) >= ARRIVAL_PX)
    position[:near][usable] = close[usable]
    return observation(position, position, target)


def label(expert: GeodesicPolicy, observations: Float32Array, chunk: int = 16_384) -> Float32Array:
    """Return the expert's logits, shape (n, 6) to shape (n, 40), in chunks that fit the cache."""
    pieces = np.array_split(observations, len(observations) // chunk + 1)
    return np.concatenate([expert.logits(piece) for piece in pieces])
