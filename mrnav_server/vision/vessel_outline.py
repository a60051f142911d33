"""A vessel model's walls as lines, for whoever draws them."""

import cv2
import numpy as np

from mrnav_server.core.vessel import VesselMap

_OFF_PX = 0.7
"""So far may a wall be off its mask."""


def walls_px(vessel: VesselMap) -> list[list[list[int]]]:
    """Return the lumen's outlines as closed lines in the vessel's grid."""
    lines, _ = cv2.findContours(vessel.lumen.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    walls: list[list[list[int]]] = [
        cv2.approxPolyDP(line, _OFF_PX, closed=True)[:, 0].tolist() for line in lines
    ]
    return [wall for wall in walls if len(wall) > 2]
