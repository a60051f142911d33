"""The published system's law: each of the policy's actions moves the magnet by that action's step.

The policy sees the robot as the camera last saw it. Nothing leads, nothing corrects, nothing brakes for a
bend; the follower (`follower.py`) is measured against this law.
"""

import math
from dataclasses import dataclass

import numpy as np

from mrnav_server.autonomy.following import FINAL, FollowerConfig, FollowerStatus, FollowerWish
from mrnav_server.autonomy.observer import Coupling
from mrnav_server.autonomy.path import PlannedPath
from mrnav_server.autonomy.plane import Plane
from mrnav_server.autonomy.policy import Policy, Sampler, shield
from mrnav_server.autonomy.watch import RobotWatch, Vector
from mrnav_server.core.frames import Calibration
from mrnav_server.core.navigation import ACTIONS, STEP_PX, observation
from mrnav_server.core.records import TipReading, Track
from mrnav_server.core.vessel import VesselMap

_STOPPING_S = 0.04
_FOLLOWED_UM = 300.0
"""A magnet further than this from where the actions put it was kept from there by a limit."""


@dataclass(frozen=True, slots=True)
class ActionConfig:
    """How the policy is asked.

    Attributes:
        per_s: Actions per second; one for each picture of the camera.
        greedy: Best action with direction memory, or a draw from the policy's distribution.
        seed: Of that draw.
    """

    per_s: float = 30.0
    greedy: bool = True
    seed: int = 0


class DirectLaw:
    """Moves the magnet action by action; the counterpart of `Follower`, with the same calls.

    Args:
        config: Thresholds for arrival, rest and loss; the gains are not used.
        actions: How the policy is asked.
        policy: Whom.
        vessel: The vessel model.
        calibration: How vessel and manipulator see each other.
    """

    def __init__(
        self,
        config: FollowerConfig,
        actions: ActionConfig,
        policy: Policy,
        vessel: VesselMap,
        calibration: Calibration,
    ) -> None:
        self._config = config
        self._actions = actions
        self._policy = policy
        self._vessel = vessel
        self._plane = Plane(calibration)
        self._watch = RobotWatch(vessel, self._plane, config.observer, Coupling())

    @property
    def coupling(self) -> Coupling:
        """What has been learnt about magnet and robot; this law makes no use of it."""
        return self._watch.coupling

    def watch(self, track: Track | None, tip: TipReading) -> None:
        """Take in motion that someone else commands."""
        self._watch.take(track, tip)

    def start(
        self,
        path: PlannedPath,
        track: Track,
        tip: TipReading,
        now_s: float,
        handover_um: float = 0.0,
        epsilon_um: float = math.inf,
    ) -> None:
        """Begin a task.

        Args:
            path: Names the target, and how far it is from everywhere; its points are not followed.
            track: Where the robot was seen.
            tip: Where the tip is.
            now_s: The time.
            handover_um: So far from the target the operator takes over.
            epsilon_um: The robot must rest so near to the target.

        Raises:
            ValueError: If the track does not say where the robot is.
        """
        if track.vessel is None:
            raise ValueError("a task can only be started with the robot in sight")
        self._watch.take(track, tip)
        self._path = path
        self._arrival_um = self._config.arrival_within_um(epsilon_um)
        self._handover_um = handover_um
        self._target_um = self._plane.point_um(path.target)
        self._start_px = np.array([track.vessel.x_px, track.vessel.y_px])
        self._sampler = Sampler(greedy=self._actions.greedy, seed=self._actions.seed)
        self._status, self._reason = FollowerStatus.FOLLOWING, ""
        self._from_um = self._to_um = self._hold_um = self._watch.hold_um
        self._velocity: Vector = (0.0, 0.0)
        self._acted_s = self._settling_s = now_s
        self._next_s = now_s

    def step(self, now_s: float, track: Track | None, tip: TipReading) -> FollowerWish:
        """Return where the tip should be now; see `Follower.step`."""
        self._watch.take(track, tip)
        if self._status not in FINAL:
            self._decide(now_s)
        return self._wish()

    def _decide(self, now_s: float) -> None:
        config = self._config
        if now_s - self._watch.seen_s > config.lost_after_s:
            self._stop(FollowerStatus.LOST, f"the robot was not seen for {config.lost_after_s:.1f} s")
        elif self._status is FollowerStatus.SETTLING:
            self._settle(now_s)
        elif math.dist(self._watch.seen_um, self._target_um) < self._arrival_um:
            self._hold_um = self._from_um = self._to_um = self._watch.stopping_point_um(_STOPPING_S)
            self._velocity = (0.0, 0.0)
            self._status, self._settling_s = FollowerStatus.SETTLING, now_s
        else:
            if now_s >= self._next_s:
                self._act(now_s)
            share = min((now_s - self._acted_s) * self._actions.per_s, 1.0)
            (x, y), (to_x, to_y) = self._from_um, self._to_um
            self._hold_um = (x + share * (to_x - x), y + share * (to_y - y))

    def _act(self, now_s: float) -> None:
        """Ask the policy, and let the magnet move by the action's step until the next one."""
        um_per_px = self._vessel.um_per_px
        robot_px = np.array(self._watch.seen_um) / um_per_px
        target_px = np.array([self._path.target.x_px, self._path.target.y_px])
        logits = self._policy.logits(observation(robot_px, self._start_px, target_px)[None])
        if np.isnan(logits).any():
            self._stop(FollowerStatus.STUCK, f"policy {self._policy.name} answers with what is not a number")
            return
        action = int(self._sampler.choose(shield(self._vessel, robot_px[None], logits))[0])
        x, y = self._to_um
        if math.dist(self._to_um, self._watch.hold_um) > _FOLLOWED_UM:
            x, y = self._watch.hold_um
        dx, dy = float(ACTIONS[action, 0]) * um_per_px, float(ACTIONS[action, 1]) * um_per_px
        self._from_um, self._to_um = (x, y), (x + dx, y + dy)
        self._velocity = (dx * self._actions.per_s, dy * self._actions.per_s)
        # On the beat, so that the control loop's ticks do not lower the rate; a stall is not made up for.
        period_s = 1.0 / self._actions.per_s
        self._acted_s = now_s
        self._next_s = max(self._next_s + period_s, now_s)

    def _settle(self, now_s: float) -> None:
        """Wait for rest; a robot that came to rest too far away gets further actions."""
        config = self._config
        at_rest = self._watch.at_rest(config.rest_s, config.rest_um)
        if not at_rest and now_s - self._settling_s < config.settle_s:
            return
        miss_um = math.dist(self._watch.mean_um(config.rest_s), self._target_um)
        if miss_um < self._arrival_um:
            self._stop(FollowerStatus.ARRIVED, f"the robot rests {miss_um:.0f} µm from the target")
        else:
            self._status, self._next_s = FollowerStatus.FOLLOWING, now_s

    def _stop(self, status: FollowerStatus, reason: str) -> None:
        self._hold_um = self._watch.stopping_point_um(_STOPPING_S)
        self._velocity = (0.0, 0.0)
        self._status, self._reason = status, reason

    def _wish(self) -> FollowerWish:
        x_um, y_um = self._watch.seen_um
        um_per_px = self._vessel.um_per_px
        if self._path.to_go is not None:
            left_um = self._path.to_go.at_px(x_um / um_per_px, y_um / um_per_px) * um_per_px
        else:
            left_um = math.dist((x_um, y_um), self._target_um)
        speed_um_per_s = float(STEP_PX.mean()) * um_per_px * self._actions.per_s
        return FollowerWish(
            self._status,
            self._plane.tip_um(self._hold_um),
            self._plane.tip_velocity_um_per_s(self._velocity),
            left_um,
            max(left_um - self._handover_um, 0.0) / speed_um_per_s,
            0.0,
            reason=self._reason,
        )
