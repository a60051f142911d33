"""How a hand-over went: the study's metrics of one trial hide the 2.5 s after the switch (docs/study.md)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.motion import RATE_HZ, Motion
from mrnav_server.core.motion_metrics import (
    SLOWEST_UM_PER_S,
    MedianLog,
    peak_speed_um_per_s,
    smoothness,
)

WINDOW_S = 2.5
"""The hand-over's window, from the switch on."""
_PAUSE_S = 0.05
"""No command for so long: the setpoint stood still."""
_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class HandoverMetrics:
    """One hand-over; NaN where the motion does not define a value.

    Attributes:
        smoothness: S of the window, with the whole trial's peak speed; lower is smoother.
        peak_jerk_um_per_s3: Largest filtered jerk of the robot in the window; lower is gentler.
        standstill_s: How long the robot stood in the window, below 50 µm/s.
        jump_um: Largest jump of the setpoint in the window.
        take_over_s: From the switch to the hand's grip; 0 where the hand gripped before; NaN without a grip.
    """

    smoothness: MedianLog
    peak_jerk_um_per_s3: float
    standstill_s: float
    jump_um: float
    take_over_s: float


def handover_metrics(
    motions: Sequence[Motion],
    switch_s: float,
    setpoint_t_s: FloatArray,
    setpoint_um: FloatArray,
    grip_s: float = _NAN,
    end_s: float = float("inf"),
) -> HandoverMetrics:
    """Return how a hand-over went.

    Args:
        motions: The trial's filtered motion.
        switch_s: When control passed to the operator.
        setpoint_t_s: When each setpoint was sent, rising, shape (n,).
        setpoint_um: The setpoints, shape (n, d).
        grip_s: When the hand first moved the setpoint; NaN if never.
        end_s: The trial's end, where the window ends too.
    """
    last_s = min(switch_s + WINDOW_S, end_s)
    window = [motion.between(switch_s, last_s) for motion in motions]
    jerk = np.concatenate([np.hypot(*m.jerk_um_per_s3.T) for m in window] or [np.zeros(0)])
    # A jump at the switch shows in the setpoint before and the one after.
    inside = (setpoint_t_s >= switch_s - _PAUSE_S) & (setpoint_t_s <= last_s)
    return HandoverMetrics(
        smoothness=smoothness(window, peak_um_per_s=peak_speed_um_per_s(motions)),
        peak_jerk_um_per_s3=float(jerk.max()) if jerk.size else _NAN,
        standstill_s=standstill_s(window),
        jump_um=largest_jump_um(setpoint_t_s[inside], setpoint_um[inside]),
        take_over_s=max(grip_s - switch_s, 0.0) if np.isfinite(grip_s) else _NAN,
    )


def standstill_s(motions: Sequence[Motion]) -> float:
    """Return how long the filtered speed lay below 50 µm/s; NaN without motion data."""
    speed = np.concatenate([motion.speed_um_per_s for motion in motions] or [np.zeros(0)])
    return float((speed < SLOWEST_UM_PER_S).sum()) / RATE_HZ if speed.size else _NAN


def largest_jump_um(t_s: FloatArray, setpoint_um: FloatArray) -> float:
    """Return how far a setpoint lies at most from where the velocity before it led; NaN below three.

    A setpoint that bends smoothly with acceleration a gives a·dt², 3 µm at 30000 µm/s² and 10 ms; one that
    jumps gives the length of the jump. After a pause of 50 ms the velocity before counts as zero.

    Args:
        t_s: Shape (n,), rising.
        setpoint_um: Shape (n, d).
    """
    if len(t_s) < 3:
        return _NAN
    dt_s = np.maximum(np.diff(t_s), 1e-6)[:, None]
    steps_um = np.diff(setpoint_um, axis=0)
    led_um = np.where(dt_s[1:] > _PAUSE_S, 0.0, steps_um[:-1] / dt_s[:-1] * dt_s[1:])
    return float(np.sqrt(((steps_um[1:] - led_um) ** 2).sum(axis=1)).max())
