"""Draws the leash taut along a path's first tangent until the robot breaks away, and learns from that."""

import math

from mrnav_server.autonomy.following import FollowerConfig
from mrnav_server.autonomy.rail import Rail
from mrnav_server.autonomy.watch import RobotWatch, Vector

_UNMOVED_UM = 10.0
"""A robot that is seen to have moved by less may still rest."""
_THERE_UM = 10.0
_NEAR_UM = 100.0


class TakeUp:
    """One start from rest.

    Fast at first and slowly at last; slowly from the beginning as long as little was learnt, since an error
    of the magnet's offset can break the robot away at any moment, in another direction than the path's.

    Args:
        config: Speeds and thresholds.
        watch: Sees the robot and learns from it.
        rail: The path.
    """

    def __init__(self, config: FollowerConfig, watch: RobotWatch, rail: Rail) -> None:
        self._config = config
        self._watch = watch
        self._tangent = rail.tangent(0)
        self._began_um = watch.seen_um
        self._leash_um = watch.leash_um
        self._rest_lag_um = watch.lag_um
        self._lead_um = config.take_up_share * watch.coupling.lead_um
        self._breakaway_um = 0.0
        self._velocity: Vector = (0.0, 0.0)

    @property
    def lead_um(self) -> float:
        """The lead so far."""
        return self._lead_um

    @property
    def velocity_um_per_s(self) -> Vector:
        """The magnet's velocity."""
        return self._velocity

    @property
    def coming(self) -> bool:
        """Whether the magnet is still on its way to where it may draw the robot."""
        return math.hypot(*self._to_go_um()) > _NEAR_UM

    @property
    def left_s(self) -> float:
        """Estimate of the time until the robot breaks away."""
        fast_um_per_s, slow_um_per_s = self._speeds_um_per_s()
        dx, dy = self._to_go_um()
        taut_um = self._config.observer.breakaway_ratio * self._watch.coupling.lead_um
        return math.hypot(dx, dy) / fast_um_per_s + max(taut_um - self._lead_um, 0.0) / slow_um_per_s

    def moves(self) -> bool:
        """Tell whether the robot has broken away; if so, learn from it."""
        config, watch = self._config, self._watch
        x_um, y_um = watch.seen_um
        moved_um = (x_um - self._began_um[0], y_um - self._began_um[1])
        away_um = math.hypot(*moved_um)
        if away_um < _UNMOVED_UM:
            self._rest_lag_um = watch.lag_um
        self._breakaway_um = max(
            self._breakaway_um, min(math.hypot(*watch.leash_um), config.observer.lead_limit_um)
        )
        if away_um <= config.moved_um:
            return False
        if self._unlearnt:
            watch.learn_breakaway(self._rest_lag_um, moved_um)
            bx, by = watch.coupling.offset_um
            rest_um = math.hypot(self._rest_lag_um[0] - bx, self._rest_lag_um[1] - by)
            self._breakaway_um = min(max(rest_um, math.hypot(*watch.leash_um)), config.observer.lead_limit_um)
        watch.learn_lead(self._breakaway_um)
        return True

    def step(self, dt_s: float) -> Vector:
        """Draw on; return the hold point."""
        fast_um_per_s, slow_um_per_s = self._speeds_um_per_s()
        tx, ty = self._tangent
        dx, dy = self._to_go_um()
        away_um = math.hypot(dx, dy)
        step_um = fast_um_per_s * dt_s
        if away_um <= step_um + _THERE_UM:
            longest_um = self._config.observer.lead_limit_um
            self._lead_um = min(self._lead_um + slow_um_per_s * dt_s, longest_um)
            self._leash_um = (self._lead_um * tx, self._lead_um * ty)
            self._velocity = (slow_um_per_s * tx, slow_um_per_s * ty)
        else:
            hx, hy = dx / away_um, dy / away_um
            self._leash_um = (self._leash_um[0] + hx * step_um, self._leash_um[1] + hy * step_um)
            self._velocity = (fast_um_per_s * hx, fast_um_per_s * hy)
        bx, by = self._watch.coupling.offset_um
        return (self._began_um[0] + bx + self._leash_um[0], self._began_um[1] + by + self._leash_um[1])

    @property
    def _unlearnt(self) -> bool:
        return self._watch.coupling.looks < self._config.learnt_looks

    def _speeds_um_per_s(self) -> tuple[float, float]:
        """Return the speeds before and after the point from which on the robot may break away."""
        config = self._config
        if self._unlearnt:
            return config.take_up_first_um_per_s, config.take_up_first_um_per_s
        return config.take_up_fast_um_per_s, config.take_up_um_per_s

    def _to_go_um(self) -> Vector:
        """Return the way from the leash to the lead along the tangent."""
        tx, ty = self._tangent
        return self._lead_um * tx - self._leash_um[0], self._lead_um * ty - self._leash_um[1]
