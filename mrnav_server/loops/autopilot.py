"""Drives in AUTO: asks for paths, lets the follower lead the robot along them, and says when it is stuck."""

import math
from dataclasses import dataclass
from typing import Literal

from mrnav_server.autonomy.follower import Follower
from mrnav_server.autonomy.following import FollowerStatus, FollowerWish
from mrnav_server.autonomy.path import PlannedPath
from mrnav_server.core.frames import StagePoint, VesselPoint
from mrnav_server.core.records import TipReading, Track
from mrnav_server.core.shaping import Reference

_DISPLAY_POINTS = 64
_MOVED_UM = 50.0


@dataclass(frozen=True, slots=True)
class AutopilotConfig:
    """Who proposes the route, and when autonomy gives up.

    Attributes:
        source: The trained policy, or the clearance-aware geodesic as a baseline.
        greedy: Best action with direction memory; False samples from the policy's distribution, as the
            paper does.
        seed: Of that sampling.
        progress_s: AUTO ends when the robot has not moved for this long.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    source: Literal["policy", "geodesic"] = "policy"
    greedy: bool = True
    seed: int = 0
    progress_s: float = 2.0


@dataclass(frozen=True, slots=True)
class PathOrder:
    """A path that the follower needs, to be planned away from the event loop.

    Attributes:
        start: Where the robot is.
        target: Where it shall stop.
        back_off: Plan a way off the target instead, for a new approach.
    """

    start: VesselPoint
    target: VesselPoint
    back_off: bool


class Autopilot:
    """The policy's hand on the control loop.

    Args:
        config: Route and patience.
        follower: Leads the robot along a path.
        speed_um_per_s: Largest speed in AUTO.
        um_per_px: Size of a grid pixel.
        refusal: Why autonomy cannot be used at all (a policy that was not verified), else "".
    """

    def __init__(
        self,
        config: AutopilotConfig,
        follower: Follower,
        speed_um_per_s: float,
        um_per_px: float,
        refusal: str,
    ) -> None:
        self.refusal = refusal
        self.order: PathOrder | None = None
        self._config = config
        self._follower = follower
        self._speed_um_per_s = speed_um_per_s
        self._um_per_px = um_per_px
        self._path: PlannedPath | None = None
        self._target: VesselPoint | None = None
        self._handover_um = 0.0
        self._wish: FollowerWish | None = None
        self._robot: VesselPoint | None = None
        self._moved_s = 0.0
        self._fresh_path = False
        self._no_path = ""

    @property
    def path_px(self) -> tuple[tuple[float, float], ...]:
        """The planned path for display, thinned; empty without one."""
        if self._path is None:
            return ()
        points = self._path.points_px
        stride = max(1, math.ceil(len(points) / (_DISPLAY_POINTS - 1)))
        thinned = [*points[::stride], points[-1]]
        return tuple((float(x), float(y)) for x, y in thinned)

    @property
    def handover_s(self) -> float | None:
        """Estimate of the time until the operator takes over; None while not driving."""
        return self._wish.handover_s if self._wish is not None else None

    @property
    def at_target(self) -> bool:
        """Whether the robot rests near the target of the task."""
        return self._wish is not None and self._wish.status is FollowerStatus.ARRIVED

    def use(self, follower: Follower) -> None:
        """Take another follower; not while driving."""
        self._follower = follower

    def prepare(self, path: PlannedPath, target: VesselPoint, handover_um: float = 0.0) -> None:
        """Take the path of the next task; nothing moves before :meth:`begin`.

        Args:
            path: From where the robot is.
            target: Where it shall stop.
            handover_um: So far from there the operator takes over.
        """
        self._path, self._target, self._handover_um = path, target, handover_um

    def begin(self, track: Track, tip: TipReading, now_s: float) -> None:
        """Start driving along the prepared path.

        Raises:
            RuntimeError: If no path was prepared.
        """
        if self._path is None:
            raise RuntimeError("AUTO began without a path")
        self._follower.start(self._path, track, tip, now_s, self._handover_um)
        self._robot, self._moved_s = track.vessel, now_s
        self.order, self._wish, self._fresh_path, self._no_path = None, None, False, ""

    def end(self) -> None:
        """Stop driving: AUTO was left."""
        self._path = self._target = self._wish = self.order = None
        self._fresh_path = False

    def deliver(self, order: PathOrder, path: PlannedPath | None) -> None:
        """Take the path of an order; None (no way off the target) asks for the direct way instead."""
        if order is not self.order:
            return
        if path is None:
            self.order = PathOrder(order.start, order.target, back_off=False)
            return
        self._path, self._fresh_path, self.order = path, True, None

    def decline(self, order: PathOrder, reason: str) -> None:
        """Take note that an order cannot be met: the policy gives up."""
        if order is self.order:
            self._no_path = reason

    def reference(self, seen: Track | None, tip: TipReading, z_um: float, now_s: float) -> Reference | None:
        """Return where the tip should be; None while a path is being planned or the task is over.

        Args:
            seen: The newest track with a position.
            tip: The newest reading.
            z_um: Height to keep, in the stage frame.
            now_s: Now.
        """
        if seen is None or seen.vessel is None or self._target is None:
            return None
        self._note_motion(seen.vessel, now_s)
        if self._fresh_path and self._path is not None:
            self._follower.start(self._path, seen, tip, now_s, self._handover_um)
            self._fresh_path = False
        if self.order is not None:
            self._follower.watch(seen, tip)
            return None
        self._wish = wish = self._follower.step(now_s, seen, tip)
        if wish.status is FollowerStatus.REPLAN:
            self.order = PathOrder(seen.vessel, self._target, wish.back_off)
            return None
        if wish.status in (FollowerStatus.STUCK, FollowerStatus.LOST):
            return None
        return Reference(StagePoint(*wish.tip_um, z_um), (*wish.velocity_um_per_s, 0.0), self._speed_um_per_s)

    def watch(self, seen: Track | None, tip: TipReading) -> None:
        """Learn from motion that the operator commands, so that AUTO begins with what MANUAL taught."""
        self._follower.watch(seen, tip)

    def stuck(self, now_s: float) -> str:
        """Return why autonomy gives up, or ""."""
        if self._no_path:
            return self._no_path
        if self._wish is not None and self._wish.status in (FollowerStatus.STUCK, FollowerStatus.LOST):
            return self._wish.reason
        if self._robot is not None and now_s - self._moved_s > self._config.progress_s and not self.at_target:
            return f"no progress: the robot has not moved for {self._config.progress_s:.0f} s"
        return ""

    def _note_motion(self, robot: VesselPoint, now_s: float) -> None:
        if self._robot is None or robot.distance_px(self._robot) * self._um_per_px > _MOVED_UM:
            self._robot, self._moved_s = robot, now_s
