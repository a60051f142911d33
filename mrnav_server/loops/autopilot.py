"""Drives in AUTO: asks for paths, lets the follower lead the robot along them, and says when it is stuck."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from mrnav_server.autonomy.following import FollowerStatus, FollowerWish, Law
from mrnav_server.autonomy.path import PlannedPath
from mrnav_server.core.frames import StagePoint, VesselPoint
from mrnav_server.core.navigation import MAX_STEPS
from mrnav_server.core.records import TipReading, Track
from mrnav_server.core.shaping import Reference
from mrnav_server.loops.descent import HeightConfig
from mrnav_server.loops.progress import Progress

_DISPLAY_POINTS = 64
_STRIDE = 5

Log = Callable[[str, dict[str, Any]], None]


def _unheard(topic: str, data: Mapping[str, object]) -> None:
    pass


@dataclass(frozen=True, slots=True)
class AutopilotConfig:
    """Who proposes the route, how it is driven, and when autonomy gives up.

    Attributes:
        source: The trained policy, or the clearance-aware geodesic as a baseline.
        law: "path" makes the robot follow the path that the source rolls out; "direct" moves the magnet by
            each of the policy's actions, as the paper does, and needs the policy as its source.
        actions_per_s: How often the direct law asks the policy (1-60).
        greedy: Best action with direction memory; False samples from the policy's distribution, as the
            paper does.
        seed: Of that sampling.
        progress_s: AUTO ends when the robot has not moved, or has come no nearer along its way, for this
            long (0.5-2).
        most_reversals: AUTO ends when the robot has turned back more often than this without coming nearer
            (0-100).
        most_replans: AUTO ends when the robot has left its path more often than this in one task (0-100).
        height: At which height of the magnet it drives.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    source: Literal["policy", "geodesic"] = "policy"
    law: Literal["path", "direct"] = "path"
    actions_per_s: float = 30.0
    greedy: bool = True
    seed: int = 0
    progress_s: float = 2.0
    most_reversals: int = 10
    most_replans: int = 10
    height: HeightConfig = field(default_factory=HeightConfig)

    def __post_init__(self) -> None:
        if self.law == "direct" and self.source != "policy":
            raise ValueError('law "direct" needs source "policy": it asks the policy for every action')
        for name, least, most in (
            ("actions_per_s", 1.0, 60.0),
            ("progress_s", 0.5, 2.0),
            ("most_reversals", 0, 100),
            ("most_replans", 0, 100),
        ):
            if not least <= getattr(self, name) <= most:
                raise ValueError(f"{name} must lie between {least:g} and {most:g}")

    @property
    def longest_s(self) -> float:
        """Time for as many actions as an episode of the training has at most."""
        return MAX_STEPS / self.actions_per_s


@dataclass(frozen=True, slots=True)
class PathOrder:
    """A path that the follower needs, to be planned away from the event loop.

    Attributes:
        start: Where the robot is.
        target: Where it shall stop.
        back_off: Plan a way off the target instead, for a new approach.
        epsilon_um: So near to the target it must rest.
    """

    start: VesselPoint
    target: VesselPoint
    back_off: bool
    epsilon_um: float = math.inf


class Autopilot:
    """The policy's hand on the control loop.

    Args:
        config: Route and patience.
        law: Brings the robot to its target.
        speed_um_per_s: Largest speed in AUTO.
        um_per_px: Size of a grid pixel.
        refusal: Why autonomy cannot be used at all (a policy that was not verified), else "".
    """

    def __init__(
        self,
        config: AutopilotConfig,
        law: Law,
        speed_um_per_s: float,
        um_per_px: float,
        refusal: str,
    ) -> None:
        self.height = config.height
        self.refusal = refusal
        self.log: Log = _unheard
        """Told of every path that is taken, for a replay."""
        self.order: PathOrder | None = None
        self._config = config
        self._law = law
        self._speed_um_per_s = speed_um_per_s
        self._progress = Progress(config.progress_s, config.most_reversals, config.longest_s, um_per_px)
        self._path: PlannedPath | None = None
        self._target: VesselPoint | None = None
        self._handover_um, self._epsilon_um = 0.0, math.inf
        self._wish: FollowerWish | None = None
        self._fresh_path = False
        self._replans = 0
        self._gave_up = ""

    @property
    def path_px(self) -> tuple[tuple[float, float], ...]:
        """The planned path for display, thinned; empty without one."""
        if self._path is None:
            return ()
        points = self._path.points_px
        stride = max(1, math.ceil(len(points) / (_DISPLAY_POINTS - 1)))
        thinned = [*points[::stride], points[-1]]
        return tuple((float(x), float(y)) for x, y in thinned)

    def ahead(self, at: VesselPoint) -> list[VesselPoint]:
        """Return the planned path from the point nearest to a place on, thinned; empty without one."""
        if self._path is None:
            return []
        points = self._path.points_px
        nearest = int(np.argmin(np.hypot(points[:, 0] - at.x_px, points[:, 1] - at.y_px)))
        return [VesselPoint(float(x), float(y)) for x, y in points[nearest::_STRIDE]]

    @property
    def handover_s(self) -> float | None:
        """Estimate of the time until the operator takes over; None while not driving."""
        return self._wish.handover_s if self._wish is not None else None

    @property
    def at_target(self) -> bool:
        """Whether the robot rests near the target of the task."""
        return self._wish is not None and self._wish.status is FollowerStatus.ARRIVED

    @property
    def learned(self) -> dict[str, object]:
        """What has been learnt about magnet and robot, kept from task to task, for people and logs."""
        return self._law.coupling.described()

    def use(self, law: Law) -> None:
        """Take another law; not while driving."""
        self._law = law

    def prepare(
        self,
        path: PlannedPath,
        target: VesselPoint,
        handover_um: float = 0.0,
        epsilon_um: float = math.inf,
    ) -> None:
        """Take the path of the next task; nothing moves before :meth:`begin`.

        Args:
            path: From where the robot is.
            target: Where it shall stop.
            handover_um: So far from there the operator takes over.
            epsilon_um: So near to it the robot must rest.
        """
        self.log(
            "path",
            {
                "call": "prepare",
                "goal_px": (target.x_px, target.y_px),
                "handover_um": handover_um,
                "epsilon_um": epsilon_um,
                **_path_fields(path),
            },
        )
        self._path, self._target = path, target
        self._handover_um, self._epsilon_um = handover_um, epsilon_um

    def begin(self, track: Track, tip: TipReading, now_s: float) -> None:
        """Start driving along the prepared path.

        Raises:
            RuntimeError: If no path was prepared.
        """
        if self._path is None or track.vessel is None:
            raise RuntimeError("AUTO began without a path, or without the robot in sight")
        self._start(self._path, track, tip, now_s)
        self._progress.begin(track.vessel, now_s)
        self.order, self._wish, self._fresh_path = None, None, False
        self._replans, self._gave_up = 0, ""

    def end(self) -> None:
        """Stop driving: AUTO was left."""
        self._path = self._target = self._wish = self.order = None
        self._fresh_path = False

    def deliver(self, order: PathOrder, path: PlannedPath | None) -> None:
        """Take the path of an order; None (no way off the target) asks for the direct way instead."""
        if order is not self.order:
            return
        self.log("path", {"call": "deliver", **_path_fields(path)})
        if path is None:
            self.order = replace(order, back_off=False)
            return
        self._path, self._fresh_path, self.order = path, True, None

    def decline(self, order: PathOrder, reason: str) -> None:
        """Take note that an order cannot be met: the policy gives up."""
        if order is self.order:
            self.log("path", {"call": "decline", "reason": reason})
            self._gave_up = reason

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
        if self._fresh_path and self._path is not None:
            self._start(self._path, seen, tip, now_s)
            self._progress.restart(seen.vessel, now_s)
            self._fresh_path = False
        if self.order is not None:
            self._progress.note(seen.vessel, None, now_s)
            self._law.watch(seen, tip)
            return None
        self._wish = wish = self._law.step(now_s, seen, tip)
        if wish.coming:
            # A magnet that is far from the robot does not draw it yet.
            self._progress.restart(seen.vessel, now_s)
        self._progress.note(seen.vessel, wish.remaining_um, now_s)
        if wish.status is FollowerStatus.REPLAN:
            self._replan(seen.vessel, self._target, back_off=wish.back_off)
            return None
        if wish.status in (FollowerStatus.STUCK, FollowerStatus.LOST):
            return None
        return Reference(StagePoint(*wish.tip_um, z_um), (*wish.velocity_um_per_s, 0.0), self._speed_um_per_s)

    def wait(self, seen: Track | None, tip: TipReading, now_s: float) -> None:
        """Begin anew later: the magnet is being brought to the robot."""
        self._law.watch(seen, tip)
        if seen is not None and seen.vessel is not None:
            self._progress.restart(seen.vessel, now_s)
        self._fresh_path = self._path is not None

    def watch(self, seen: Track | None, tip: TipReading) -> None:
        """Learn from motion that the operator commands, so that AUTO begins with what MANUAL taught."""
        self._law.watch(seen, tip)

    def stuck(self, now_s: float) -> str:
        """Return why autonomy gives up, or ""."""
        if self._gave_up:
            return self._gave_up
        if self._wish is not None and self._wish.status in (FollowerStatus.STUCK, FollowerStatus.LOST):
            return self._wish.reason
        return "" if self._target is None or self.at_target else self._progress.objection(now_s)

    def _start(self, path: PlannedPath, track: Track, tip: TipReading, now_s: float) -> None:
        self._law.start(path, track, tip, now_s, self._handover_um, self._epsilon_um)

    def _replan(self, robot: VesselPoint, target: VesselPoint, *, back_off: bool) -> None:
        """Order another path; a robot that leaves its path again and again is left to the operator."""
        self.order = PathOrder(robot, target, back_off, self._epsilon_um)
        # A way off a missed target, and the one back to it, are counted by the follower's misses.
        self._replans += not back_off and self._path is not None and not self._path.back_off
        if self._replans > self._config.most_replans:
            self._gave_up = f"the robot has left its path {self._replans} times"


def _path_fields(path: PlannedPath | None) -> dict[str, object]:
    """Return a path for the log; how far the target is from everywhere follows from the vessel model."""
    if path is None:
        return {"points_px": None}
    return {
        "points_px": path.points_px.tolist(),
        "tangents": path.tangents.tolist(),
        "target_px": (path.target.x_px, path.target.y_px),
        "source": path.source,
        "fallback": path.fallback,
        "back_off": path.back_off,
    }
