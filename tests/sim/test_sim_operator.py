"""The simulated operator: what its headset gives, and that it finishes the job on the simulated rig."""

import itertools
import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import welch

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.frames import StagePoint, VesselPoint
from mrnav_server.core.hand import HandConfig, HandControl
from mrnav_server.core.hand_stream import HandStream
from mrnav_server.core.modes import Mode
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.vessel import VesselMap
from mrnav_server.core.wire_hand import HandMessage
from mrnav_server.sim.operator import (
    MESSAGES_HZ,
    POSES_HZ,
    HandPose,
    OperatorModel,
    Phase,
    Sight,
    SimulatedOperator,
)
from mrnav_server.sim.world import SimConfig, SimulatedWorld
from mrnav_server.vision.vessel_model import vessel_map

TICK_S = 1.0 / MESSAGES_HZ
DISPLAY_DELAY_S = 0.06
MODEL = OperatorModel()
AWAY = (2000.0, 0.0)


def times(duration_s: float, start_s: float = 0.0) -> list[float]:
    return [start_s + i * TICK_S for i in range(round(duration_s * MESSAGES_HZ))]


def sight(t_s: float, mode: Mode = Mode.MANUAL, robot_um: tuple[float, float] | None = (0.0, 0.0)) -> Sight:
    return Sight(t_s, mode, robot_um, AWAY)


def act(operator: SimulatedOperator, until_s: float, start_s: float = 0.0, **seen: object) -> list[HandPose]:
    poses = []
    for t_s in times(until_s - start_s, start_s):
        operator.see(replace(sight(t_s), **seen))  # type: ignore[arg-type]
        poses.append(operator.hand(t_s))
    return poses


def after_handover() -> SimulatedOperator:
    operator = SimulatedOperator(MODEL, 1)
    act(operator, 0.5, mode=Mode.AUTO)
    return operator


def test_the_same_seed_gives_the_same_hand_and_another_seed_another() -> None:
    first, again, other = (act(SimulatedOperator(MODEL, seed), 1.0) for seed in (3, 3, 4))
    assert first == again
    assert first != other


def test_sixty_messages_carry_thirty_poses() -> None:
    poses = act(SimulatedOperator(MODEL, 1), 2.0)
    assert len(poses) == 2 * MESSAGES_HZ
    assert len({pose.number for pose in poses}) == 2 * POSES_HZ
    assert len({pose.point for pose in poses}) == 2 * POSES_HZ


def test_tremor_has_its_size_and_its_band() -> None:
    model = replace(MODEL, sway_m=0.0)
    operator = SimulatedOperator(model, 1)
    x_m = np.array([operator.hand(i / POSES_HZ + 1e-6).point.x_m for i in range(30 * POSES_HZ)])
    assert np.sqrt(np.mean(x_m**2)) == pytest.approx(1e-4, rel=0.15)
    hz, power = welch(x_m, POSES_HZ, nperseg=256)
    band = (hz > 7.5) & (hz < 12.5)
    assert power[band].sum() > 0.95 * power.sum()


def test_it_leaves_the_autonomy_alone_and_takes_nothing_that_was_not_handed_over() -> None:
    assert not any(pose.clutch for pose in act(SimulatedOperator(MODEL, 1), 5.0, mode=Mode.AUTO))
    assert not any(pose.clutch for pose in act(SimulatedOperator(MODEL, 1), 5.0, mode=Mode.MANUAL))


def test_it_closes_the_clutch_after_delay_reaction_and_grip() -> None:
    poses = act(after_handover(), 3.0, start_s=0.5)
    closed_s = next(t for t, pose in zip(times(2.5, 0.5), poses, strict=True) if pose.clutch)
    due_s = 0.5 + MODEL.visual_delay_s + MODEL.reaction_s + MODEL.grip_s
    assert due_s <= closed_s <= due_s + 4 / POSES_HZ


def test_it_pushes_along_the_error_and_longer_while_the_robot_sticks() -> None:
    operator = after_handover()
    poses = act(operator, 8.0, start_s=0.5)
    moved_um = MODEL.gain * 1e6 * (poses[-1].point.x_m - poses[0].point.x_m)
    sideways_um = MODEL.gain * 1e6 * (poses[-1].point.z_m - poses[0].point.z_m)
    assert moved_um > 5 * MODEL.push_um
    assert abs(sideways_um) < 0.1 * moved_um


def test_a_hold_opens_the_clutch_and_it_is_closed_anew() -> None:
    operator = after_handover()
    assert act(operator, 2.0, start_s=0.5)[-1].clutch
    held = act(operator, 3.5, start_s=2.0, mode=Mode.HOLD)
    after = [pose.clutch for pose in held[round(0.3 * MESSAGES_HZ) :]]
    assert False in after
    assert True in after[after.index(False) :]


def test_it_waits_while_the_robot_is_not_seen() -> None:
    operator = after_handover()
    poses = act(operator, 4.0, start_s=0.5, robot_um=None)
    assert operator.phase is Phase.LOOKING
    assert MODEL.gain * 1e6 * abs(poses[-1].point.x_m - poses[0].point.x_m) < MODEL.push_um


def test_it_grips_anew_where_its_reach_ends() -> None:
    operator = SimulatedOperator(replace(MODEL, reach_m=0.01), 1)
    act(operator, 0.5, mode=Mode.AUTO)
    poses = act(operator, 20.0, start_s=0.5)
    reach_m = [math.hypot(pose.point.x_m, pose.point.z_m) for pose in poses]
    assert max(reach_m) < 0.02
    closings = sum(b.clutch and not a.clutch for a, b in itertools.pairwise(poses))
    assert closings >= 3


def test_it_is_content_near_the_centre_and_lets_go() -> None:
    operator = after_handover()
    poses = act(operator, 4.0, start_s=0.5, robot_um=(AWAY[0] - 50.0, 0.0))
    assert operator.phase is Phase.FINISHED
    assert not poses[-1].clutch


def test_a_new_task_begins_with_the_next_autonomous_drive() -> None:
    operator = after_handover()
    act(operator, 4.0, start_s=0.5, robot_um=(AWAY[0] - 50.0, 0.0))
    act(operator, 5.0, start_s=4.0, mode=Mode.AUTO)
    assert act(operator, 7.0, start_s=5.0)[-1].clutch


def test_a_rig_that_was_disarmed_is_no_handover() -> None:
    operator = after_handover()
    act(operator, 1.0, start_s=0.5, mode=Mode.DISARMED)
    assert not any(pose.clutch for pose in act(operator, 4.0, start_s=1.0))


@pytest.fixture(scope="module")
def dish() -> VesselMap:
    y, x = np.mgrid[:600, :600]
    mask: ByteArray = (255 * (np.hypot(x - 300, y - 300) < 280)).astype(np.uint8)
    return vessel_map("dish", mask)


@pytest.mark.parametrize("friction", [0.1, 0.2, 0.3])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_brings_the_robot_to_the_centre_on_the_simulated_rig(
    dish: VesselMap, seed: int, friction: float
) -> None:
    rng = np.random.default_rng(seed)
    config = SimConfig(friction=friction, start=VesselPoint(300.0, 300.0), seed=seed)
    world = SimulatedWorld(config, dish, PictureFormat())
    came_from, away = rng.uniform(0.0, 2 * math.pi, 2)
    tip = world.tip
    parked = StagePoint(
        tip.x_um + 1500 * math.cos(came_from), tip.y_um + 1500 * math.sin(came_from), tip.z_um
    )
    world.set_target(parked, 1200.0)
    world.advance(2.0)

    def robot_um() -> tuple[float, float]:
        return world.true_calibration.stage_xy_um(world.robot)

    distance_um = rng.uniform(250.0, 500.0)
    x_um, y_um = robot_um()
    target_um = (x_um + distance_um * math.cos(away), y_um + distance_um * math.sin(away))
    operator, control = SimulatedOperator(MODEL, seed), HandControl(HandConfig(), 3000.0)
    stream = HandStream("test", Counter())
    for seq, t_s in enumerate(times(60.0)):
        mode = Mode.AUTO if t_s < 0.2 else Mode.MANUAL
        operator.see(Sight(t_s + DISPLAY_DELAY_S, mode, robot_um(), target_um))
        pose = operator.hand(t_s)
        message = HandMessage(seq, t_s, pose.point, pose.clutch, valid=True, pose=pose.number)
        sample = stream.take(message, t_s)
        assert sample is not None
        control.on_sample(sample)
        if control.take_closing():
            control.engage(world.tip, t_s)
        reference = control.reference(t_s)
        if reference is not None:
            world.set_target(reference.position, 3000.0)
        world.advance(TICK_S)
        if operator.phase is Phase.FINISHED:
            break
    world.advance(1.0)
    assert operator.phase is Phase.FINISHED
    assert math.dist(robot_um(), target_um) <= 150.0
    assert world.collisions == 0
