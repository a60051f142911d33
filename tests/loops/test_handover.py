"""Hand-over: authority in closed form, and on the simulated rig no jump, no jolt, no standstill."""

import math
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.autonomy.path import PathPlanner
from mrnav_server.core.frames import StagePoint, VesselPoint
from mrnav_server.core.limits import Limits
from mrnav_server.core.modes import Ask, Mode
from mrnav_server.core.shaping import Reference
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.handover import Blend, HandoverConfig
from tests.loops.conftest import TICK_S, LockStep

AT = StagePoint(1000.0, 2000.0, 3000.0)
SPEED = 3000.0


def by_hand(x_um: float, vx_um_per_s: float = 0.0) -> Reference:
    return Reference(StagePoint(x_um, 0.0, 0.0), (vx_um_per_s, 0.0, 0.0), SPEED)


def handing_over(bifurcation: VesselMap, planner: PathPlanner, handover: HandoverConfig) -> LockStep:
    rig = LockStep(bifurcation, planner, handover=handover)
    rig.control.surroundings.announce = lambda left_s: rig.lines.append((rig.now_s, "told", {"in_s": left_s}))
    rig.advance(0.5)
    rig.mark()
    rig.ask(Ask.ARM)
    rig.start_auto()
    return rig


def distance_um(rig: LockStep) -> float:
    distance_um = rig.control.scene.distance_um
    assert distance_um is not None
    return distance_um


def told(rig: LockStep) -> list[tuple[float, float]]:
    """Return when the operator was told that control would be his, and in how many seconds."""
    return [(at_s, data["in_s"]) for at_s, topic, data in rig.lines if topic == "told"]


def test_authority_passes_smoothly_and_the_policys_motion_goes_half_as_far() -> None:
    blend = Blend(AT, (1000.0, -500.0, 0.0), HandoverConfig(blend_s=0.8), 500.0, 10.0)
    assert [blend.authority(10.0 + s) for s in (0.0, 0.2, 0.4, 0.6, 0.8, 5.0)] == pytest.approx(
        [0.0, 0.15625, 0.5, 0.84375, 1.0, 1.0]
    )
    assert blend.rest_point.array() == pytest.approx([1400.0, 1800.0, 3000.0])
    before, at, after = (blend.reference(None, 10.4 + s, SPEED) for s in (-1e-4, 0.0, 1e-4))
    assert before is not None
    assert at is not None
    assert after is not None
    speed = (after.position.array() - before.position.array()) / 2e-4
    assert speed[:2] == pytest.approx([500.0, -250.0], rel=1e-6)
    assert blend.reference(None, 10.81, SPEED) is None


@given(st.floats(0.1, 4500.0), st.floats(0.0, 2 * math.pi), st.floats(0.0, 1000.0), st.floats(20.0, 2000.0))
def test_the_policys_motion_ends_within_its_bounds(
    speed: float, angle: float, carry_um: float, epsilon_um: float
) -> None:
    velocity = (speed * math.cos(angle), speed * math.sin(angle), 0.0)
    blend = Blend(AT, velocity, HandoverConfig(carry_um=carry_um), epsilon_um, 0.0)
    assert math.dist(blend.rest_point.array(), AT.array()) <= min(carry_um, epsilon_um) + 1e-6


def test_the_hand_moves_the_tip_by_its_share_and_wholly_in_the_end() -> None:
    blend = Blend(AT, (0.0, 0.0, 0.0), HandoverConfig(blend_s=0.8, smooth_s=0.0), 500.0, 0.0)
    blend.reference(by_hand(7000.0), 0.0, SPEED)
    half = blend.reference(by_hand(7100.0), 0.4, SPEED)
    assert half is not None
    assert half.position.x_um == pytest.approx(1050.0)
    blend.reference(by_hand(7100.0), 0.8, SPEED)
    whole = blend.reference(by_hand(7300.0, 900.0), 0.9, SPEED)
    assert whole is not None
    assert whole.position.x_um == pytest.approx(1250.0)
    assert whole.velocity_um_per_s[0] == 900.0


def test_the_hand_is_averaged_at_first_and_not_in_the_end() -> None:
    config = HandoverConfig(blend_s=0.0, smooth_s=0.1, settle_s=1.0)
    blend = Blend(AT, (0.0, 0.0, 0.0), config, 500.0, 0.0)
    places = []
    for tick in range(200):
        reference = blend.reference(by_hand(1000.0 * tick * 0.001), tick * 0.001, SPEED)
        assert reference is not None
        places.append(reference.position.x_um - 1000.0)
    # A steady hand arrives late by half of the time over which it is averaged.
    assert 199.0 - places[-1] == pytest.approx(0.5 * 1000.0 * 0.1 * (1 - 0.2**2 * (3 - 0.4)), abs=3.0)
    last = blend.reference(by_hand(500.0), 1.5, SPEED)
    assert last is not None
    assert last.position.x_um == pytest.approx(1500.0)


def test_the_policys_motion_goes_on_along_its_way() -> None:
    way_um = [(100.0, 0.0), (0.0, 1000.0)]
    blend = Blend(AT, (1000.0, 0.0, 0.0), HandoverConfig(blend_s=0.8), 500.0, 0.0, way_um)
    assert blend.rest_point.array() == pytest.approx([1100.0, 2300.0, 3000.0])
    bent = blend.reference(None, 0.4, SPEED)
    assert bent is not None
    assert bent.velocity_um_per_s[0] == pytest.approx(0.0)
    assert bent.velocity_um_per_s[1] > 300.0


def test_a_clutch_that_was_opened_meanwhile_is_a_new_zero() -> None:
    blend = Blend(AT, (0.0, 0.0, 0.0), HandoverConfig(), 500.0, 0.0)
    blend.reference(by_hand(0.0), 0.5, SPEED)
    blend.reference(None, 0.6, SPEED)
    anew = blend.reference(by_hand(5000.0), 0.7, SPEED)
    assert anew is not None
    assert anew.position.x_um == pytest.approx(1000.0)


@pytest.mark.parametrize("name", ["announce_s", "blend_s", "carry_um", "smooth_s", "settle_s"])
def test_nonsense_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        HandoverConfig(**{name: -1.0})  # type: ignore[arg-type]


def test_the_way_ahead_begins_where_the_path_is_nearest(bifurcation: VesselMap, planner: PathPlanner) -> None:
    rig = handing_over(bifurcation, planner, HandoverConfig())
    path = rig.autopilot.path_px
    middle = VesselPoint(*path[len(path) // 2])
    ahead = rig.autopilot.ahead(VesselPoint(middle.x_px + 1.0, middle.y_px - 1.0))
    assert math.hypot(ahead[0].x_px - middle.x_px, ahead[0].y_px - middle.y_px) < 4.0
    assert math.hypot(ahead[-1].x_px - path[-1][0], ahead[-1].y_px - path[-1][1]) < 15.0
    rig.autopilot.end()
    assert rig.autopilot.ahead(middle) == []


def test_it_is_announced_once_and_in_time(bifurcation: VesselMap, planner: PathPlanner) -> None:
    rig = handing_over(bifurcation, planner, HandoverConfig())
    rig.advance_until(Mode.MANUAL, 20.0)
    ((told_s, left_s),) = told(rig)
    assert left_s <= 1.5
    assert rig.now_s - told_s == pytest.approx(left_s, abs=0.5)
    assert distance_um(rig) <= 500.0


def test_the_policy_slows_before_the_area_and_fades_out_inside(
    bifurcation: VesselMap, planner: PathPlanner
) -> None:
    rig = handing_over(bifurcation, planner, HandoverConfig())
    shaper = rig.control.drive.shaper
    rig.advance_until(Mode.MANUAL, 20.0)
    assert shaper.speed_um_per_s < 1700.0
    authority = []
    for _ in range(120):
        authority.append(rig.control.authority(rig.now_s))
        rig.tick()
    assert authority[0] < 0.01
    assert authority == sorted(authority)
    assert authority[-1] == 1.0
    assert shaper.at_rest
    assert distance_um(rig) < 500.0


def test_nobody_was_told_so_a_takeover_passes_at_once(bifurcation: VesselMap, planner: PathPlanner) -> None:
    rig = handing_over(bifurcation, planner, HandoverConfig(announce_s=0.05))
    rig.advance(0.8)
    assert rig.is_in(Mode.AUTO)
    rig.clutch = True
    rig.send_hand()
    assert rig.is_in(Mode.MANUAL)
    assert rig.control.authority(rig.now_s) == 1.0


def test_to_stop_first_is_to_rest_in_the_area(bifurcation: VesselMap, planner: PathPlanner) -> None:
    rig = handing_over(bifurcation, planner, HandoverConfig(style="stop"))
    rig.advance_until(Mode.MANUAL, 20.0)
    assert told(rig) == []
    assert rig.control.drive.shaper.speed_um_per_s < 50.0
    assert distance_um(rig) < 150.0


def test_the_papers_switch_is_immediate(bifurcation: VesselMap, planner: PathPlanner) -> None:
    rig = handing_over(bifurcation, planner, HandoverConfig(style="paper"))
    rig.advance_until(Mode.MANUAL, 20.0)
    assert told(rig) == []
    assert rig.control.authority(rig.now_s) == 1.0


@pytest.mark.parametrize("style", ["blended", "stop", "paper"])
def test_no_style_jumps_or_breaks_a_limit(
    bifurcation: VesselMap, planner: PathPlanner, style: Literal["blended", "stop", "paper"]
) -> None:
    rig = handing_over(bifurcation, planner, HandoverConfig(style=style))
    shaper, limits = rig.control.drive.shaper, Limits()
    left: list[int] = []
    before, accelerations = shaper.position.array(), []
    for tick in range(1500):
        rig.tick()
        if not left and rig.is_in(Mode.MANUAL):
            left.append(tick)
        if left and tick == left[0] + 10:
            rig.clutch = True
        if left and tick > left[0] + 12:
            rig.hand_x_m += 0.02 * TICK_S
        step_um = math.dist(shaper.position.array(), before)
        assert step_um <= limits.autonomy_speed_um_per_s * TICK_S * 1.01
        before = shaper.position.array()
        accelerations.append(shaper.acceleration_um_per_s2)
        if left and tick > left[0] + 150:
            break
    assert left, "the operator never got control"
    jerk = np.linalg.norm(np.diff(np.array(accelerations), axis=0), axis=1) / TICK_S
    assert jerk.max() <= limits.jerk_um_per_s3 * 1.001
    assert shaper.speed_um_per_s > 100.0
