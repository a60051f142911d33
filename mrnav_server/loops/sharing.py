"""Blended control, beside the plain switch: hand and policy drive together.

While the policy drives, a closed clutch does not end AUTO but deflects its course by α times the hand's
motion. α grows towards the critical area, where judgement counts, shrinks near walls, which the policy knows,
and rises to 1 when the hand keeps disagreeing: then the operator has taken over.
"""

import math
from dataclasses import dataclass

from mrnav_server.core.shaping import Reference

_SLOWEST_UM_PER_S = 100.0
"""A hand slower than this says nothing about its direction."""


@dataclass(frozen=True, slots=True)
class SharingConfig:
    """Blended control.

    Attributes:
        enabled: Closing the clutch in AUTO shares control; False takes over at once.
        least: The hand's share far from the area and near a wall (0-1).
        far_um: From this distance of the area's centre on, the hand's share begins to grow (> 0).
        wall_um: Gap between robot and wall below which the hand's share shrinks (> 0).
        disagree_deg: Directions that differ by more than this disagree (10-180).
        insist_s: A hand that disagrees for this long has taken over (0.1-2).
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    enabled: bool = False
    least: float = 0.3
    far_um: float = 4000.0
    wall_um: float = 150.0
    disagree_deg: float = 60.0
    insist_s: float = 0.5

    def __post_init__(self) -> None:
        bounds = (("least", 0.0, 1.0), ("disagree_deg", 10.0, 180.0), ("insist_s", 0.1, 2.0))
        for name, low, high in bounds:
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} must lie between {low:g} and {high:g}")
        for name in ("far_um", "wall_um"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be above 0")


class Sharing:
    """One stretch of AUTO with the clutch closed.

    Args:
        config: Shares and patience.
        hand: Where the hand alone wants the tip at this moment: from here its motion counts.
        now_s: Now.
    """

    def __init__(self, config: SharingConfig, hand: Reference, now_s: float) -> None:
        self._config = config
        self._zero = hand.position
        self._stepped_s = now_s
        self._insisted_s = 0.0
        self.authority = 0.0
        """The hand's share, 0 to 1."""

    @property
    def taken_over(self) -> bool:
        """Whether the hand has insisted for long enough."""
        return self._insisted_s >= self._config.insist_s

    def reference(
        self,
        policy: Reference,
        hand: Reference,
        distance_um: float | None,
        clearance_um: float | None,
        epsilon_um: float,
        now_s: float,
    ) -> Reference:
        """Return the course of both.

        Args:
            policy: Where the policy wants the tip.
            hand: Where the hand alone wants it.
            distance_um: From the robot to the area's centre.
            clearance_um: Gap between robot and wall.
            epsilon_um: Radius of the area.
            now_s: Now.
        """
        elapsed_s = min(max(now_s - self._stepped_s, 0.0), 0.05)
        self._stepped_s = now_s
        # Agreement forgives twice as fast as disagreement adds up, and noise of the hand is no vote.
        pace = 1.0 if self._disagrees(policy, hand) else -2.0
        most_s = self._config.insist_s
        self._insisted_s = min(max(self._insisted_s + pace * elapsed_s, 0.0), most_s)
        place = self._share_of_place(distance_um, clearance_um, epsilon_um)
        share = self.authority = place + (1.0 - place) * self._insisted_s / most_s
        at, zero, wish = policy.position, self._zero, hand.position
        velocity = tuple(
            p + share * h for p, h in zip(policy.velocity_um_per_s, hand.velocity_um_per_s, strict=True)
        )
        return Reference(
            type(at)(
                at.x_um + share * (wish.x_um - zero.x_um),
                at.y_um + share * (wish.y_um - zero.y_um),
                at.z_um + share * (wish.z_um - zero.z_um),
            ),
            (velocity[0], velocity[1], velocity[2]),
            max(policy.speed_um_per_s, hand.speed_um_per_s),
        )

    def _share_of_place(
        self, distance_um: float | None, clearance_um: float | None, epsilon_um: float
    ) -> float:
        config = self._config
        near = 0.0
        if distance_um is not None:
            near = (config.far_um - distance_um) / max(config.far_um - epsilon_um, 1.0)
        room = 1.0 if clearance_um is None else clearance_um / config.wall_um
        near, room = min(max(near, 0.0), 1.0), min(max(room, 0.0), 1.0)
        return config.least + (1.0 - config.least) * near * room

    def _disagrees(self, policy: Reference, hand: Reference) -> bool:
        theirs, ours = policy.velocity_um_per_s, hand.velocity_um_per_s
        speeds = math.hypot(*theirs), math.hypot(*ours)
        if speeds[1] < _SLOWEST_UM_PER_S:
            return False
        if speeds[0] < 1e-9:
            # A policy that stands still is overruled by any motion.
            return True
        cosine = sum(a * b for a, b in zip(theirs, ours, strict=True)) / (speeds[0] * speeds[1])
        return cosine < math.cos(math.radians(self._config.disagree_deg))
