"""The simulated operator: what it sees, what its headset gives, and that it steers to the target."""

import itertools
import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import welch

from mrnav_server.core.arrays import ByteArray, FloatArray
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.hand import HandConfig, HandControl
from mrnav_server.core.hand_stream import HandStream
from mrnav_server.core.limits import Limits
from mrnav_server.core.modes import Mode
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.shaping import Shaper
from mrnav_server.core.vessel import VesselMap
from mrnav_server.core.wire_hand import HandMessage
from mrnav_server.sim.operator import Condition, HandPose, Phase, Sight, SimulatedOperator
from mrnav_server.sim.operator_body import Body
from mrnav_server.sim.operator_model import (
    MESSAGES_HZ,
    POSES_HZ,
    OperatorModel,
    personal,
    practised,
    steady,
)
from mrnav_server.sim.operator_route import Route
from mrnav_server.sim.world import SimConfig, SimulatedWorld
from mrnav_server.vision.vessel_model import vessel_map

TICK_S = 1.0 / MESSAGES_HZ
MODEL = OperatorModel()
STEADY = steady(MODEL)


def straight(clearance_um: float = 300.0, length_um: float = 40_000.0) -> Route:
    x_um = np.linspace(0.0, length_um, 200)
    return Route(np.column_stack([x_um, np.zeros(200)]), np.full(200, clearance_um))


def sat_down(
    model: OperatorModel = STEADY, condition: Condition = "with_autonomy", route: Route | None = None
) -> SimulatedOperator:
    operator = SimulatedOperator(model, 1, condition)
    operator.know(route or straight())
    return operator


def act(
    operator: SimulatedOperator,
    until_s: float,
    start_s: float = 0.0,
    mode: Mode = Mode.MANUAL,
    robot_um: tuple[float, float] | None = (0.0, 0.0),
    handover_at_s: float | None = None,
) -> list[HandPose]:
    """Show a robot that does not move."""
    poses = []
    for index in range(round((until_s - start_s) * MESSAGES_HZ)):
        t_s = start_s + index * TICK_S
        in_s = None if handover_at_s is None else handover_at_s - t_s
        operator.see(Sight(t_s, mode, robot_um, handover_in_s=in_s))
        poses.append(operator.hand(t_s))
    return poses


def grip_s(poses: list[HandPose], start_s: float = 0.0) -> float:
    return start_s + next(i for i, pose in enumerate(poses) if pose.clutch) * TICK_S


def follow(operator: SimulatedOperator, duration_s: float, start_um: tuple[float, float]) -> FloatArray:
    """Let an ideal robot follow the hand at once; return where it was, shape (n, 2)."""
    robot_um = np.array(start_um)
    before: HandPose | None = None
    way = []
    for index in range(round(duration_s * MESSAGES_HZ)):
        t_s = index * TICK_S
        operator.see(Sight(t_s, Mode.MANUAL, (float(robot_um[0]), float(robot_um[1]))))
        pose = operator.hand(t_s)
        if before is not None and before.clutch and pose.clutch:
            step_m = (pose.point.x_m - before.point.x_m, pose.point.z_m - before.point.z_m)
            robot_um = robot_um + 1e6 * MODEL.gain * np.array(step_m)
        before = pose
        way.append(robot_um.copy())
    return np.array(way)


def speed_um_per_s(way_um: FloatArray, from_s: float, to_s: float) -> float:
    first, last = round(from_s * MESSAGES_HZ), round(to_s * MESSAGES_HZ)
    return float(np.hypot(*(way_um[last] - way_um[first]))) / (to_s - from_s)


def test_the_same_seed_gives_the_same_hand_and_another_seed_another() -> None:
    def poses(seed: int) -> list[HandPose]:
        operator = SimulatedOperator(MODEL, seed, "without_autonomy")
        operator.know(straight())
        return act(operator, 2.0)

    assert poses(3) == poses(3)
    assert poses(3) != poses(4)


def test_sixty_messages_carry_thirty_poses() -> None:
    poses = act(sat_down(MODEL), 2.0)
    assert len(poses) == 2 * MESSAGES_HZ
    assert len({pose.number for pose in poses}) == 2 * POSES_HZ
    assert len({pose.point for pose in poses}) == 2 * POSES_HZ


def displacements_m(model: OperatorModel, count: int = 60_000) -> FloatArray:
    body = Body(model, np.random.default_rng(1))
    return np.array([body.displacement_m(i / POSES_HZ, 1 / POSES_HZ) for i in range(count)])


def test_tremor_has_its_size_and_its_band() -> None:
    x_m = displacements_m(replace(STEADY, tremor_m=1e-4), 30 * POSES_HZ)[:, 0]
    assert np.sqrt(np.mean(x_m**2)) == pytest.approx(1e-4, rel=0.15)
    hz, power = welch(x_m, POSES_HZ, nperseg=256)
    band = (hz > 7.5) & (hz < 12.5)
    assert power[band].sum() > 0.95 * power.sum()


@pytest.mark.parametrize(
    ("part", "kept"),
    [
        ("posture", math.exp(-1 / (POSES_HZ * MODEL.posture_s))),
        ("jitter", 0.5),
        ("drift", math.exp(-1 / (POSES_HZ * MODEL.drift_s))),
    ],
)
def test_sway_and_tracking_errors_have_their_size_and_their_memory(part: str, kept: float) -> None:
    size_m = getattr(MODEL, f"{part}_m")
    errors_m = displacements_m(replace(STEADY, **{f"{part}_m": size_m}))
    assert errors_m.std(axis=0) == pytest.approx([size_m] * 3, rel=0.12)
    x_m = errors_m[:, 0]
    assert np.corrcoef(x_m[1:], x_m[:-1])[0, 1] == pytest.approx(kept, abs=0.02)


def test_a_steady_hand_does_only_what_it_means_to() -> None:
    poses = act(sat_down(), 3.0, mode=Mode.AUTO)
    assert {pose.point for pose in poses} == {poses[0].point}


def test_it_leaves_the_autonomy_alone_and_takes_nothing_that_was_not_handed_over() -> None:
    assert not any(pose.clutch for pose in act(sat_down(), 5.0, mode=Mode.AUTO))
    assert not any(pose.clutch for pose in act(sat_down(), 5.0, mode=Mode.MANUAL))


def test_an_unannounced_handover_costs_delay_reaction_and_grip() -> None:
    operator = sat_down()
    act(operator, 0.5, mode=Mode.AUTO)
    due_s = 0.5 + MODEL.visual_delay_s + MODEL.reaction_s + MODEL.grip_s
    assert due_s <= grip_s(act(operator, 3.0, start_s=0.5), 0.5) <= due_s + 2 / POSES_HZ


def test_an_announced_handover_finds_the_operator_ready() -> None:
    operator = sat_down()
    act(operator, 2.0, mode=Mode.AUTO, handover_at_s=2.0)
    assert operator.phase is Phase.REACHING
    closed_s = grip_s(act(operator, 3.0, start_s=2.0), 2.0)
    assert closed_s <= 2.0 + MODEL.visual_delay_s + 2 / POSES_HZ


def test_a_handover_that_is_overdue_is_taken() -> None:
    operator = sat_down()
    poses = act(operator, 4.0, mode=Mode.AUTO, handover_at_s=2.0)
    assert grip_s(poses) == pytest.approx(2.0 + MODEL.patience_s, abs=2 / POSES_HZ)


def test_without_autonomy_it_begins_when_the_rig_is_armed() -> None:
    operator = sat_down(condition="without_autonomy")
    assert not any(pose.clutch for pose in act(operator, 1.0, mode=Mode.DISARMED))
    due_s = 1.0 + MODEL.visual_delay_s + MODEL.start_s
    assert grip_s(act(operator, 3.0, start_s=1.0), 1.0) == pytest.approx(due_s, abs=2 / POSES_HZ)


def test_without_a_way_it_does_not_grip() -> None:
    operator = SimulatedOperator(STEADY, 1, "without_autonomy")
    assert not any(pose.clutch for pose in act(operator, 3.0))


def test_a_hold_opens_the_clutch_and_it_is_closed_anew() -> None:
    operator = sat_down(condition="without_autonomy")
    assert act(operator, 2.0)[-1].clutch
    held = [pose.clutch for pose in act(operator, 3.5, start_s=2.0, mode=Mode.HOLD)]
    assert False in held
    assert True in held[held.index(False) :]


def test_a_rig_that_was_disarmed_is_no_handover() -> None:
    operator = sat_down()
    act(operator, 0.5, mode=Mode.AUTO)
    act(operator, 1.0, start_s=0.5, mode=Mode.DISARMED)
    assert not any(pose.clutch for pose in act(operator, 4.0, start_s=1.0))


def test_the_clearance_sets_the_speed() -> None:
    unbounded = replace(STEADY, reach_m=10.0)
    for clearance_um in (100.0, 200.0):
        way_um = follow(sat_down(unbounded, "without_autonomy", straight(clearance_um)), 8.0, (0.0, 0.0))
        law = 2.0 * clearance_um / MODEL.steering_s
        assert speed_um_per_s(way_um, 4.0, 7.0) == pytest.approx(law, rel=0.03)


def test_a_narrow_place_ahead_slows_it_before_it_comes() -> None:
    x_um = np.linspace(0.0, 40_000.0, 800)
    room_um = np.where(x_um > 8000.0, 100.0, 300.0)
    route = Route(np.column_stack([x_um, np.zeros(800)]), room_um)
    way_um = follow(sat_down(replace(STEADY, reach_m=10.0), "without_autonomy", route), 8.0, (0.0, 0.0))
    speed = np.gradient(way_um[:, 0], TICK_S)
    at_narrowing = speed[np.argmax(way_um[:, 0] > 7990.0)]
    assert at_narrowing < 0.6 * speed[: np.argmax(way_um[:, 0] > 6000.0)].max()


def test_sideways_errors_decay_at_the_crossover_to_the_dead_zone() -> None:
    route = straight(1000.0)
    model = replace(STEADY, reach_m=10.0, prediction=1.0, system_delay_s=0.0, fastest_hand_m_per_s=0.05)
    way_um = follow(sat_down(model, "without_autonomy", route), 6.0, (0.0, 500.0))
    assert abs(way_um[-1, 1]) <= MODEL.dead_zone * 1000.0
    excess = way_um[:, 1] - MODEL.dead_zone * 1000.0
    fell = np.argmax(excess < 350.0 / math.e) * TICK_S - grip_s(
        act(sat_down(condition="without_autonomy"), 2.0)
    )
    # A movement takes its blend and its interval on top of the loop's own time.
    assert 0.5 / MODEL.crossover_per_s < fell < 0.5 / MODEL.crossover_per_s + 0.8


def test_a_robot_that_is_late_is_not_corrected_twice() -> None:
    """Prediction adds what the hand asked for since; without it the same error is answered again."""

    def overshoot(prediction: float) -> float:
        model = replace(STEADY, reach_m=10.0, prediction=prediction, crossover_per_s=3.0)
        way_um = follow(sat_down(model, "without_autonomy", straight(1000.0)), 8.0, (0.0, 600.0))
        return -float(way_um[:, 1].min())

    assert overshoot(0.0) > overshoot(0.8) + 20.0


def test_intermittent_movements_blend_without_a_kink() -> None:
    model = replace(STEADY, reach_m=10.0, interval_spread=0.2, speed_noise=0.15)
    # Not on a pose's very edge, where rounding would choose.
    poses = act(sat_down(model, "without_autonomy"), 6.0, start_s=1e-3)
    x_m = np.array([pose.point.x_m for pose in poses[::2]])
    acceleration = np.abs(np.diff(x_m, 2)) * POSES_HZ**2
    # A minimum-jerk change of speed Δv within T peaks at 1.875·Δv/T.
    largest_step = MODEL.fastest_hand_m_per_s
    assert acceleration.max() <= 1.875 * largest_step / MODEL.blend_s


def test_it_grips_anew_where_its_reach_ends() -> None:
    operator = sat_down(replace(STEADY, reach_m=0.05), "without_autonomy")
    poses = act(operator, 20.0)
    xs_m = [pose.point.x_m for pose in poses if pose.clutch]
    assert max(xs_m) - min(xs_m) < 0.12
    openings = [i for i, (a, b) in enumerate(itertools.pairwise(poses)) if a.clutch and not b.clutch]
    closings = [i for i, (a, b) in enumerate(itertools.pairwise(poses)) if b.clutch and not a.clutch]
    assert len(openings) >= 3
    assert operator.regrips >= 3
    away_s = (closings[1] - openings[0]) * TICK_S
    assert away_s == pytest.approx(MODEL.regrip_s + MODEL.grip_s, abs=2 / POSES_HZ)


def test_it_does_nothing_while_the_robot_is_not_seen() -> None:
    operator = sat_down(condition="without_autonomy")
    poses = act(operator, 4.0, robot_um=None)
    assert operator.phase is Phase.STEERING
    assert {pose.point for pose in poses} == {poses[0].point}


def test_it_is_content_near_the_target_lets_go_and_takes_hold_again_when_the_robot_slips() -> None:
    operator = sat_down(condition="without_autonomy", route=straight(length_um=3000.0))
    poses = act(operator, 3.0, robot_um=(2950.0, 0.0))
    assert operator.phase is Phase.FINISHED
    assert not poses[-1].clutch
    assert any(pose.clutch for pose in act(operator, 5.0, start_s=3.0, robot_um=(2700.0, 0.0)))


def test_operators_differ_and_each_is_always_the_same() -> None:
    people = [personal(MODEL, seed) for seed in range(300)]
    assert personal(MODEL, 7) == people[7]
    steering_s = np.array([person.steering_s for person in people])
    assert steering_s.mean() == pytest.approx(MODEL.steering_s, rel=0.05)
    assert steering_s.std() / steering_s.mean() == pytest.approx(0.20, abs=0.03)
    delays_s = np.array([person.visual_delay_s for person in people])
    assert delays_s.std() == pytest.approx(0.02, abs=0.004)
    assert delays_s.min() >= 0.14
    assert len({person.crossover_per_s for person in people}) == len(people)


def test_practice_makes_faster_by_its_power_law() -> None:
    assert practised(MODEL, 0) == MODEL
    assert practised(MODEL, 5).steering_s == pytest.approx(MODEL.steering_s * 2**-0.10)


def test_a_route_measures_along_and_across() -> None:
    corner_um = np.array([[0.0, 0.0], [3000.0, 0.0], [3000.0, 4000.0]])
    route = Route(corner_um, np.array([100.0, 200.0, 300.0]))
    assert route.length_um == 7000.0
    assert route.project(np.array([1000.0, 50.0])) == pytest.approx(1000.0, abs=30.0)
    assert route.offset_um(np.array([1000.0, 50.0]), 1000.0) == pytest.approx(50.0, abs=1.0)
    assert route.offset_um(np.array([3050.0, 2000.0]), 5000.0) == pytest.approx(-50.0, abs=1.0)
    assert route.clearance_um(0.0, 7000.0) == pytest.approx(100.0)
    assert route.clearance_um(5000.0, 7000.0) == pytest.approx(250.0, abs=3.0)
    # A way that passes near itself is followed on, not jumped over.
    hairpin_um = np.array([[0.0, 0.0], [9000.0, 0.0], [9000.0, 100.0], [0.0, 100.0]])
    hairpin = Route(hairpin_um, np.full(4, 100.0))
    assert hairpin.project(np.array([1000.0, 90.0]), near_um=1000.0) == pytest.approx(1000.0, abs=30.0)


@pytest.fixture(scope="module")
def channel() -> VesselMap:
    mask: ByteArray = np.zeros((1000, 1000), dtype=np.uint8)
    mask[400:600, 20:980] = 255
    return vessel_map("channel", mask)


@pytest.mark.parametrize("friction", [0.1, 0.3])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_steers_the_robot_to_the_target_on_the_simulated_rig(
    channel: VesselMap, seed: int, friction: float
) -> None:
    config = SimConfig(friction=friction, start=VesselPoint(120.0, 500.0), seed=seed)
    world = SimulatedWorld(config, channel, PictureFormat())
    (a, b, tx), (c, d, ty) = world.true_calibration.stage_from_vessel.rows()
    points_px = np.column_stack([np.linspace(120.0, 880.0, 100), np.full(100, 500.0)])
    points_um = points_px @ np.array([[a, c], [b, d]]) + [tx, ty]
    operator = SimulatedOperator(personal(MODEL, seed), seed, "without_autonomy")
    operator.know(Route(points_um, np.full(100, 500.0)))
    control, stream = HandControl(HandConfig(), 3000.0), HandStream("test", Counter())
    shaper = Shaper(Limits())
    shaper.reset(world.tip)
    content_s = 0.0
    for seq in range(60 * MESSAGES_HZ):
        t_s = seq * TICK_S
        robot_um = world.true_calibration.stage_xy_um(world.robot)
        operator.see(Sight(t_s + 0.03, Mode.MANUAL, robot_um))
        pose = operator.hand(t_s)
        message = HandMessage(seq, t_s, pose.point, pose.clutch, valid=True, pose=pose.number)
        sample = stream.take(message, t_s)
        assert sample is not None
        control.on_sample(sample)
        if control.take_closing():
            control.engage(world.tip, t_s)
        world.set_target(shaper.step(TICK_S, control.reference(t_s)), 5000.0)
        world.advance(TICK_S)
        content_s = content_s + TICK_S if operator.phase is Phase.FINISHED else 0.0
        if content_s > 1.0:
            break
    assert operator.phase is Phase.FINISHED
    assert math.dist(robot_um, (points_um[-1, 0], points_um[-1, 1])) <= 150.0
    assert world.collisions <= 1
