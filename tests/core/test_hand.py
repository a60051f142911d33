"""The hand: clutch, re-zero, gain, bounds; loss and repetition never drift."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrnav_server.core.frames import HandPoint, StagePoint
from mrnav_server.core.hand import HandConfig, HandControl
from mrnav_server.core.hand_stream import HandSample

BASE = StagePoint(10_000, 10_000, 12_000)


def sample(t_s: float, x_m: float = 0.0, z_m: float = 0.0, **changes: object) -> HandSample:
    fields: dict[str, object] = {
        "session": "s",
        "seq": 0,
        "sender_t_s": t_s,
        "received_s": t_s,
        "point": HandPoint(x_m, 0.0, z_m),
        "clutch": True,
        "valid": True,
        "new_pose": True,
    }
    return HandSample(**(fields | changes))  # type: ignore[arg-type]


def engaged(config: HandConfig | None = None) -> HandControl:
    hand = HandControl(config or HandConfig(), 3000.0)
    hand.on_sample(sample(0.0, clutch=False))
    hand.on_sample(sample(1 / 60))
    assert hand.take_closing()
    hand.engage(BASE, 1 / 60)
    return hand


def settled_x_um(hand: HandControl, after_s: float) -> float:
    reference = hand.reference(after_s)
    assert reference is not None
    return reference.position.x_um


def test_slow_motion_arrives_scaled_by_the_gain() -> None:
    hand = engaged()
    for k in range(2, 122):
        hand.on_sample(sample(k / 60, x_m=0.0005 * (k - 1)))
        hand.reference(k / 60)
    for k in range(122, 200):
        hand.on_sample(sample(k / 60, x_m=0.06))
        hand.reference(k / 60)
    assert settled_x_um(hand, 200 / 60) == pytest.approx(BASE.x_um + 0.04 * 60_000, abs=1.0)


def test_towards_the_body_is_stage_y_and_up_keeps_the_height() -> None:
    hand = engaged()
    for k in range(2, 40):
        point = HandPoint(0.0, 0.001 * k, 0.0005 * min(k - 1, 20))
        hand.on_sample(sample(k / 60, point=point))
        reference = hand.reference(k / 60)
    assert reference is not None
    assert reference.position.y_um == pytest.approx(BASE.y_um + 0.04 * 10_000, abs=20.0)
    assert reference.position.z_um == BASE.z_um


def test_the_bound_is_a_speed_and_repeats_do_not_halve_it() -> None:
    """30 different poses in 60 messages, at 2.4 mm/s: all of the motion arrives."""
    hand = engaged()
    for k in range(2, 122):
        pose = k // 2
        hand.on_sample(sample(k / 60, x_m=0.06 * pose / 30, new_pose=k % 2 == 0))
        hand.reference(k / 60)
    for k in range(122, 180):
        hand.on_sample(sample(k / 60, x_m=0.06 * 60 / 30, new_pose=False))
        hand.reference(k / 60)
    moved_um = settled_x_um(hand, 3.0) - BASE.x_um
    assert moved_um == pytest.approx(0.04 * 0.06e6 * (60 - 0) / 30, rel=0.06)


@settings(max_examples=50)
@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=40))
def test_no_jump_of_the_hand_moves_faster_than_the_bound(xs_m: list[float]) -> None:
    hand = engaged()
    before = BASE.x_um
    for k, x_m in enumerate(xs_m, start=2):
        hand.on_sample(sample(k / 60, x_m=x_m))
        reference = hand.reference(k / 60)
        if reference is None:
            assert hand.take_jumping()
            break
        x_um = reference.position.x_um
        assert abs(x_um - before) <= 3000.0 / 60 * 1.5
        before = x_um


@settings(max_examples=50)
@given(st.lists(st.tuples(st.floats(-0.02, 0.02), st.booleans()), min_size=2, max_size=30))
def test_opening_the_clutch_and_closing_it_again_starts_from_zero(moves: list[tuple[float, bool]]) -> None:
    hand = engaged()
    for k, (x_m, clutch) in enumerate(moves, start=2):
        hand.on_sample(sample(k / 60, x_m=x_m, clutch=clutch))
    now_s = (len(moves) + 2) / 60
    hand.on_sample(sample(now_s, x_m=0.7, clutch=False))
    hand.on_sample(sample(now_s + 1 / 60, x_m=0.7))
    hand.engage(BASE, now_s + 1 / 60)
    hand.on_sample(sample(now_s + 2 / 60, x_m=0.7))
    assert settled_x_um(hand, now_s + 2 / 60) == BASE.x_um


def test_an_open_clutch_moves_nothing() -> None:
    hand = engaged()
    hand.on_sample(sample(0.05, x_m=0.01, clutch=False))
    assert hand.reference(0.06) is None


def test_silence_freezes_the_reference_then_the_hand_is_lost() -> None:
    hand = engaged()
    for k in range(2, 30):
        hand.on_sample(sample(k / 60, x_m=0.001 * k))
        hand.reference(k / 60)
    last_s = 29 / 60
    at_um = settled_x_um(hand, last_s + 0.041)
    assert settled_x_um(hand, last_s + 0.5) == pytest.approx(at_um, abs=30.0)
    assert hand.fresh(last_s + 0.099)
    assert not hand.fresh(last_s + 0.101)


def test_a_hand_out_of_view_opens_the_clutch() -> None:
    hand = engaged()
    hand.on_sample(sample(0.05, valid=False))
    assert hand.reference(0.05) is None
    assert not hand.clutch


def test_a_clutch_that_stays_closed_does_not_close_twice() -> None:
    hand = engaged()
    hand.on_sample(sample(0.05))
    assert not hand.take_closing()


def test_a_hand_that_comes_into_view_closed_has_not_closed_its_clutch_anew() -> None:
    for blind in (lambda hand: hand.on_sample(sample(0.05, valid=False)), HandControl.lose):
        hand = engaged()
        blind(hand)
        hand.on_sample(sample(0.06))
        assert hand.clutch
        assert not hand.take_closing()
        hand.on_sample(sample(0.08, clutch=False))
        hand.on_sample(sample(0.1))
        assert hand.take_closing()


def test_a_hand_that_comes_into_view_closed_may_count_as_a_takeover() -> None:
    hand = HandControl(HandConfig(), 3000.0)
    hand.on_sample(sample(0.0))
    assert hand.take_closing(anew=False)
    hand.on_sample(sample(0.02))
    assert not hand.take_closing(anew=False)


@pytest.mark.parametrize("bad", [{"hold_s": 0.5}, {"gain": 0.0}, {"gain": math.inf}])
def test_settings_have_ceilings_in_code(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(bad))):
        HandConfig(**bad)
