"""The study's metrics of one trial's motion (docs/study.md).

Each definition works on filtered motion (core/motion.py), so it can be checked against closed forms.
Lower is smoother for S, lower is straighter for G; LDLJ and SPARC are higher when smoother.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.contacts import ContactCounter
from mrnav_server.core.motion import RATE_HZ, Motion, filtered, segments

SLOWEST_UM_PER_S = 50.0
"""Below this filtered speed the robot counts as standing."""
FLOOR = 1e-6
"""Curvature (1/µm) and jerk cost are floored here before the logarithm."""
NEAR_FLOOR = 0.3
_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class MedianLog:
    """A metric that is the median of a logarithm over samples.

    Attributes:
        value: The median; NaN if nothing moves.
        samples: How many samples it is the median of.
        moving_share: Their share of all samples, 0..1.
        floored_share: Share of them that lay below the floor, 0..1.
    """

    value: float
    samples: int
    moving_share: float
    floored_share: float


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
        straightness_near_floor: Whether G lies within 0.3 of it.
        smoothness: S; lower is smoother.
        smoothness_floor: S that the tracker's noise alone would give.
        smoothness_near_floor: Whether S lies within 0.3 of it.
        contacts: C, wall contacts.
        min_clearance_um: Smallest gap to the wall.
        log_dimensionless_jerk: LDLJ of the longest stretch without a gap; higher is smoother.
        spectral_arc_length: SPARC of the same; higher is smoother.
        path_length_share: SPL, 0..1; 0 if the target was not reached.
        path_um: Length of the filtered path.
        peak_speed_um_per_s: v_p, the largest filtered speed.
        seen_share: Share of the frames in the trial in which the robot was seen.
    """

    average_speed_um_per_s: float
    completion_s: float
    first_motion_s: float
    straightness: MedianLog
    straightness_floor: float
    straightness_near_floor: bool
    smoothness: MedianLog
    smoothness_floor: float
    smoothness_near_floor: bool
    contacts: int
    min_clearance_um: float
    log_dimensionless_jerk: float
    spectral_arc_length: float
    path_length_share: float
    path_um: float
    peak_speed_um_per_s: float
    seen_share: float


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
    moving = speed[speed >= _slowest_moving(peak)]
    curve_floor = straightness_floor(trial.sigma_um, float(np.median(moving)) if moving.size else _NAN)
    smooth_floor = smoothness_floor(trial.sigma_um, peak)
    known = clearance_um[np.isfinite(clearance_um)]
    return TrialMetrics(
        average_speed_um_per_s=average_speed_um_per_s(motions),
        completion_s=trial.end_s - trial.go_s if trial.reached else _NAN,
        first_motion_s=first_motion_s(motions) - trial.go_s,
        straightness=curve,
        straightness_floor=curve_floor,
        straightness_near_floor=curve.value - curve_floor < NEAR_FLOOR,
        smoothness=smooth,
        smoothness_floor=smooth_floor,
        smoothness_near_floor=smooth.value - smooth_floor < NEAR_FLOOR,
        contacts=len(contact_starts(trial.t_s[inside], clearance_um)),
        min_clearance_um=float(known.min()) if known.size else _NAN,
        log_dimensionless_jerk=log_dimensionless_jerk(longest, RATE_HZ),
        spectral_arc_length=spectral_arc_length(longest, RATE_HZ),
        path_length_share=path_length_share(path_um, trial.geodesic_um, reached=trial.reached),
        path_um=path_um,
        peak_speed_um_per_s=peak,
        seen_share=float(seen.mean()) if seen.size else 0.0,
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


def path_length_um(motions: Sequence[Motion]) -> float:
    """Return the length of the filtered path; gaps count nothing."""
    return float(sum(np.hypot(*np.diff(motion.xy_um, axis=0).T).sum() for motion in motions))


def average_speed_um_per_s(motions: Sequence[Motion]) -> float:
    """Return path length over duration; NaN without motion data.

    Source: study metric (a), average speed Va.
    """
    duration_s = sum(float(motion.t_s[-1] - motion.t_s[0]) for motion in motions)
    return path_length_um(motions) / duration_s if duration_s > 0 else _NAN


def peak_speed_um_per_s(motions: Sequence[Motion]) -> float:
    """Return the largest filtered speed, v_p; NaN without motion data."""
    return max((float(motion.speed_um_per_s.max()) for motion in motions), default=_NAN)


def first_motion_s(motions: Sequence[Motion]) -> float:
    """Return when the filtered speed first reaches 50 µm/s; NaN if never."""
    for motion in motions:
        moving = np.flatnonzero(motion.speed_um_per_s >= SLOWEST_UM_PER_S)
        if moving.size:
            return float(motion.t_s[moving[0]])
    return _NAN


def straightness(motions: Sequence[Motion]) -> MedianLog:
    """Return G, the median of log10 κ with κ = |v×a|/|v|³ in 1/µm, over the samples that move.

    A sample moves at ``|v| >= max(0.05·v_p, 50 µm/s)``.

    Source: study metric (c), geometric straightness.
    """
    if not motions:
        return MedianLog(_NAN, 0, 0.0, 0.0)
    v = np.concatenate([motion.velocity_um_per_s for motion in motions])
    a = np.concatenate([motion.acceleration_um_per_s2 for motion in motions])
    speed = np.hypot(v[:, 0], v[:, 1])
    moving = speed >= _slowest_moving(float(speed.max()))
    v, a, speed = v[moving], a[moving], speed[moving]
    curvature = np.abs(v[:, 0] * a[:, 1] - v[:, 1] * a[:, 0]) / speed**3
    return _median_log(curvature, moving.size)


def smoothness(
    motions: Sequence[Motion], sigma_s: float = 1.0, peak_um_per_s: float | None = None
) -> MedianLog:
    """Return S, the median of log10 φ over sliding windows of σ inside a segment.

    Args:
        motions: The trial's filtered motion, or a part of it.
        sigma_s: σ; the value depends on it. At 1 s the literal σ⁵ and the dimensionless σ³ agree.
        peak_um_per_s: v_p; that of these motions if left out.

    Source: study metric (d), smoothness.
    """
    peak = peak_speed_um_per_s(motions) if peak_um_per_s is None else peak_um_per_s
    if not peak >= SLOWEST_UM_PER_S:
        return MedianLog(_NAN, 0, 0.0, 0.0)
    costs = np.concatenate([jerk_cost(m.jerk_um_per_s3, RATE_HZ, sigma_s, peak) for m in motions])
    return _median_log(costs, costs.size)


def jerk_cost(
    jerk_um_per_s3: FloatArray, rate_hz: float, sigma_s: float, peak_speed_um_per_s: float
) -> FloatArray:
    """Return φ(t) = σ⁵/v_p² · ∫_{t−σ}^{t} |jerk|² dt for every whole window.

    Args:
        jerk_um_per_s3: Shape (m, 2).
        rate_hz: Its rate.
        sigma_s: σ, a whole number of samples.
        peak_speed_um_per_s: v_p.

    Returns:
        Shape (m − σ·rate,), empty if no window fits.
    """
    steps = round(sigma_s * rate_hz)
    squared = (jerk_um_per_s3**2).sum(axis=1)
    if squared.size <= steps:
        return np.zeros(0)
    integral = np.concatenate([[0.0], np.cumsum((squared[1:] + squared[:-1]) / (2.0 * rate_hz))])
    cost: FloatArray = (integral[steps:] - integral[:-steps]) * sigma_s**5 / peak_speed_um_per_s**2
    return cost


def straightness_floor(sigma_um: float, speed_um_per_s: float) -> float:
    """Return the G that a tracker's noise alone gives on a straight line.

    12.0 /s² is the gain of the acceleration filter for white noise at 30 Hz, 0.6745 the median of a
    standard normal's magnitude.
    """
    with np.errstate(divide="ignore"):
        return float(np.log10(0.6745 * 12.0 * sigma_um / np.float64(speed_um_per_s) ** 2))


def smoothness_floor(sigma_um: float, peak_speed_um_per_s: float) -> float:
    """Return the S that a tracker's noise alone gives; 237 /s³ is the gain of the jerk filter."""
    with np.errstate(divide="ignore"):
        return float(np.log10(2.0 * (237.0 * sigma_um) ** 2 / np.float64(peak_speed_um_per_s) ** 2))


def contact_starts(t_s: FloatArray, clearance_um: FloatArray) -> list[int]:
    """Return the samples at which a wall contact begins; their number is C.

    Args:
        t_s: Shape (n,), rising.
        clearance_um: Gap between the robot's rim and the wall, shape (n,); NaN where unknown.

    Source: study metric (e), collisions C.
    """
    counter = ContactCounter()
    return [
        index
        for index, (now_s, gap_um) in enumerate(zip(t_s.tolist(), clearance_um.tolist(), strict=True))
        if counter.step(gap_um, now_s)
    ]


def log_dimensionless_jerk(speed: FloatArray, rate_hz: float) -> float:
    """Return LDLJ = −ln(T³/v_p² · ∫ (d²v/dt²)² dt) of a speed profile; NaN if it does not move.

    Source: Balasubramanian et al., On the analysis of movement smoothness, 2015.
    """
    if speed.size < 3 or not speed.max() > 0:
        return _NAN
    jerk = np.diff(speed, 2) * rate_hz**2
    duration_s = speed.size / rate_hz
    cost = duration_s**3 / speed.max() ** 2 * (jerk**2).sum() / rate_hz
    return float(-np.log(cost)) if cost > 0 else _NAN


def spectral_arc_length(
    speed: FloatArray, rate_hz: float, cutoff_hz: float = 10.0, least_amplitude: float = 0.05
) -> float:
    """Return SPARC, the negative length of a speed profile's normalised spectrum; NaN if it does not move.

    Args:
        speed: Speed profile, shape (n,).
        rate_hz: Its rate.
        cutoff_hz: Frequencies above count for nothing.
        least_amplitude: The spectrum ends at the last amplitude at least this large, of 1.

    Source: Balasubramanian et al., On the analysis of movement smoothness, 2015.
    """
    if speed.size < 3 or not speed.max() > 0:
        return _NAN
    padded = 2 ** (int(np.ceil(np.log2(speed.size))) + 4)
    amplitude = np.abs(np.fft.rfft(speed, padded))
    frequency_hz = np.fft.rfftfreq(padded, 1.0 / rate_hz)
    amplitude = amplitude[frequency_hz <= cutoff_hz] / amplitude.max()
    last = int(np.flatnonzero(amplitude >= least_amplitude)[-1])
    if last == 0:
        return _NAN
    return float(-np.hypot(1.0 / last, np.diff(amplitude[: last + 1])).sum())


def path_length_share(path_um: float, geodesic_um: float, *, reached: bool) -> float:
    """Return SPL, the shortest path's length over the path's own, 0 if the target was not reached.

    Source: Anderson et al., On evaluation of embodied navigation agents, 2018.
    """
    if not reached:
        return 0.0
    longer_um = max(path_um, geodesic_um)
    return geodesic_um / longer_um if longer_um > 0 else _NAN


def _slowest_moving(peak: float) -> float:
    return max(0.05 * peak, SLOWEST_UM_PER_S)


def _median_log(values: FloatArray, of_all: int) -> MedianLog:
    if values.size == 0:
        return MedianLog(_NAN, 0, 0.0, 0.0)
    return MedianLog(
        value=float(np.median(np.log10(np.maximum(values, FLOOR)))),
        samples=values.size,
        moving_share=values.size / of_all,
        floored_share=float((values <= FLOOR).mean()),
    )
