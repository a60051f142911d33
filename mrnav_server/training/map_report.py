"""What a vessel model is like: widths, length, junctions, and where the robot does not fit."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mrnav_server.core.arrays import BoolArray
from mrnav_server.core.vessel import VesselMap
from mrnav_server.training.centre_line import Branch, CentreLine, centre_line
from mrnav_server.vision.vessel_model import PLAY_UM

_PLANNER_CELL_PX = 8
_PLANNER_BYTES = 8


@dataclass(frozen=True, slots=True)
class TightPlace:
    """A stretch of the centre line that is too narrow for the robot and the play that it needs.

    Attributes:
        x_px: Where the lumen is narrowest, in grid pixels.
        y_px: Likewise.
        width_um: Width of the lumen there.
        length_um: Length of the stretch.
    """

    x_px: int
    y_px: int
    width_um: float
    length_um: float


@dataclass(frozen=True, slots=True)
class MapReport:
    """A vessel model in figures.

    Attributes:
        vessel: The vessel model.
        line: Its centre line.
        length_um: Length of the centre line.
        reached_um: Length of that part of it where the robot's centre can go.
        widths_um: Smallest, median and largest width along the centre line.
        tight: Where the robot does not fit, the longest stretch first.
        training_memory_gb: What the planner needs when a policy is cloned from it.
    """

    vessel: VesselMap
    line: CentreLine
    length_um: float
    reached_um: float
    widths_um: tuple[float, float, float]
    tight: tuple[TightPlace, ...]
    training_memory_gb: float

    @property
    def free_fraction(self) -> float:
        """Share of the grid in which the robot's centre can be."""
        return float(self.vessel.free.mean())

    @property
    def junctions(self) -> int:
        """Places where at least three vessels meet."""
        return len(self.line.junctions_px)

    def record(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        return {
            "model": self.vessel.name,
            "free_fraction": round(self.free_fraction, 5),
            "junctions": self.junctions,
            "length_um": round(self.length_um, 1),
        }

    def details(self) -> dict[str, Any]:
        """Return all figures for JSON."""
        least_um, median_um, most_um = (round(width_um, 1) for width_um in self.widths_um)
        return self.record() | {
            "size_um": self.vessel.size_px * self.vessel.um_per_px,
            "reached_um": round(self.reached_um, 1),
            "width_um": {"least": least_um, "median": median_um, "most": most_um},
            "tight": [asdict(place) for place in self.tight],
        }


def map_report(vessel: VesselMap) -> MapReport:
    """Measure a vessel model."""
    line = centre_line(vessel)
    widths_px = np.concatenate([branch.width_px for branch in line.branches])
    reached_px = sum(branch.length_px * _share_reached(branch, vessel) for branch in line.branches)
    tight = [place for branch in line.branches for place in _tight_places(branch, vessel)]
    nodes = vessel.free[_PLANNER_CELL_PX // 2 :: _PLANNER_CELL_PX, _PLANNER_CELL_PX // 2 :: _PLANNER_CELL_PX]
    return MapReport(
        vessel=vessel,
        line=line,
        length_um=line.length_px * vessel.um_per_px,
        reached_um=reached_px * vessel.um_per_px,
        widths_um=(
            float(widths_px.min()) * vessel.um_per_px,
            float(np.median(widths_px)) * vessel.um_per_px,
            float(widths_px.max()) * vessel.um_per_px,
        ),
        tight=tuple(sorted(tight, key=lambda place: -place.length_um)),
        training_memory_gb=float(nodes.sum()) ** 2 * _PLANNER_BYTES / 1e9,
    )


def too_narrow(branch: Branch, vessel: VesselMap) -> BoolArray:
    """Return where along a branch the robot, with the play that it needs, does not fit."""
    needed_px = 2 * (vessel.robot_radius_px + PLAY_UM / vessel.um_per_px)
    x, y = branch.path_px.T
    # A centre line of pixels may lie beside the middle by one or two.
    return np.asarray((branch.width_px <= needed_px) & ~vessel.free[y, x])


def _share_reached(branch: Branch, vessel: VesselMap) -> float:
    x, y = branch.path_px.T
    return float(vessel.free[y, x].mean())


def _tight_places(branch: Branch, vessel: VesselMap) -> list[TightPlace]:
    narrow = np.flatnonzero(too_narrow(branch, vessel))
    # Between two stretches nearer than the robot's radius there is no place to be.
    stretches = np.split(narrow, np.flatnonzero(np.diff(narrow) > vessel.robot_radius_px) + 1)
    places = []
    for stretch in stretches if len(narrow) else []:
        at = stretch[int(branch.width_px[stretch].argmin())]
        share = (stretch[-1] - stretch[0] + 1) / len(branch.path_px)
        places.append(
            TightPlace(
                x_px=int(branch.path_px[at, 0]),
                y_px=int(branch.path_px[at, 1]),
                width_um=float(branch.width_px[at]) * vessel.um_per_px,
                length_um=float(share) * branch.length_px * vessel.um_per_px,
            )
        )
    return places
