"""What the follower is told and what it answers: gains, status and wish."""

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

from mrnav_server.autonomy.observer import Coupling, ObserverConfig
from mrnav_server.autonomy.path import PlannedPath
from mrnav_server.autonomy.profile import SpeedConfig
from mrnav_server.autonomy.watch import Vector
from mrnav_server.core.records import TipReading, Track

_WITHIN = 0.95
"""Whoever shall rest inside a circle aims for this share of its radius: the camera's robot is not exact."""


@dataclass(frozen=True, slots=True)
class FollowerConfig:
    """Gains and thresholds of the follower.

    Attributes:
        speed: Bounds on the speed along the path.
        observer: Gains of the observer of offset error and lead.
        cross_track_gain: Correction per cross-track error (0–1.5).
        wall_gain: Push per missing clearance within ``wall_um`` of the wall (0–2).
        wall_um: Gap between rim and wall below which the wall pushes, in µm (0–300).
        feedback_limit_um: Bound on both corrections together, in µm (100–1000).
        slow_cross_track_um: Cross-track error above which the reference slows down, in µm (50–500).
        behind_um: The reference slows down when the robot is further behind than this, in µm (100–1000).
        behind_span_um: It stands still when the robot is this much further behind, in µm (100–1000).
        preview_s: The lead points along the tangent that comes after this time (0–0.1).
        sticking_um_per_s: Speed of the reference while the robot sticks (800–3000).
        speed_up_um_per_s2: Largest acceleration of the reference after a slow-down (3000–20000).
        lead_rate_um_per_s: Rate at which the lead changes, beside half the speed (200–5000).
        offset_rate_um_per_s: Rate at which a newly learnt offset error moves the magnet (200–5000).
        take_up_share: Share of the lead that is taken up fast, before the robot can break away (0–0.9).
        take_up_fast_um_per_s: Speed of that (500–4000).
        take_up_um_per_s: Speed from there until the robot moves (200–1500).
        take_up_first_um_per_s: Speed of all of it as long as little was learnt: nobody knows yet which way
            the robot will break away (500–1500).
        learnt_looks: So many camera frames of a moving robot have to be seen before much was learnt (0–100).
        moved_um: The robot has broken away when it is seen to have moved this far, in µm (20–100).
        nudge_um: A path with less than this left after break-away is done, in µm (0–500).
        off_path_um: Cross-track error that asks for a new path, in µm (300–1500).
        arrival_um: The target counts as reached when the robot rests this near, in µm (50–500).
        rest_s: The robot rests when it stayed within ``rest_um`` for this long (0.1–0.5).
        rest_um: Noise of the camera that still counts as rest, in µm (10–100).
        settle_s: Longest wait for rest at the path's end (0.5–5).
        lost_after_s: Age of the last sighting at which the robot counts as lost (0.1–1).
        stuck_after_s: The robot is stuck when it has not moved for this long (2–20).
        most_misses: After this many misses of one target the follower gives up (1–20).
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    speed: SpeedConfig = field(default_factory=SpeedConfig)
    observer: ObserverConfig = field(default_factory=ObserverConfig)
    cross_track_gain: float = 0.5
    wall_gain: float = 0.75
    wall_um: float = 120.0
    feedback_limit_um: float = 400.0
    slow_cross_track_um: float = 150.0
    behind_um: float = 300.0
    behind_span_um: float = 400.0
    preview_s: float = 0.02
    sticking_um_per_s: float = 1500.0
    speed_up_um_per_s2: float = 9000.0
    lead_rate_um_per_s: float = 1200.0
    offset_rate_um_per_s: float = 1000.0
    take_up_share: float = 0.6
    take_up_fast_um_per_s: float = 2500.0
    take_up_um_per_s: float = 600.0
    take_up_first_um_per_s: float = 1200.0
    learnt_looks: int = 15
    moved_um: float = 33.0
    nudge_um: float = 200.0
    off_path_um: float = 500.0
    arrival_um: float = 100.0
    rest_s: float = 0.15
    rest_um: float = 25.0
    settle_s: float = 2.0
    lost_after_s: float = 0.3
    stuck_after_s: float = 5.0
    most_misses: int = 6

    def arrival_within_um(self, epsilon_um: float) -> float:
        """Return how near to its target the robot must rest, given the critical area's radius."""
        return min(self.arrival_um, _WITHIN * epsilon_um)


class FollowerStatus(Enum):
    """Where a task stands. The last four are final until the next `Follower.start`."""

    TAKE_UP = "take-up"
    """The magnet takes up the lead; the robot still rests."""
    FOLLOWING = "following"
    SETTLING = "settling"
    """The reference stands at the path's end; the robot comes to rest."""
    ARRIVED = "arrived"
    REPLAN = "replan"
    """A new path is wanted; `FollowerWish.back_off` says which."""
    STUCK = "stuck"
    """The robot does not move, or its target was missed too often."""
    LOST = "lost"
    """The robot has not been seen for too long."""


FINAL = frozenset({FollowerStatus.ARRIVED, FollowerStatus.REPLAN, FollowerStatus.STUCK, FollowerStatus.LOST})


@dataclass(frozen=True, slots=True)
class FollowerWish:
    """Where the follower wants the tip.

    Attributes:
        status: Where the task stands.
        tip_um: Wanted tip, stage x and y, in µm.
        velocity_um_per_s: Feed-forward velocity of the tip, stage x and y.
        remaining_um: Path left before the reference.
        handover_s: Estimate of the time until the operator takes over: at the path's end, or before it.
        cross_track_um: Distance of the robot to the path, signed.
        back_off: With REPLAN, whether a way off the target is wanted before the next approach.
        reason: Why a final status was taken, in plain words; else "".
        coming: Whether the magnet is still on its way to a robot that it may not draw yet.
    """

    status: FollowerStatus
    tip_um: Vector
    velocity_um_per_s: Vector
    remaining_um: float
    handover_s: float
    cross_track_um: float
    back_off: bool = False
    reason: str = ""
    coming: bool = False


class Law(Protocol):
    """How the robot is brought to a target: `Follower`, or `DirectLaw` as the published system does it."""

    @property
    def coupling(self) -> Coupling:
        """Return what has been learnt about magnet and robot."""

    def watch(self, track: Track | None, tip: TipReading) -> None:
        """Learn from motion that someone else commands."""

    def start(
        self,
        path: PlannedPath,
        track: Track,
        tip: TipReading,
        now_s: float,
        handover_um: float = 0.0,
        epsilon_um: float = math.inf,
    ) -> None:
        """Begin a path, with the robot in sight."""

    def step(self, now_s: float, track: Track | None, tip: TipReading) -> FollowerWish:
        """Return where the tip should be now."""
