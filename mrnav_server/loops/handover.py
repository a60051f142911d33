"""From the policy to the operator's hand without a jump, a jolt or a standstill.

The policy's last speed fades out along its way while the hand's motion fades in, both by the same authority
α(u) = u²(3 - 2u). Whatever is left of the policy's motion is known at the switch: no policy is asked again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from mrnav_server.core.frames import StagePoint
from mrnav_server.core.moving_mean import MovingMean
from mrnav_server.core.shaping import GENTLE, Reference
from mrnav_server.loops.coast import Coast, Vector3
from mrnav_server.loops.sharing import SharingConfig

_LAG_S = 1.0 / GENTLE.velocity_per_s
"""The shaper takes so long to answer a change of velocity: it is told of the fade that much earlier."""


@dataclass(frozen=True, slots=True)
class HandoverConfig:
    """How the operator gets control back.

    Attributes:
        style: "blended" announces the hand-over, arrives slowly and lets authority pass over ``blend_s``;
            "stop" comes to rest in the area first; "paper" switches at once, at whatever speed.
        announce_s: So long before arrival the operator is told (0-5).
        blend_s: Authority passes over this time (0-2); unless the hand-over was announced, it passes at once.
        smooth_s: After an announced hand-over the hand is averaged over this time, lest it set the robot
            swinging (0-0.25). It delays the hand by half of it.
        settle_s: That fades away over this time, once all authority has passed (0-10).
        carry_um: The policy's motion goes on no further than this after the switch, and no further than ε
            (0-1000).
        require_robot: Arrival needs the tracked robot inside the area too; False leaves the paper's formula,
            which looks at the end-effector alone.
        rest_below_um: In an area of a smaller radius the robot comes to rest before the operator takes over:
            it could not stop inside (0-1000).
        sharing: Whether hand and policy may drive together.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    style: Literal["blended", "stop", "paper"] = "blended"
    announce_s: float = 1.5
    blend_s: float = 1.0
    smooth_s: float = 0.2
    settle_s: float = 3.0
    carry_um: float = 500.0
    require_robot: bool = True
    rest_below_um: float = 250.0
    sharing: SharingConfig = field(default_factory=SharingConfig)

    def __post_init__(self) -> None:
        bounds = {
            "announce_s": 5.0,
            "blend_s": 2.0,
            "smooth_s": 0.25,
            "settle_s": 10.0,
            "carry_um": 1000.0,
            "rest_below_um": 1000.0,
        }
        for name, most in bounds.items():
            if not 0.0 <= getattr(self, name) <= most:
                raise ValueError(f"{name} must lie between 0 and {most:g}")

    @property
    def announced(self) -> bool:
        """Whether the operator is told before arrival."""
        return self.style == "blended"

    def in_motion(self, epsilon_um: float) -> bool:
        """Tell whether the robot is handed over in an area of this radius without a rest before."""
        return self.announced and epsilon_um >= self.rest_below_um


class Blend:
    """One hand-over under way.

    Args:
        position: The setpoint at the switch.
        velocity_um_per_s: Its velocity, stage x, y, z.
        config: Durations and bounds.
        epsilon_um: Radius of the area.
        now_s: The switch.
        way_um: Steps of the policy's way from there on, stage x and y; straight on if empty.
    """

    def __init__(
        self,
        position: StagePoint,
        velocity_um_per_s: Vector3,
        config: HandoverConfig,
        epsilon_um: float,
        now_s: float,
        way_um: Sequence[tuple[float, float]] = (),
    ) -> None:
        carry_um = min(config.carry_um, epsilon_um)
        self._config = config
        self._coast = Coast(position, velocity_um_per_s, way_um)
        # The fade covers half of what the velocity would: ∫(1 - α) du = 1/2.
        self._fade_s = min(config.blend_s, 2.0 * carry_um / max(self._coast.speed_um_per_s, 1e-9))
        self._began_s = now_s
        self._hand: StagePoint | None = None
        self._moved_um = (0.0, 0.0, 0.0)
        self._smooth = MovingMean()
        self._smooth.add((0.0,) * 6, now_s)

    def authority(self, now_s: float) -> float:
        """Return the hand's share, 0 to 1."""
        return eased(self._share(now_s, self._config.blend_s))

    @property
    def rest_point(self) -> StagePoint:
        """Where the policy's motion ends if the hand does not move."""
        return self._coast.at(self._gone_um(1.0))[0]

    def reference(self, hand: Reference | None, now_s: float, speed_um_per_s: float) -> Reference | None:
        """Return where the tip should be; None once it rests and no hand moves it.

        Args:
            hand: Where the hand alone would want the tip; None while the clutch is open.
            now_s: Now.
            speed_um_per_s: Largest speed.
        """
        u, alpha = self._share(now_s, self._fade_s), self.authority(now_s)
        if hand is None:
            self._hand = None
            if u >= 1.0 and alpha >= 1.0:
                return None
        elif self._hand is not None:
            step = _minus(hand.position, self._hand)
            x, y, z = self._moved_um
            self._moved_um = (x + alpha * step[0], y + alpha * step[1], z + alpha * step[2])
        self._hand = hand.position if hand is not None else None
        hx, hy, hz = hand.velocity_um_per_s if hand is not None else (0.0, 0.0, 0.0)
        self._smooth.add((*self._moved_um, alpha * hx, alpha * hy, alpha * hz), now_s)
        x, y, z, vx, vy, vz = self._smooth.mean(self._smooth_s(now_s), now_s)
        at, (dx, dy, dz) = self._coast.at(self._gone_um(u))
        left = 1.0 - eased(self._share(now_s + _LAG_S, self._fade_s))
        speed = left * self._coast.speed_um_per_s
        return Reference(
            StagePoint(at.x_um + x, at.y_um + y, at.z_um + z),
            (speed * dx + vx, speed * dy + vy, speed * dz + vz),
            speed_um_per_s,
            GENTLE,
        )

    def _share(self, now_s: float, span_s: float) -> float:
        if span_s <= 0.0:
            return 1.0
        return min(max((now_s - self._began_s) / span_s, 0.0), 1.0)

    def _smooth_s(self, now_s: float) -> float:
        """Return over how long the hand is averaged: all the time at first, and not at all in the end."""
        config = self._config
        return config.smooth_s * (1.0 - eased(self._share(now_s - config.blend_s, config.settle_s)))

    def _gone_um(self, u: float) -> float:
        """Return how far the fading motion has come: ∫(1 - α) = u - u³ + u⁴/2."""
        return self._coast.speed_um_per_s * self._fade_s * (u - u**3 + u**4 / 2.0)


def eased(u: float) -> float:
    """Return the authority that has passed after a share u of the time, both 0 to 1."""
    return u * u * (3.0 - 2.0 * u)


def _minus(a: StagePoint, b: StagePoint) -> Vector3:
    return (a.x_um - b.x_um, a.y_um - b.y_um, a.z_um - b.z_um)
