"""The study's metrics of one trial (docs/metrics.md), live and afterwards by the same function.

Each definition works on filtered motion (core/motion.py), so it can be checked against closed forms.
Lower is smoother for S, lower is straighter for G; LDLJ and SPARC are higher when smoother.
"""

from dataclasses import dataclass

import numpy as np

from mrnav_server.core.arrays import BoolArray, FloatArray
from mrnav_server.core.contacts import contact_starts
from mrnav_server.core.metric_flags import trial_flags
from mrnav_server.core.motion import RATE_HZ, Motion, filtered, segments
from mrnav_server.core.motion_metrics import (
    MedianLog,
    average_speed_um_per_s,
    first_motion_s,
    path_length_um,
    peak_speed_um_per_s,
    slowest_moving_um_per_s,
    smoothness,
    straightness,
)
from mrnav_server.core.noise_floor import smoothness_floor, straightness_floor
from mrnav_server.core.speed_profile import log_dimensionless_jerk, spectral_arc_length

_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class Trial:
    """What the metrics of one trial are computed from.

    Attributes:
        t_s: Capture times in seconds, shape (n,); may hold more than the trial.
        xy_um: Tracked positions, shape (n, 2); NaN where the robot was not seen.
        clearance_um: Gap to the wall at each, shape (n,); NaN where unknown.
        go_s: The go cue.
        end_s: Target reached, or given up.
        reached: Whether the target was reached.
        sigma_um: The tracker's noise; NaN if unknown.
        geodesic_um: Length of the shortest path from start to target; NaN if unknown.
    """

    t_s: FloatArray
    xy_um: FloatArray
    clearance_um: FloatArray
    go_s: float
    end_s: float
    reached: bool
    sigma_um: float = _NAN
    geodesic_um: float = _NAN


@dataclass(frozen=True, slots=True)
class TrialMetrics:
    """The metrics of one trial; NaN where the motion does not define one.

    Attributes:
        average_speed_um_per_s: Va.
        completion_s: TOC, go cue to target reached; NaN if it was not.
        first_motion_s: Go cue to the first filtered speed of 50 µm/s.
        straightness: G, log10 of the curvature in 1/µm; lower is straighter.
        straightness_floor: G that the tracker's noise alone would give.
        smoothness: S; lower is smoother.
        smoothness_floor: S that the tracker's noise alone would give.
        contacts: C, wall contacts.
        min_clearance_um: Smallest gap to the wall.
        log_dimensionless_jerk: LDLJ of the longest stretch without a gap; higher is smoother.
        spectral_arc_length: SPARC of the same; higher is smoother.
        path_length_share: SPL, 0..1; 0 if the target was not reached.
        path_um: Length of the filtered path.
        peak_speed_um_per_s: v_p, the largest filtered speed.
        seen_share: Share of the frames in the trial in which the robot was seen.
        flags: Why to read them with care (core/metric_flags.py).
    """

    average_speed_um_per_s: float
    completion_s: float
    first_motion_s: float
    straightness: MedianLog
    straightness_floor: float
    smoothness: MedianLog
    smoothness_floor: float
    contacts: int
    min_clearance_um: float
    log_dimensionless_jerk: float
    spectral_arc_length: float
    path_length_share: float
    path_um: float
    peak_speed_um_per_s: float
    seen_share: float
    flags: tuple[str, ...]


def trial_metrics(trial: Trial) -> TrialMetrics:
    """Return all metrics of one trial.

    Positions outside the trial's marks help the filters at its ends and count for nothing else.
    """
    motions = trial_motions(trial.t_s, trial.xy_um, trial.go_s, trial.end_s)
    inside = (trial.t_s >= trial.go_s) & (trial.t_s <= trial.end_s)
    seen = np.isfinite(trial.xy_um[inside]).all(axis=1)
    clearance_um = trial.clearance_um[inside]
    speed = np.concatenate([motion.speed_um_per_s for motion in motions] or [np.zeros(0)])
    longest = max((motion.speed_um_per_s for motion in motions), key=len, default=np.zeros(0))
    peak = peak_speed_um_per_s(motions)
    path_um = path_length_um(motions)
    curve, smooth = straightness(motions), smoothness(motions)
    moving = speed[speed >= slowest_moving_um_per_s(peak)]
    curve_floor = straightness_floor(trial.sigma_um, float(np.median(moving)) if moving.size else _NAN)
    smooth_floor = smoothness_floor(trial.sigma_um, peak)
    known = clearance_um[np.isfinite(clearance_um)]
    return TrialMetrics(
        average_speed_um_per_s=average_speed_um_per_s(motions),
        completion_s=trial.end_s - trial.go_s if trial.reached else _NAN,
        first_motion_s=first_motion_s(motions) - trial.go_s,
        straightness=curve,
        straightness_floor=curve_floor,
        smoothness=smooth,
        smoothness_floor=smooth_floor,
        contacts=len(contact_starts(trial.t_s[inside], clearance_um)),
        min_clearance_um=float(known.min()) if known.size else _NAN,
        log_dimensionless_jerk=log_dimensionless_jerk(longest, RATE_HZ),
        spectral_arc_length=spectral_arc_length(longest, RATE_HZ),
        path_length_share=path_length_share(path_um, trial.geodesic_um, reached=trial.reached),
        path_um=path_um,
        peak_speed_um_per_s=peak,
        seen_share=float(seen.mean()) if seen.size else 0.0,
        flags=trial_flags(
            curve, curve_floor, smooth, smooth_floor, _longest_gap_s(trial, inside), reached=trial.reached
        ),
    )


def trial_motions(t_s: FloatArray, xy_um: FloatArray, go_s: float, end_s: float) -> list[Motion]:
    """Return the filtered motion between a trial's marks, one part per stretch without a gap.

    Args:
        t_s: Capture times in seconds, shape (n,); may hold more than the trial.
        xy_um: Tracked positions, shape (n, 2); NaN where the robot was not seen.
        go_s: The go cue.
        end_s: The trial's end.
    """
    return [
        part
        for segment in segments(t_s, xy_um)
        if (part := filtered(segment).between(go_s, end_s)).t_s.size > 1
    ]


def path_length_share(path_um: float, geodesic_um: float, *, reached: bool) -> float:
    """Return SPL, the shortest path's length over the path's own, 0 if the target was not reached.

    Source: Anderson et al., On evaluation of embodied navigation agents, 2018.
    """
    if not reached:
        return 0.0
    longer_um = max(path_um, geodesic_um)
    return geodesic_um / longer_um if longer_um > 0 else _NAN


def _longest_gap_s(trial: Trial, inside: BoolArray) -> float:
    """Return the longest time between two positions, or between a mark and the nearest one."""
    seen = inside & np.isfinite(trial.xy_um).all(axis=1)
    between_s = np.concatenate([[trial.go_s], np.sort(trial.t_s[seen]), [trial.end_s]])
    return float(np.diff(between_s).max())
