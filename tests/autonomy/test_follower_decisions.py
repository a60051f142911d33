"""What the follower decides, on scripted sightings."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mrnav_server.autonomy.follower import Follower
from mrnav_server.autonomy.following import FollowerConfig, FollowerStatus, FollowerWish
from mrnav_server.autonomy.observer import Coupling
from mrnav_server.autonomy.path import PlannedPath
from mrnav_server.autonomy.plane import Plane
from mrnav_server.core.frames import Affine2, Calibration, StagePoint, VesselPoint
from mrnav_server.core.limits import Limits
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import TipReading, Track, TrackState
from mrnav_server.core.shaping import Reference, Shaper
from mrnav_server.core.vessel import VesselMap
from mrnav_server.sim.world import SimConfig, SimulatedWorld

LEAD_UM = 400.0
PARALLEL = Calibration(
    image_from_vessel=Affine2.scale(1.0),
    stage_from_vessel=Affine2.scale(10.0, 500.0, 700.0),
    um_per_px=10.0,
    floor_z_um=0.0,
    magnet_offset_um=(1500.0, -400.0),
    critical_height_um=10_000.0,
)
TURNED = replace(PARALLEL, stage_from_vessel=Affine2(-6.0, 8.0, 8.0, 6.0, 3000.0, 2000.0))
START, TARGET = VesselPoint(893.0, 1500.0), VesselPoint(893.0, 900.0)


def track(taken_s: float, x_um: float, y_um: float) -> Track:
    seen = VesselPoint(x_um / 10.0, y_um / 10.0)
    return Track(taken_s, round(taken_s * 1000), TrackState.TRACKING, None, seen, 1.0, 4.0, 10)


def upward(
    start: VesselPoint = START, target: VesselPoint = TARGET, *, back_off: bool = False
) -> PlannedPath:
    """Return the straight path up the trunk."""
    y_px = np.arange(start.y_px, target.y_px - 0.5, -1.0)
    points_px = np.stack([np.full_like(y_px, start.x_px), y_px], axis=1)
    return PlannedPath(points_px, np.tile([0.0, -1.0], (len(y_px), 1)), target, "geodesic", back_off=back_off)


class Stage:
    """A perfect manipulator, and a robot that is a stone on a leash, seen without delay."""

    leash_um = LEAD_UM

    def __init__(self, vessel: VesselMap, calibration: Calibration = PARALLEL) -> None:
        self.plane = Plane(calibration)
        self.follower = Follower(FollowerConfig(), vessel, calibration, Coupling(lead_um=LEAD_UM))
        self.now_s = 10.0
        self.robot_um = (8930.0, 15000.0)
        self.hold_um = (8930.0, 15000.0 - 100.0)
        self.blind = self.glued = False
        self.wishes: list[FollowerWish] = []

    def begin(self, path: PlannedPath) -> None:
        self.follower.start(path, self.seen(), self.tip(), self.now_s)

    def seen(self) -> Track:
        return track(self.now_s, *self.robot_um)

    def tip(self) -> TipReading:
        return TipReading(self.now_s, StagePoint(*self.plane.tip_um(self.hold_um), 12_000.0), moving=True)

    def run(self, seconds: float, *, until: FollowerStatus | None = None) -> FollowerWish:
        for _ in range(round(seconds * 100)):
            self.now_s += 0.01
            wish = self.follower.step(self.now_s, None if self.blind else self.seen(), self.tip())
            self.wishes.append(wish)
            self.hold_um = self.plane.hold_um(StagePoint(*wish.tip_um, 0.0))
            away_um = math.dist(self.robot_um, self.hold_um)
            if away_um > self.leash_um and not self.glued:
                pull = 1.0 - self.leash_um / away_um
                self.robot_um = (
                    self.robot_um[0] + pull * (self.hold_um[0] - self.robot_um[0]),
                    self.robot_um[1] + pull * (self.hold_um[1] - self.robot_um[1]),
                )
            if wish.status is until:
                break
        return wish


@pytest.fixture
def stage(bifurcation: VesselMap) -> Stage:
    return Stage(bifurcation)


def test_it_takes_up_the_lead_follows_and_arrives(stage: Stage) -> None:
    stage.begin(upward())
    wish = stage.run(6.0, until=FollowerStatus.ARRIVED)
    assert wish.status is FollowerStatus.ARRIVED
    assert math.dist(stage.robot_um, (8930.0, 9000.0)) < 100.0
    stages = [w.status for w in stage.wishes]
    order = list(dict.fromkeys(stages))
    assert order == [
        FollowerStatus.TAKE_UP,
        FollowerStatus.FOLLOWING,
        FollowerStatus.SETTLING,
        FollowerStatus.ARRIVED,
    ]
    assert max(math.hypot(*w.velocity_um_per_s) for w in stage.wishes) == pytest.approx(3600.0, abs=5.0)
    assert max(abs(w.cross_track_um) for w in stage.wishes) < 5.0


def test_remaining_time_and_length_count_down_to_nothing(stage: Stage) -> None:
    stage.begin(upward())
    stage.run(6.0, until=FollowerStatus.ARRIVED)
    following = [w for w in stage.wishes if w.status is FollowerStatus.FOLLOWING]
    remaining = [w.remaining_um for w in following]
    assert remaining == sorted(remaining, reverse=True)
    assert following[10].handover_s == pytest.approx(0.01 * len(following[10:]), rel=0.1)
    assert stage.wishes[-1].handover_s == 0.0


def test_the_magnet_runs_ahead_by_the_lead(stage: Stage) -> None:
    stage.begin(upward())
    stage.run(1.2)
    ahead_um = stage.robot_um[1] - stage.hold_um[1]
    assert ahead_um == pytest.approx(LEAD_UM, abs=1.0)
    assert stage.follower.coupling.lead_um == pytest.approx(LEAD_UM - 0.022 * 3000.0, abs=60.0)


def test_the_lead_is_learnt_where_the_robot_breaks_away(stage: Stage) -> None:
    stage.leash_um = 900.0
    stage.begin(upward())
    stage.run(3.0, until=FollowerStatus.FOLLOWING)
    # A resting robot holds 1.2 times the lead of a moving one.
    assert stage.follower.coupling.lead_um == pytest.approx(900.0 / 1.2, abs=15.0)


def test_near_a_wall_the_magnet_draws_inward(stage: Stage, bifurcation: VesselMap) -> None:
    middle_px, edge_px = 893.0, float(np.nonzero(bifurcation.free[1500])[0].max()) - 4.0
    stage.robot_um, stage.hold_um = (10.0 * edge_px, 15000.0), (10.0 * edge_px, 14900.0)
    stage.begin(upward(VesselPoint(edge_px, 1500.0), VesselPoint(edge_px, 1450.0)))
    stage.run(0.1)
    gap_um = bifurcation.clearance_um(VesselPoint(edge_px, 1500.0))
    assert 30.0 < gap_um < 60.0
    assert 10.0 * edge_px - stage.hold_um[0] == pytest.approx(0.75 * (120.0 - gap_um), abs=3.0)
    assert edge_px > middle_px


def test_a_turned_and_mirrored_stage_makes_no_difference(bifurcation: VesselMap) -> None:
    straight, turned = Stage(bifurcation), Stage(bifurcation, TURNED)
    for rig in (straight, turned):
        rig.begin(upward())
        rig.run(2.0)
    assert turned.robot_um == pytest.approx(straight.robot_um, abs=1e-6)
    assert turned.hold_um == pytest.approx(straight.hold_um, abs=1e-6)


def test_a_robot_out_of_sight_is_lost(stage: Stage) -> None:
    stage.begin(upward())
    assert stage.run(1.5).status is FollowerStatus.FOLLOWING
    stage.blind = True
    assert stage.run(0.29).status is FollowerStatus.FOLLOWING
    wish = stage.run(0.03)
    assert wish.status is FollowerStatus.LOST
    assert "not seen" in wish.reason
    assert wish.velocity_um_per_s == (0.0, 0.0)
    stage.blind = False
    assert stage.run(0.5).tip_um == wish.tip_um


def test_a_robot_that_never_moves_is_stuck(stage: Stage) -> None:
    stage.glued = True
    stage.begin(upward())
    wish = stage.run(8.0, until=FollowerStatus.STUCK)
    assert wish.status is FollowerStatus.STUCK
    assert "has not moved for 5 s" in wish.reason
    assert (
        max(math.dist(stage.robot_um, stage.plane.hold_um(StagePoint(*w.tip_um, 0.0))) for w in stage.wishes)
        < 1650
    )


def test_a_robot_off_its_path_gets_a_new_one(stage: Stage) -> None:
    stage.begin(upward())
    stage.run(1.0)
    stage.robot_um = (stage.robot_um[0] + 560.0, stage.robot_um[1])
    stage.glued = True
    wish = stage.run(0.02)
    assert wish.status is FollowerStatus.REPLAN
    assert not wish.back_off
    assert "off its path" in wish.reason


def test_a_miss_asks_for_a_way_off_and_then_for_a_new_approach(stage: Stage) -> None:
    path = replace(upward(target=VesselPoint(893.0, 1200.0)), target=VesselPoint(893.0, 1180.0))
    stage.begin(path)
    missed = stage.run(6.0, until=FollowerStatus.REPLAN)
    assert (missed.status, missed.back_off) == (FollowerStatus.REPLAN, True)
    assert "µm from the target" in missed.reason
    x_px, y_px = stage.robot_um[0] / 10.0, stage.robot_um[1] / 10.0
    stage.begin(upward(VesselPoint(x_px, y_px), VesselPoint(x_px, y_px - 110.0), back_off=True))
    again = stage.run(6.0, until=FollowerStatus.REPLAN)
    assert (again.status, again.back_off) == (FollowerStatus.REPLAN, False)


def test_after_six_misses_it_gives_up(stage: Stage) -> None:
    for attempt in range(6):
        stage.robot_um, stage.hold_um = (8930.0, 15000.0), (8930.0, 14900.0)
        stage.begin(replace(upward(target=VesselPoint(893.0, 1460.0)), target=VesselPoint(893.0, 1420.0)))
        wish = stage.run(6.0, until=FollowerStatus.STUCK if attempt == 5 else FollowerStatus.REPLAN)
    assert wish.status is FollowerStatus.STUCK
    assert "missed 6 times" in wish.reason


def test_a_robot_at_its_target_has_arrived_without_a_move(stage: Stage) -> None:
    here = VesselPoint(893.0, 1503.0)
    stage.begin(replace(upward(target=VesselPoint(893.0, 1496.0)), target=here))
    held_um = stage.hold_um
    assert stage.run(1.0, until=FollowerStatus.ARRIVED).status is FollowerStatus.ARRIVED
    assert stage.hold_um == pytest.approx(held_um)


def test_a_path_needs_the_robot_in_sight(stage: Stage) -> None:
    with pytest.raises(ValueError, match="in sight"):
        stage.follower.start(upward(), replace(stage.seen(), vessel=None), stage.tip(), stage.now_s)


def test_watching_manual_motion_teaches_the_offset_error(bifurcation: VesselMap) -> None:
    config = SimConfig(start=START, offset_error_um=300.0)
    world = SimulatedWorld(config, bifurcation, PictureFormat(), seed=4)
    follower = Follower(FollowerConfig(), bifurcation, world.calibration)
    true_um, told_um = world.true_calibration.magnet_offset_um, world.calibration.magnet_offset_um
    error_um = (true_um[0] - told_um[0], true_um[1] - told_um[1])
    shaper = Shaper(Limits())
    shaper.reset(world.tip)
    begin = world.tip
    number = 0
    # By hand: 4 mm up the trunk and back, twice, at 2 mm/s.
    for i in range(800):
        if i % 3 == 0:
            seen = Track(world.time_s, number, TrackState.TRACKING, None, world.robot, 1.0, 4.0, 10)
            number += 1
        follower.watch(seen, TipReading(world.time_s, world.tip, world.moving))
        climb_um = 4000.0 - abs(4000.0 - 2000.0 * (0.01 * i % 4.0))
        wanted = StagePoint(begin.x_um, begin.y_um - climb_um, begin.z_um)
        world.set_target(shaper.step(0.01, Reference(wanted, (0.0, 0.0, 0.0), 3000.0)), 4500.0)
        world.advance(0.01)
    assert world.collisions == 0
    assert math.dist(follower.coupling.offset_um, error_um) < 40.0
