"""Makes the robot, not the magnet, follow a path.

At a few mm/s the robot is a stone on a leash of friction behind the magnet's hold point. So the hold
point runs a lead ahead of the reference along the path's tangent, and what the camera sees corrects the
lead and the error of the magnet's calibrated offset. Positions are in the vessel's plane in µm.
"""

import math

from mrnav_server.autonomy.following import FINAL, FollowerConfig, FollowerStatus, FollowerWish
from mrnav_server.autonomy.observer import Coupling
from mrnav_server.autonomy.path import PlannedPath
from mrnav_server.autonomy.plane import Plane
from mrnav_server.autonomy.rail import Rail
from mrnav_server.autonomy.take_up import TakeUp
from mrnav_server.autonomy.watch import RobotWatch, Vector
from mrnav_server.core.frames import Calibration, VesselPoint
from mrnav_server.core.records import TipReading, Track
from mrnav_server.core.vessel import VesselMap

_STOPPING_S = 0.04
_END_UM_PER_S = 300.0
"""Speed at which the robot is taken to creep up to its last place."""


class Follower:
    """Decides where the tip should be, step by step; told the time, it waits for nothing.

    Args:
        config: Gains and thresholds.
        vessel: The vessel model.
        calibration: How vessel and manipulator see each other.
        coupling: What an earlier follower learnt about magnet and robot.
    """

    def __init__(
        self,
        config: FollowerConfig,
        vessel: VesselMap,
        calibration: Calibration,
        coupling: Coupling | None = None,
    ) -> None:
        self._config = config
        self._vessel = vessel
        self._plane = Plane(calibration)
        self._watch = RobotWatch(vessel, self._plane, config.observer, coupling or Coupling())
        self._target: VesselPoint | None = None
        self._misses = 0

    @property
    def coupling(self) -> Coupling:
        """What has been learnt about magnet and robot, to be handed to the next follower."""
        return self._watch.coupling

    def watch(self, track: Track | None, tip: TipReading) -> None:
        """Learn from motion that someone else commands, so that autonomy begins with what MANUAL taught.

        Args:
            track: The newest track.
            tip: The newest reading.
        """
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
        """Begin a path; the robot may rest or move.

        Args:
            path: From about where the robot is.
            track: Where the robot was seen.
            tip: Where the tip is.
            now_s: The time.
            handover_um: So far from the target the operator takes over: no faster than the hand-over's speed.
            epsilon_um: The robot must rest so near to the target.

        Raises:
            ValueError: If the track does not say where the robot is.
        """
        if track.vessel is None:
            raise ValueError("a path can only be started with the robot in sight")
        if not path.back_off and path.target != self._target:
            self._target, self._misses = path.target, 0
        self._watch.take(track, tip)
        self._path = path
        self._arrival_um = self._config.arrival_within_um(epsilon_um)
        self._rail = Rail(path, self._vessel, self.coupling.lead_um, self._config.speed, handover_um)
        self._status = FollowerStatus.TAKE_UP
        self._last_s = self._moved_s = now_s
        self._moved_um = self._watch.seen_um
        self._drawing = TakeUp(self._config, self._watch, self._rail)
        self._offset_um = self.coupling.offset_um
        self._near = 0
        self._arc_um = self._cross_um = 0.0
        self._speed = self._config.take_up_um_per_s
        self._acceleration = self._velocity = (0.0, 0.0)
        self._hold_um = self._watch.hold_um
        self._back_off, self._reason = False, ""
        near_um = math.dist(self._moved_um, self._plane.point_um(path.target))
        if near_um < self._arrival_um and not path.back_off:
            self._arc_um = self._rail.length_um
            self._begin_settling(now_s, self._hold_um, 0.0, 0.0)

    def step(self, now_s: float, track: Track | None, tip: TipReading) -> FollowerWish:
        """Return where the tip should be now.

        Args:
            now_s: The time.
            track: The newest track; one that was seen before is not counted again.
            tip: The newest reading.
        """
        dt_s = min(max(now_s - self._last_s, 0.0), 0.05)
        self._last_s = now_s
        steady = self._status is not FollowerStatus.TAKE_UP
        rests = self._watch.take(track, tip, self._acceleration, learn=steady)
        if rests and self._status is FollowerStatus.FOLLOWING:
            self._lengthen_lead()
        if self._status not in FINAL:
            self._decide(now_s, dt_s)
        return self._wish()

    def _lengthen_lead(self) -> None:
        """Raise the lead of a robot that rests although its leash is past the point of breaking away."""
        taut_um = math.hypot(*self._watch.leash_um)
        if taut_um > self._config.observer.breakaway_ratio * self.coupling.lead_um:
            self._watch.learn_lead(taut_um)

    def _decide(self, now_s: float, dt_s: float) -> None:
        """Advance the task by one step."""
        config, rail = self._config, self._rail
        if now_s - self._watch.seen_s > config.lost_after_s:
            self._stop(FollowerStatus.LOST, f"the robot was not seen for {config.lost_after_s:.1f} s")
            return
        if self._coming or math.dist(self._watch.seen_um, self._moved_um) > 2.0 * config.rest_um:
            self._moved_um, self._moved_s = self._watch.seen_um, now_s
        robot_um = self._watch.robot_now_um()
        self._near, away_um = rail.nearest(robot_um, self._near)
        self._cross_um = rail.cross_track_um(robot_um, self._near)
        if self._status is FollowerStatus.SETTLING:
            self._settle(now_s, dt_s)
        elif now_s - self._moved_s > config.stuck_after_s:
            self._stop(FollowerStatus.STUCK, f"the robot has not moved for {config.stuck_after_s:.0f} s")
        elif away_um > config.off_path_um:
            self._stop(FollowerStatus.REPLAN, f"the robot is {away_um:.0f} µm off its path")
        elif self._status is FollowerStatus.TAKE_UP:
            self._take_up(now_s, dt_s, robot_um)
        else:
            self._follow(now_s, dt_s, robot_um)

    def _take_up(self, now_s: float, dt_s: float, robot_um: Vector) -> None:
        """Draw on until the robot moves; then follow the path from there."""
        if not self._drawing.moves():
            x_um, y_um = self._drawing.step(dt_s)
            fx, fy = self._feedback_um(robot_um)
            self._hold_um = (x_um + fx, y_um + fy)
            self._velocity = self._drawing.velocity_um_per_s
            return
        self._arc_um = self._near * self._rail.spacing_um
        # What is left of the lead: the magnet goes on from where it is, without a leap after the robot.
        self._lead_um = max(self._drawing.lead_um - self._arc_um, 0.0)
        if self._rail.length_um - self._arc_um < self._config.nudge_um:
            self._arc_um = self._rail.length_um
            self._begin_settling(now_s, self._watch.stopping_point_um(_STOPPING_S), 0.0, 0.0)
        else:
            self._status = FollowerStatus.FOLLOWING
            self._follow(now_s, dt_s, robot_um)

    def _follow(self, now_s: float, dt_s: float, robot_um: Vector) -> None:
        """Advance the reference and lead the robot along it."""
        config, rail, observer = self._config, self._rail, self._config.observer
        speed = self._governed_speed(dt_s)
        change = (speed - self._speed) / dt_s if dt_s > 0.0 else 0.0
        change = min(max(change, -20_000.0), 20_000.0)
        self._speed = speed
        self._arc_um = min(self._arc_um + speed * dt_s, rail.length_um)
        self._slew_lead(self.coupling.lead_um + observer.drag_s * speed, 0.5 * speed, dt_s)
        here = rail.index(self._arc_um)
        ahead = min(here + int(config.preview_s * speed / rail.spacing_um), rail.last)
        tx, ty = rail.tangent(ahead)
        kx, ky = rail.bend_per_um(ahead)
        gx, gy = rail.point_um(self._arc_um)
        bx, by = self._slew_offset(dt_s)
        fx, fy = self._feedback_um(robot_um)
        # The lead is bounded from where the robot is, so that the magnet never leaves it behind.
        px, py = gx + self._lead_um * tx + fx - robot_um[0], gy + self._lead_um * ty + fy - robot_um[1]
        shrink = min(1.0, observer.lead_limit_um / max(math.hypot(px, py), 1e-9))
        self._acceleration = (change * tx + speed * speed * kx, change * ty + speed * speed * ky)
        self._hold_um = (
            robot_um[0] + bx + px * shrink + observer.inertia_s2 * self._acceleration[0],
            robot_um[1] + by + py * shrink + observer.inertia_s2 * self._acceleration[1],
        )
        self._velocity = (speed * (tx + self._lead_um * kx), speed * (ty + self._lead_um * ky))
        if self._arc_um >= rail.length_um:
            end_lead_um = self.coupling.lead_um + observer.drag_s * _END_UM_PER_S
            self._begin_settling(now_s, (gx + bx + fx, gy + by + fy), self._lead_um, end_lead_um)

    def _governed_speed(self, dt_s: float) -> float:
        """Return the reference's speed: slower off the path and when the robot falls behind."""
        config = self._config
        behind_um = self._arc_um - self._near * self._rail.spacing_um
        on_path = max(0.25, 1.25 - abs(self._cross_um) / config.slow_cross_track_um)
        together = max(0.0, 1.0 - (behind_um - config.behind_um) / config.behind_span_um)
        wanted = self._rail.limit_um_per_s(self._arc_um) * min(1.0, on_path, together)
        if self._watch.sticks:
            # The faster the reference runs away from a robot that sticks, the further that slips afterwards;
            # slower still, it would stick again and again.
            wanted = min(wanted, config.sticking_um_per_s)
        return min(wanted, self._speed + config.speed_up_um_per_s2 * dt_s)

    def _slew_lead(self, wanted_um: float, rate_um_per_s: float, dt_s: float) -> None:
        """Move the lead towards a wanted one."""
        wanted_um = min(wanted_um, self._config.observer.lead_limit_um)
        step_um = (self._config.lead_rate_um_per_s + rate_um_per_s) * dt_s
        self._lead_um += min(max(wanted_um - self._lead_um, -step_um), step_um)

    def _slew_offset(self, dt_s: float) -> Vector:
        """Move the offset error that the magnet makes up for towards what was learnt, and return it."""
        (x_um, y_um), (to_x_um, to_y_um) = self._offset_um, self.coupling.offset_um
        away_um = math.hypot(to_x_um - x_um, to_y_um - y_um)
        share = min(1.0, self._config.offset_rate_um_per_s * dt_s / max(away_um, 1e-9))
        self._offset_um = (x_um + share * (to_x_um - x_um), y_um + share * (to_y_um - y_um))
        return self._offset_um

    def _feedback_um(self, robot_um: Vector) -> Vector:
        """Return the correction of cross-track error plus the push away from a near wall."""
        config, um_per_px = self._config, self._vessel.um_per_px
        tx, ty = self._rail.tangent(self._near)
        fx = config.cross_track_gain * self._cross_um * ty
        fy = -config.cross_track_gain * self._cross_um * tx
        x_px, y_px = robot_um[0] / um_per_px, robot_um[1] / um_per_px
        gap_um = (self._vessel.wall_distance_px(x_px, y_px) - self._vessel.robot_radius_px) * um_per_px
        if gap_um < config.wall_um:
            gx, gy = self._vessel.wall_gradient(x_px, y_px)
            push_um = config.wall_gain * (config.wall_um - max(gap_um, -50.0))
            fx += push_um * gx
            fy += push_um * gy
        shrink = min(1.0, config.feedback_limit_um / max(math.hypot(fx, fy), 1e-9))
        return fx * shrink, fy * shrink

    def _begin_settling(self, now_s: float, stand_um: Vector, lead_um: float, end_lead_um: float) -> None:
        """Freeze the feedback and let the robot come to rest at the path's end."""
        self._status, self._settling_s = FollowerStatus.SETTLING, now_s
        self._stand_um, self._lead_um, self._end_lead_um = stand_um, lead_um, end_lead_um
        self._settle(now_s, 0.0)

    def _settle(self, now_s: float, dt_s: float) -> None:
        """Wait for rest, then judge the distance to the target."""
        self._slew_lead(self._end_lead_um, 0.0, dt_s)
        tx, ty = self._rail.tangent(self._rail.last)
        self._hold_um = (self._stand_um[0] + self._lead_um * tx, self._stand_um[1] + self._lead_um * ty)
        self._velocity = (0.0, 0.0)
        at_rest = self._watch.at_rest(self._config.rest_s, self._config.rest_um)
        if not at_rest and now_s - self._settling_s < self._config.settle_s:
            return
        miss_um = math.dist(self._watch.mean_um(self._config.rest_s), self._plane.point_um(self._path.target))
        if self._path.back_off:
            self._stop(FollowerStatus.REPLAN, "there is room for a new approach")
        elif miss_um < self._arrival_um:
            self._stop(FollowerStatus.ARRIVED, f"the robot rests {miss_um:.0f} µm from the target")
        elif self._misses + 1 >= self._config.most_misses:
            self._stop(FollowerStatus.STUCK, f"the target was missed {self._config.most_misses} times")
        else:
            self._misses += 1
            self._back_off = True
            self._stop(FollowerStatus.REPLAN, f"the robot rests {miss_um:.0f} µm from the target")

    def _stop(self, status: FollowerStatus, reason: str) -> None:
        """Take a final status and bring the tip to rest."""
        if self._status is not FollowerStatus.SETTLING:
            self._hold_um = self._watch.stopping_point_um(_STOPPING_S)
        self._velocity = (0.0, 0.0)
        self._status, self._reason = status, reason

    def _wish(self) -> FollowerWish:
        left_um = self._rail.length_um - self._arc_um
        until_moving_s = self._drawing.left_s if self._status is FollowerStatus.TAKE_UP else 0.0
        return FollowerWish(
            self._status,
            self._plane.tip_um(self._hold_um),
            self._plane.tip_velocity_um_per_s(self._velocity),
            left_um,
            until_moving_s + self._rail.time_to_handover_s(self._arc_um),
            self._cross_um,
            self._back_off,
            self._reason,
            self._coming,
        )

    @property
    def _coming(self) -> bool:
        return self._status is FollowerStatus.TAKE_UP and self._drawing.coming
