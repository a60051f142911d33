"""Blended control: shares in closed form, and on the simulated rig the hand always wins."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.autonomy.path import PathPlanner
from mrnav_server.core.frames import StagePoint
from mrnav_server.core.modes import Ask, Mode
from mrnav_server.core.shaping import Reference
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.handover import HandoverConfig
from mrnav_server.loops.sharing import Sharing, SharingConfig
from tests.loops.conftest import TICK_S, LockStep

CONFIG = SharingConfig(enabled=True)


def reference(x_um: float, vx: float = 0.0, vy: float = 0.0) -> Reference:
    return Reference(StagePoint(x_um, 0.0, 0.0), (vx, vy, 0.0), 3000.0)


def shared(sharing: Sharing, hand: Reference, now_s: float, **place: float) -> Reference:
    where = {"distance_um": 9000.0, "clearance_um": 500.0, "epsilon_um": 500.0} | place
    return sharing.reference(reference(100.0, 1000.0), hand, now_s=now_s, **where)


def begun() -> Sharing:
    return Sharing(CONFIG, reference(0.0), 0.0)


@pytest.mark.parametrize(
    ("place", "share"),
    [
        ({}, 0.3),
        ({"distance_um": 500.0}, 1.0),
        ({"distance_um": 2250.0}, 0.65),
        ({"distance_um": 500.0, "clearance_um": 0.0}, 0.3),
        ({"distance_um": 500.0, "clearance_um": 75.0}, 0.65),
    ],
)
def test_the_hands_share_grows_towards_the_area_and_shrinks_at_walls(
    place: dict[str, float], share: float
) -> None:
    sharing = begun()
    shared(sharing, reference(0.0), 0.01, **place)
    assert sharing.authority == pytest.approx(share)


def test_the_hand_deflects_the_policy_by_its_share() -> None:
    both = shared(begun(), reference(200.0, 500.0), 0.01)
    assert both.position.x_um == pytest.approx(100.0 + 0.3 * 200.0)
    assert both.velocity_um_per_s[0] == pytest.approx(1000.0 + 0.3 * 500.0)


def test_a_hand_that_keeps_disagreeing_has_taken_over() -> None:
    sharing = begun()
    for step in range(1, 60):
        shared(sharing, reference(0.0, -800.0), 0.01 * step)
        assert sharing.taken_over == (step >= 50)
    assert sharing.authority == pytest.approx(1.0)


def test_agreement_and_rest_take_nothing_over() -> None:
    sharing = begun()
    for step in range(1, 200):
        shared(sharing, reference(0.0, 800.0 if step % 2 else 0.0), 0.01 * step)
    assert not sharing.taken_over


@given(
    st.floats(0.0, 2e4),
    st.floats(-100.0, 2e3),
    st.floats(20.0, 2e3),
    st.lists(st.tuples(st.floats(-3e3, 3e3), st.floats(0.0, 0.1)), max_size=30),
)
def test_the_share_is_always_a_share(
    distance_um: float, clearance_um: float, epsilon_um: float, hands: list[tuple[float, float]]
) -> None:
    sharing, now_s = begun(), 0.0
    for velocity, dt_s in hands:
        now_s += dt_s
        shared(
            sharing,
            reference(0.0, velocity),
            now_s,
            distance_um=distance_um,
            clearance_um=clearance_um,
            epsilon_um=epsilon_um,
        )
        assert 0.0 <= sharing.authority <= 1.0


@pytest.mark.parametrize("values", [{"least": 1.1}, {"far_um": 0.0}, {"insist_s": 5.0}, {"wall_um": -1.0}])
def test_nonsense_is_refused(values: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(values))):
        SharingConfig(**values)  # type: ignore[arg-type]


@pytest.fixture
def together(bifurcation: VesselMap, planner: PathPlanner) -> LockStep:
    """A rig in AUTO on which a closed clutch shares control."""
    rig = LockStep(bifurcation, planner, handover=HandoverConfig(sharing=CONFIG))
    rig.advance(0.5)
    rig.mark(1)
    rig.ask(Ask.ARM)
    rig.start_auto()
    rig.advance(0.6)
    rig.clutch = True
    rig.send_hand()
    assert rig.is_in(Mode.AUTO)
    return rig


def test_a_closed_clutch_shares_and_an_open_one_gives_back(together: LockStep) -> None:
    together.advance(0.1)
    assert together.control.authority(together.now_s) > 0.0
    together.clutch = False
    together.advance(0.1)
    assert together.is_in(Mode.AUTO)
    assert together.control.authority(together.now_s) == 0.0


def test_pulling_back_takes_over_and_the_magnet_goes_where_the_hand_goes(together: LockStep) -> None:
    before = together.control.drive.shaper.velocity_um_per_s
    size = (before[0] ** 2 + before[1] ** 2) ** 0.5
    for _ in range(150):
        together.hand_x_m -= 0.05 * before[0] / size * TICK_S
        together.hand_z_m -= 0.05 * before[1] / size * TICK_S
        together.tick()
        if together.is_in(Mode.MANUAL):
            break
    assert together.is_in(Mode.MANUAL)
    for _ in range(50):
        together.hand_x_m -= 0.05 * before[0] / size * TICK_S
        together.hand_z_m -= 0.05 * before[1] / size * TICK_S
        together.tick()
    after = together.control.drive.shaper.velocity_um_per_s
    assert after[0] * before[0] + after[1] * before[1] < 0.0


def test_the_operator_may_always_ask_for_manual(together: LockStep) -> None:
    together.ask(Ask.MANUAL)
    assert together.is_in(Mode.MANUAL)
    assert together.control.authority(together.now_s) == 1.0
    at = together.control.drive.shaper.rest_point.array()
    together.advance(0.5)
    gone = together.control.drive.shaper.position.array() - at
    assert (gone**2).sum() ** 0.5 < 50.0


def test_together_they_arrive(together: LockStep) -> None:
    together.advance_until(Mode.MANUAL, 30.0)
    assert together.control.scene.distance_um is not None
    assert together.control.scene.distance_um <= 500.0
    assert together.world.collisions == 0
