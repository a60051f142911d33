"""Why a trial's metrics are to be read with care; every flag is a word and a sentence (docs/metrics.md)."""

from collections.abc import Mapping

from mrnav_server.core.motion import MAX_GAP_S
from mrnav_server.core.motion_metrics import MedianLog

NEAR = 0.3
"""A value this little above the noise's own says more of the tracker than of the motion."""
FLAGS: Mapping[str, str] = {
    "nothing_moves": "the robot never reached 50 µm/s: G and S are not defined",
    "too_short": "no stretch holds a whole jerk filter and a window of 1 s: S is not defined",
    "g_on_floor": "half of the samples lie on the floor of 1e-6/µm: a straight line, or made-up data",
    "s_on_floor": "half of the windows lie on the floor of 1e-6: constant speed on a straight line",
    "g_near_noise_floor": "G lies within 0.3 of what the tracker's noise alone gives",
    "s_near_noise_floor": "S lies within 0.3 of what the tracker's noise alone gives",
    "gaps": "the robot was not seen for more than 0.2 s: the path and the filters stop there",
    "not_reached": "the target was not reached: TOC is not defined and SPL is 0",
}


def trial_flags(
    straightness: MedianLog,
    straightness_floor: float,
    smoothness: MedianLog,
    smoothness_floor: float,
    longest_gap_s: float,
    *,
    reached: bool,
) -> tuple[str, ...]:
    """Return a trial's flags, in the order of ``FLAGS``.

    Args:
        straightness: G.
        straightness_floor: G of the tracker's noise alone; NaN if that is unknown.
        smoothness: S.
        smoothness_floor: S of the tracker's noise alone; NaN if that is unknown.
        longest_gap_s: Longest time without a position.
        reached: Whether the target was reached.
    """
    raised = {
        "nothing_moves": straightness.samples == 0,
        "too_short": straightness.samples > 0 and smoothness.samples == 0,
        "g_on_floor": straightness.floored_share > 0.5,
        "s_on_floor": smoothness.floored_share > 0.5,
        "g_near_noise_floor": straightness.value - straightness_floor < NEAR,
        "s_near_noise_floor": smoothness.value - smoothness_floor < NEAR,
        "gaps": longest_gap_s > MAX_GAP_S + 1e-6,
        "not_reached": not reached,
    }
    return tuple(name for name in FLAGS if raised[name])
