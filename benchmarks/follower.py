"""How well the follower makes a simulated robot follow its paths; prints one JSON object.

Every task starts in a new simulated world: a random pair of places, an unknown 100 µm error of the magnet's
offset, a camera at 30 fps with delay and noise, the shaper and the manipulator's lag in the loop. All figures
are simulated.
"""

import argparse
import json
import math
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mrnav_server.autonomy.follower import Follower
from mrnav_server.autonomy.following import FINAL, FollowerConfig, FollowerStatus
from mrnav_server.autonomy.observer import Coupling
from mrnav_server.autonomy.path import PathPlanner, PlannedPath
from mrnav_server.autonomy.policy import Policy
from mrnav_server.autonomy.torchscript import load_policy
from mrnav_server.core.arrays import FloatArray
from mrnav_server.core.frames import StagePoint, VesselPoint
from mrnav_server.core.limits import Limits, allowed_target
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import TipReading, Track, TrackState
from mrnav_server.core.shaping import Reference, Shaper
from mrnav_server.core.vessel import VesselMap
from mrnav_server.sim.world import SimConfig, SimulatedWorld
from mrnav_server.vision.vessel_model import load_vessel_model

MODELS = Path(__file__).parent.parent / "policies"
TICK_MS, SAMPLE_MS, PLANNING_MS = 10, 20, 100
ARRIVED_UM = 100.0
LEAST_STEP_UM = 20.0
"""Shorter motion between two samples is trembling, not progress."""


@dataclass
class Outcome:
    """What one task came to; distances in µm, times in s."""

    status: FollowerStatus
    contacts: int
    lifted: bool
    final_distance_um: float
    time_s: float
    driven_um: float
    replans: int
    source: str
    cross_track_um: list[float]
    gap_um: float
    step_s: list[float]
    plan_s: list[float]


class Bench:
    """One vessel, one planner, many tasks.

    Args:
        vessel: The vessel model.
        policy: Who proposes routes; None for the geodesic.
        options: The command line.
    """

    def __init__(self, vessel: VesselMap, policy: Policy | None, options: argparse.Namespace) -> None:
        self._vessel = vessel
        self._policy = policy
        self._options = options
        self._planner = PathPlanner(vessel)
        self._coupling = Coupling()

    def task(self, number: int, start: VesselPoint, target: VesselPoint) -> Outcome:
        """Drive the robot from start to target and back off and on again until it rests there."""
        options = self._options
        sim = SimConfig(
            start=start,
            friction=options.friction,
            height_factor=options.height_factor,
            offset_error_um=options.offset_error_um,
        )
        picture = PictureFormat(fps=options.fps)
        world = SimulatedWorld(sim, self._vessel, picture, seed=options.seed if options.carry else number)
        noise = np.random.default_rng([options.seed, number])
        limits = Limits()
        shaper = Shaper(limits)
        shaper.reset(world.tip)
        coupling = self._coupling if options.carry else Coupling()
        follower = Follower(FollowerConfig(), self._vessel, world.calibration, coupling)
        frames: deque[Track] = deque()
        track = _track(world, 0, noise, options.noise_um)
        path = self._plan(track, target, back_off=False)
        path_s = [self._planned_s]
        reading = TipReading(world.time_s, world.tip, world.moving)
        follower.start(path, track, reading, world.time_s)
        outcome = Outcome(
            FollowerStatus.TAKE_UP, 0, False, 0.0, 0.0, 0.0, 0, path.source, [], math.inf, [], path_s
        )  # fmt: skip
        last_um = self._um(world.robot)
        restart_ms = 0
        arrived_s: float | None = None
        frame = 1
        for ms in range(1, 60_000):
            world.advance(0.001)
            if ms * options.fps // 1000 >= frame:
                frames.append(_track(world, frame, noise, options.noise_um))
                frame += 1
            while frames and frames[0].taken_s + options.latency_ms * 1e-3 <= world.time_s + 1e-9:
                track = frames.popleft()
            robot_um = self._um(world.robot)
            if ms % SAMPLE_MS == 0:
                if math.dist(last_um, robot_um) > LEAST_STEP_UM:
                    outcome.driven_um += math.dist(last_um, robot_um)
                    last_um = robot_um
                outcome.gap_um = min(outcome.gap_um, self._vessel.clearance_um(world.robot))
                if outcome.status is FollowerStatus.FOLLOWING:
                    outcome.cross_track_um.append(_distance_um(path, robot_um, self._vessel.um_per_px))
            if arrived_s is None and math.dist(robot_um, self._um(target)) < ARRIVED_UM:
                arrived_s = world.time_s
            if ms % TICK_MS:
                continue
            reading = TipReading(world.time_s, world.tip, world.moving)
            if outcome.status is FollowerStatus.REPLAN and ms >= restart_ms:
                follower.start(path, track, reading, world.time_s)
            began = time.perf_counter()
            wish = follower.step(world.time_s, track, reading)
            outcome.step_s.append(time.perf_counter() - began)
            if wish.status is FollowerStatus.REPLAN and outcome.status is not FollowerStatus.REPLAN:
                outcome.replans += 1
                path = self._plan(track, target, back_off=wish.back_off)
                path_s.append(self._planned_s)
                restart_ms = ms + PLANNING_MS
            outcome.status = wish.status
            position = StagePoint(*wish.tip_um, world.tip.z_um)
            allowed = allowed_target(position, limits, world.calibration, self._vessel)
            velocity = (*wish.velocity_um_per_s, 0.0)
            setpoint = shaper.step(
                TICK_MS * 1e-3, Reference(allowed, velocity, limits.autonomy_speed_um_per_s)
            )
            world.set_target(setpoint, limits.autonomy_speed_um_per_s)
            if world.lifted or (wish.status in FINAL and wish.status is not FollowerStatus.REPLAN):
                break
        self._coupling = follower.coupling
        outcome.contacts, outcome.lifted = world.collisions, world.lifted
        outcome.final_distance_um = math.dist(self._um(world.robot), self._um(target))
        outcome.time_s = arrived_s or world.time_s
        return outcome

    def _um(self, point: VesselPoint) -> tuple[float, float]:
        return point.x_px * self._vessel.um_per_px, point.y_px * self._vessel.um_per_px

    def _plan(self, track: Track, target: VesselPoint, *, back_off: bool) -> PlannedPath:
        assert track.vessel is not None
        began = time.perf_counter()
        path = self._planner.plan_back_off(track.vessel, target) if back_off else None
        path = path or self._planner.plan(track.vessel, target, self._policy)
        self._planned_s = time.perf_counter() - began
        return path


def _track(world: SimulatedWorld, number: int, noise: np.random.Generator, sigma_um: float) -> Track:
    robot = world.robot
    dx, dy = noise.normal(0.0, sigma_um / world.calibration.um_per_px, 2)
    seen = VesselPoint(robot.x_px + float(dx), robot.y_px + float(dy))
    image = world.calibration.image_point(seen)
    return Track(world.time_s, number, TrackState.TRACKING, image, seen, 1.0, sigma_um, 10)


def _distance_um(path: PlannedPath, robot_um: tuple[float, float], um_per_px: float) -> float:
    away_um = np.hypot(*(path.points_px * um_per_px - np.array(robot_um)).T)
    return float(away_um.min()) if 0 < int(np.argmin(away_um)) < len(away_um) - 1 else math.nan


def random_tasks(vessel: VesselMap, count: int, seed: int) -> list[tuple[VesselPoint, VesselPoint]]:
    """Return random starts, 50 µm or more from the wall, and targets anywhere in the free space."""
    rng = np.random.default_rng(seed)
    y, x = np.nonzero(vessel.free)
    tasks: list[tuple[VesselPoint, VesselPoint]] = []
    while len(tasks) < count:
        i, j = rng.integers(0, len(x), 2)
        start, target = VesselPoint(float(x[i]), float(y[i])), VesselPoint(float(x[j]), float(y[j]))
        if vessel.clearance_um(start) >= 50.0 and start.distance_px(target) > 20.0:
            tasks.append((start, target))
    return tasks


def summary(outcomes: list[Outcome], options: argparse.Namespace) -> dict[str, object]:
    """Return the figures over all tasks."""
    cross: FloatArray = np.array([c for o in outcomes for c in o.cross_track_um])
    cross = cross[np.isfinite(cross)]
    steps_us = 1e6 * np.array([s for o in outcomes for s in o.step_s])
    plans_ms = 1e3 * np.array([s for o in outcomes for s in o.plan_s])
    seconds = sum(o.time_s for o in outcomes)
    return {
        "simulated": True,
        "options": vars(options),
        "tasks": len(outcomes),
        "reached": float(np.mean([o.status is FollowerStatus.ARRIVED for o in outcomes])),
        "reached_at_first_stop": float(np.mean([o.replans == 0 for o in outcomes])),
        "contacts": sum(o.contacts for o in outcomes),
        "tasks_with_contact": sum(o.contacts > 0 for o in outcomes),
        "lifted": sum(o.lifted for o in outcomes),
        "final_distance_um": {
            "median": float(np.median([o.final_distance_um for o in outcomes])),
            "max": max(o.final_distance_um for o in outcomes),
        },
        "least_gap_um": min(o.gap_um for o in outcomes),
        "speed_along_path_um_per_s": sum(o.driven_um for o in outcomes) / seconds,
        "cross_track_um": {"rms": float(np.sqrt(np.mean(cross**2))), "max": float(cross.max())},
        "replans": sum(o.replans for o in outcomes),
        "policy_paths": sum(o.source == "policy" for o in outcomes),
        "step_us": {"p50": float(np.percentile(steps_us, 50)), "p99": float(np.percentile(steps_us, 99))},
        "plan_ms": {"p50": float(np.percentile(plans_ms, 50)), "max": float(plans_ms.max())},
    }


def main() -> None:
    """Run the tasks and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", default="bifurcation")
    parser.add_argument("--policy", action="store_true", help="the model's policy proposes the routes")
    parser.add_argument("--tasks", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--friction", type=float, default=0.2)
    parser.add_argument("--height-factor", type=float, default=1.04)
    parser.add_argument("--offset-error-um", type=float, default=100.0)
    parser.add_argument("--latency-ms", type=float, default=25.0)
    parser.add_argument("--noise-um", type=float, default=4.0)
    parser.add_argument("--fps", type=int, default=30)
    parser.add_argument("--carry", action="store_true", help="keep offset and lead from task to task")
    options = parser.parse_args()
    vessel = load_vessel_model(MODELS / options.model)
    bench = Bench(vessel, load_policy(MODELS / options.model, vessel) if options.policy else None, options)
    tasks = random_tasks(vessel, options.tasks, options.seed)
    outcomes = [bench.task(number, start, target) for number, (start, target) in enumerate(tasks)]
    print(json.dumps(summary(outcomes, options), indent=2))


if __name__ == "__main__":
    main()
