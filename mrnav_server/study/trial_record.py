"""What a study needs of a trial's log, as arrays."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mrnav_server.core.arrays import BoolArray, FloatArray
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.trial_log import LOG_NAME, TrialHeader, read_header, read_log


@dataclass(frozen=True)
class TrialRecord:
    """A trial's tracks and marks.

    Attributes:
        id: The trial's id.
        header: The log's first line.
        t_s: Capture time of every track, monotonic, in seconds, shape (n,), n >= 1.
        vessel_px: Where the robot was in the vessel's grid, shape (n, 2); NaN where it was not seen.
        sigma_um: The tracker's noise at each, shape (n,); NaN where unknown.
        modes: The mode in force at each, length n; "" before the first.
        go_s: The go cue, or the first track without one.
        end_s: Target reached, else the end mark, else the last track.
        reached: Whether the target was reached.
    """

    id: str
    header: TrialHeader
    t_s: FloatArray
    vessel_px: FloatArray
    sigma_um: FloatArray
    modes: list[str]
    go_s: float
    end_s: float
    reached: bool

    @property
    def simulated(self) -> bool:
        """Whether the rig or the operator was simulated."""
        return self.header.simulated_rig or self.header.operator_kind == "simulated"

    @property
    def inside(self) -> BoolArray:
        """Which tracks lie between the go cue and the end, shape (n,)."""
        between: BoolArray = (self.t_s >= self.go_s) & (self.t_s <= self.end_s)
        return between

    def clearance_um(self, vessel: VesselMap) -> FloatArray:
        """Return the gap between rim and wall at every track, shape (n,); NaN where not seen."""
        return np.array(
            [
                math.nan if math.isnan(x_px) else vessel.clearance_um(VesselPoint(x_px, y_px))
                for x_px, y_px in self.vessel_px.tolist()
            ]
        )


def read_trial_record(folder: Path) -> TrialRecord:
    """Read a trial's log.

    Raises:
        ConfigError: If it is no trial log.
        RefusedError: ``no_tracks`` if it holds no track.
    """
    log = folder / LOG_NAME
    t_s: list[float] = []
    vessel_px: list[tuple[float, float]] = []
    sigma_um: list[float] = []
    modes: list[str] = []
    marks_s: dict[str, float] = {}
    mode = ""
    for line in read_log(log):
        match line.topic:
            case "track":
                x_px, y_px = line.data["vessel"] or (math.nan, math.nan)
                t_s.append(line.data["taken_s"])
                vessel_px.append((x_px, y_px))
                sigma_um.append(math.nan if line.data["sigma_um"] is None else line.data["sigma_um"])
                modes.append(mode)
            case "mode" | "command":
                mode = line.data["mode"]
            case "trial":
                # A mark may be noticed later than it happened.
                marks_s.setdefault(line.data["mark"], line.data.get("t_s", line.t_s))
    if not t_s:
        raise RefusedError("no_tracks", f"trial {folder.name} holds no track of the robot")
    return TrialRecord(
        id=folder.name,
        header=read_header(log),
        t_s=np.array(t_s),
        vessel_px=np.array(vessel_px, dtype=np.float64),
        sigma_um=np.array(sigma_um, dtype=np.float64),
        modes=modes,
        go_s=marks_s.get("go", t_s[0]),
        end_s=marks_s.get("reached", marks_s.get("end", t_s[-1])),
        reached="reached" in marks_s,
    )
