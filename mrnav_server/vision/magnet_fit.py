"""From approaches and a descent to the magnet's offset, the robot's friction and the critical height."""

from dataclasses import dataclass

import numpy as np

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.errors import RefusedError

FEWEST_APPROACHES = 4
MOST_UNBALANCED = 0.25
"""Longest mean of the headings' unit vectors; beyond, friction would pass for an offset."""
RMS_MAX_UM = 120.0
"""Approaches that scatter by more say that something else than friction held the robot."""


@dataclass(frozen=True, slots=True)
class MagnetFit:
    """Where the tip stands over a robot at rest, and what friction adds.

    Attributes:
        offset_um: Mean over the approaches, stage x, y: needle tilt and ambient field.
        friction_lead_um: How far the tip runs ahead of that before friction gives way: half the spread.
        approaches: How many there were.
        rms_um: How far single approaches are from offset and lead, corrected for three fitted numbers.
    """

    offset_um: tuple[float, float]
    friction_lead_um: float
    approaches: int
    rms_um: float


def fit_magnet(gaps_um: FloatArray, headings: FloatArray) -> MagnetFit:
    """Split the gap between tip and robot into a constant offset and a lead along the heading.

    Args:
        gaps_um: Tip less robot after each approach, stage x, y, shape (n, 2).
        headings: Unit vectors along which the tip came, stage x, y, shape (n, 2).

    Raises:
        RefusedError: If the approaches are too few or one-sided, or contradict each other.
    """
    count = len(gaps_um)
    if count < FEWEST_APPROACHES:
        raise RefusedError(
            "few_approaches", f"{count} approaches are not enough: come from {FEWEST_APPROACHES} directions"
        )
    one_sided = float(np.linalg.norm(headings.mean(axis=0)))
    narrow = float(np.linalg.svd(headings, compute_uv=False)[-1]) / np.sqrt(count)
    if one_sided > MOST_UNBALANCED or narrow < 0.4:
        raise RefusedError(
            "one_sided",
            "the approaches come from one side, so friction would pass for an offset: spread them all round",
        )
    design = np.zeros((2 * count, 3))
    design[0::2, 0] = design[1::2, 1] = 1.0
    design[:, 2] = headings.ravel()
    found, *_ = np.linalg.lstsq(design, gaps_um.ravel())
    misses = (gaps_um.ravel() - design @ found).reshape(-1, 2)
    rms_um = float(np.sqrt(np.sum(misses**2) / (count - 1.5)))
    if rms_um > RMS_MAX_UM:
        raise RefusedError(
            "magnet_residual",
            f"the approaches contradict each other by {rms_um:.0f} µm RMS, {RMS_MAX_UM:.0f} µm are allowed:"
            " keep the robot off walls and dirt, and try again",
        )
    if found[2] < -RMS_MAX_UM:
        raise RefusedError(
            "negative_lead", "the robot ran ahead of the magnet: the fluid flows or the plate tilts"
        )
    return MagnetFit((float(found[0]), float(found[1])), max(float(found[2]), 0.0), count, rms_um)


@dataclass(frozen=True, slots=True)
class HeightFit:
    """The critical height.

    Attributes:
        critical_height_um: h*, midway between the last stop at which the robot lay and the next.
        step_um: Distance of these two; the height is known to half of it.
        jump_z_um: Stage z at which the robot was gone.
    """

    critical_height_um: float
    step_um: float
    jump_z_um: float


def fit_height(z_um: FloatArray, seen: list[bool], floor_z_um: float) -> HeightFit:
    """Find where the robot jumped on the way down.

    Args:
        z_um: Stage z of each stop, strictly falling, shape (n,).
        seen: Whether the robot lay on the floor at each stop.
        floor_z_um: Stage z at which the magnet's centre would touch the robot's centre.

    Raises:
        RefusedError: If it did not jump, was gone from the start, or was seen again below.
    """
    if not seen or not seen[0]:
        raise RefusedError(
            "no_robot", "no robot was seen at the start of the descent: put it under the magnet"
        )
    if all(seen):
        raise RefusedError(
            "no_jump",
            f"the robot did not jump down to z = {z_um[-1]:.0f} µm: bring it nearer to the magnet's axis",
        )
    gone = seen.index(False)
    if any(seen[gone:]):
        raise RefusedError(
            "seen_again", "the robot was lost and seen again: clear the view and descend once more"
        )
    middle_um = 0.5 * float(z_um[gone - 1] + z_um[gone])
    return HeightFit(middle_um - floor_z_um, float(z_um[gone - 1] - z_um[gone]), float(z_um[gone]))
