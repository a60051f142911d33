"""What couples robot and magnet: a leash of friction behind a point that is off by an unknown bias.

Positions are in the vessel's plane in µm (grid pixels times µm per pixel). The hold point is where a
frictionless robot would rest below the tip.
"""

import math
from dataclasses import dataclass

LEAST_LEAD_UM = 50.0


@dataclass(frozen=True, slots=True)
class ObserverConfig:
    """Gains of the observer; all are per camera frame at 30 fps.

    Attributes:
        offset_gain: Share of the innovation across the motion that goes into the offset error (0.02–0.3).
        offset_gain_along: Share of ``offset_gain`` that holds along the motion, where offset error and lead
            look alike (0–1).
        lead_gain: Share of the innovation along the motion that goes into the lead (0.02–0.3).
        offset_limit_um: Bound on the offset error, in µm (100–1000).
        lead_limit_um: Bound on the lead, in µm (500–2500).
        drag_s: Growth of the lead with speed, in s (0–0.05).
        inertia_s2: Lead per acceleration, the inverse square of the natural frequency, in s² (0–0.005).
        moving_um_per_s: The observer learns only from a robot that is seen to move faster (300–1500).
        breakaway_ratio: Lead at which a resting robot starts over the lead of a moving one (1–1.5).
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    offset_gain: float = 0.12
    offset_gain_along: float = 0.15
    lead_gain: float = 0.1
    offset_limit_um: float = 600.0
    lead_limit_um: float = 1600.0
    drag_s: float = 0.022
    inertia_s2: float = 1.67e-3
    moving_um_per_s: float = 640.0
    breakaway_ratio: float = 1.2


@dataclass(frozen=True, slots=True)
class Coupling:
    """What the follower has learnt about the magnet and the robot; kept from task to task.

    Attributes:
        offset_um: Error b̂ of the calibrated magnet offset, along the vessel's x and y, in µm.
        lead_um: Friction lead L̂: how far the hold point runs ahead of a slowly moving robot, in µm.
        looks: Camera frames of a moving robot from which both were learnt.
    """

    offset_um: tuple[float, float] = (0.0, 0.0)
    lead_um: float = 400.0
    looks: int = 0

    def described(self) -> dict[str, object]:
        """Return it for people and logs: offset error and lead in µm, and the looks."""
        return {
            "offset_um": [round(float(axis_um), 1) for axis_um in self.offset_um],
            "friction_lead_um": round(float(self.lead_um), 1),
            "looks": self.looks,
        }


def observed(
    coupling: Coupling,
    lag_um: tuple[float, float],
    velocity_um_per_s: tuple[float, float],
    acceleration_um_per_s2: tuple[float, float],
    config: ObserverConfig,
) -> Coupling:
    """Return the coupling after one camera frame of a moving robot.

    With h the direction of motion and the innovation z = lag − b̂ − (L̂ + τ|v|)·h − w·a:
    b̂ += g·(z − (1 − g_along)·(z·h)·h) and L̂ += g_L·(z·h).

    Args:
        coupling: The estimate so far.
        lag_um: Hold point minus robot at the time of the frame.
        velocity_um_per_s: The robot's velocity, not zero.
        acceleration_um_per_s2: The robot's planned acceleration.
        config: The gains.
    """
    vx, vy = velocity_um_per_s
    speed = math.hypot(vx, vy)
    hx, hy = vx / speed, vy / speed
    bx, by = coupling.offset_um
    lead_um = coupling.lead_um + config.drag_s * speed
    zx = lag_um[0] - bx - lead_um * hx - config.inertia_s2 * acceleration_um_per_s2[0]
    zy = lag_um[1] - by - lead_um * hy - config.inertia_s2 * acceleration_um_per_s2[1]
    along = zx * hx + zy * hy
    kept = (1.0 - config.offset_gain_along) * along
    bx += config.offset_gain * (zx - kept * hx)
    by += config.offset_gain * (zy - kept * hy)
    return Coupling(
        bounded_um((bx, by), config),
        bounded_lead_um(coupling.lead_um + config.lead_gain * along, config),
        coupling.looks + 1,
    )


def bounded_um(offset_um: tuple[float, float], config: ObserverConfig) -> tuple[float, float]:
    """Return an offset error within its bound, in µm."""
    shrink = min(1.0, config.offset_limit_um / max(math.hypot(*offset_um), 1e-9))
    return offset_um[0] * shrink, offset_um[1] * shrink


def bounded_lead_um(lead_um: float, config: ObserverConfig) -> float:
    """Return a lead within its bounds, in µm."""
    return min(max(lead_um, LEAST_LEAD_UM), config.lead_limit_um)
