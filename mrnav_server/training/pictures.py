"""What the figures share: the vessel as a backdrop, and colours that colour-blind readers tell apart."""

import numpy as np
from matplotlib.axes import Axes

from mrnav_server.core.vessel import VesselMap

# Okabe and Ito's.
BLUE, VERMILION, GREEN, PURPLE, GRAY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#666666"


def draw_vessel(axes: Axes, vessel: VesselMap) -> float:
    """Draw the lumen, and where the robot's centre fits, on axes in millimetres; return mm per grid pixel."""
    mm_per_px = vessel.um_per_px / 1000.0
    size_mm = vessel.size_px * mm_per_px
    shade = np.where(vessel.free, 1.0, np.where(vessel.lumen, 0.94, 0.8))
    # Flat shades without interpolation keep the PNG small.
    extent = (0.0, size_mm, size_mm, 0.0)
    axes.imshow(shade, cmap="gray", vmin=0.0, vmax=1.0, extent=extent, interpolation="nearest")
    axes.set(xlim=(0.0, size_mm), ylim=(size_mm, 0.0), aspect="equal")
    return mm_per_px
