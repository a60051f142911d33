"""How fast the robot may go at each point of a path."""

from dataclasses import dataclass

import numpy as np

from mrnav_server.core.arrays import FloatArray

_WINDOW = 8
"""Curvature is taken over this many points on either side."""
_READY_UM = 300.0
"""So far before the area the robot has slowed down already."""


@dataclass(frozen=True, slots=True)
class SpeedConfig:
    """Bounds on the speed along a path.

    Attributes:
        cruise_um_per_s: Largest speed of the robot (1000–4500).
        magnet_um_per_s: Largest speed of the magnet, which swings wider in a bend (1000–5000).
        lateral_um_per_s2: Largest acceleration of the magnet across the path (5000–30000).
        along_um_per_s2: Largest acceleration along the path; nothing damps the robot's 4 Hz swing in that
            direction, so speed changes over about one period (3000–20000).
        floor_um_per_s: Never slower than this before the end: below, the robot sticks and slips (500–2000).
        end_um_per_s: Speed at the end of the path (300–1500).
        handover_um_per_s: Speed at which the robot enters the area where the operator takes over (600–3000).
        handover_along_um_per_s2: Deceleration on the way there: gentle, for what swings when control passes
            swings on under the hand (1000–20000).
        wall_um_per_s: Speed when the rim touches the wall (500–3000).
        wall_clearance_um: Gap below which speed falls towards ``wall_um_per_s`` (0–300).
        short_path_um: Paths up to this length take the two gentler bounds below (0–6000).
        short_cruise_um_per_s: Largest speed on a short path (500–3000).
        short_along_um_per_s2: Largest acceleration along a short path (2000–20000).
        swing_um: The magnet is taken to lead by the friction lead plus this much, in µm (0–200).
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    cruise_um_per_s: float = 3600.0
    magnet_um_per_s: float = 4700.0
    lateral_um_per_s2: float = 18_000.0
    along_um_per_s2: float = 9000.0
    floor_um_per_s: float = 1200.0
    end_um_per_s: float = 800.0
    handover_um_per_s: float = 1200.0
    handover_along_um_per_s2: float = 3000.0
    wall_um_per_s: float = 1500.0
    wall_clearance_um: float = 80.0
    short_path_um: float = 1500.0
    short_cruise_um_per_s: float = 1500.0
    short_along_um_per_s2: float = 5000.0
    swing_um: float = 80.0


def speed_limits_um_per_s(
    points_um: FloatArray,
    tangents: FloatArray,
    clearance_um: FloatArray,
    lead_um: float,
    config: SpeedConfig,
    handover_um: float = 0.0,
) -> FloatArray:
    """Return the speed limit at each point of a path.

    The magnet runs on q = γ + lead·t̂, so v ≤ v_magnet/|q'| and v ≤ √(a_lateral/|q''|); then the bound on
    acceleration along the path is met backwards from the end and forwards from the start.

    Args:
        points_um: Evenly spaced, shape (n, 2), n >= 2.
        tangents: Unit vectors, shape (n, 2).
        clearance_um: Gap between rim and wall, shape (n,).
        lead_um: The magnet's friction lead.
        config: The bounds.
        handover_um: The last so many µm go no faster than ``handover_um_per_s``; 0 for no such area.

    Returns:
        Shape (n,), in µm/s.
    """
    n = len(points_um)
    spacing_um = float(np.hypot(*np.diff(points_um, axis=0).T).sum()) / (n - 1)
    short = (n - 1) * spacing_um <= config.short_path_um
    cruise = min(config.cruise_um_per_s, config.short_cruise_um_per_s) if short else config.cruise_um_per_s
    limit = np.full(n, cruise)
    if n > 2 * _WINDOW and spacing_um > 0.0:
        inner = slice(_WINDOW, n - _WINDOW)
        stretch, bend_per_um = _magnet_derivatives(
            points_um + (lead_um + config.swing_um) * tangents, spacing_um
        )
        limit[inner] = np.minimum(limit[inner], config.magnet_um_per_s / np.maximum(stretch, 1e-9))
        limit[inner] = np.minimum(
            limit[inner], np.sqrt(config.lateral_um_per_s2 / np.maximum(bend_per_um, 1e-12))
        )
    share = np.clip(clearance_um / max(config.wall_clearance_um, 1e-9), 0.0, 1.0)
    near_wall = config.wall_um_per_s + (config.cruise_um_per_s - config.wall_um_per_s) * share
    limit = np.maximum(np.minimum(limit, near_wall), min(config.floor_um_per_s, cruise))
    if handover_um > 0.0:
        to_area_um = (n - 1 - np.arange(n)) * spacing_um - handover_um - _READY_UM
        squared = config.handover_um_per_s**2 + 2.0 * config.handover_along_um_per_s2 * to_area_um.clip(0.0)
        limit = np.minimum(limit, np.sqrt(squared))
    limit[-1] = min(config.end_um_per_s, cruise)
    along = config.short_along_um_per_s2 if short else config.along_um_per_s2
    return _within_acceleration(limit, 2.0 * along * spacing_um)


def _magnet_derivatives(magnet_um: FloatArray, spacing_um: float) -> tuple[FloatArray, FloatArray]:
    """Return |q'| and |q''| (per µm) at the inner points, shape (n - 2·window,) each."""
    step_um = _WINDOW * spacing_um
    ahead, here, behind = magnet_um[2 * _WINDOW :], magnet_um[_WINDOW:-_WINDOW], magnet_um[: -2 * _WINDOW]
    first = (ahead - behind) / (2.0 * step_um)
    second = (ahead - 2.0 * here + behind) / step_um**2
    return np.hypot(first[:, 0], first[:, 1]), np.hypot(second[:, 0], second[:, 1])


def _within_acceleration(limit: FloatArray, gain: float) -> FloatArray:
    """Lower the limits so that v² changes by at most ``gain`` from point to point."""
    rise = gain * np.arange(len(limit))
    squared: FloatArray = limit**2
    squared = np.minimum.accumulate((squared + rise)[::-1])[::-1] - rise
    squared = np.minimum.accumulate(squared - rise) + rise
    bounded: FloatArray = np.sqrt(squared)
    return bounded
