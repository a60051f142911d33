"""Small vessels for tests."""

from pathlib import Path

import numpy as np

from mrnav_server.core.vessel import VesselMap
from mrnav_server.vision.vessel_model import save_vessel_model, vessel_map


def corner() -> VesselMap:
    """Return an L: free space x 31..169 at y 31..59 and, at its right end, x 141..169 down to y 169."""
    mask = np.zeros((200, 200), np.uint8)
    mask[20:71, 20:181] = 255
    mask[20:181, 130:181] = 255
    return vessel_map("corner", mask, robot_radius_um=100.0)


def chamber() -> VesselMap:
    """Return a square without walls inside."""
    return vessel_map("chamber", np.full((60, 60), 255, np.uint8), robot_radius_um=100.0)


def saved_chamber(folder: Path) -> Path:
    """Save the chamber as a vessel model below a folder; return where."""
    save_vessel_model(folder / "chamber", chamber(), "chamber", "test")
    return folder / "chamber"
