"""Hand control from the headset's messages to the setpoint: tremor, delay, slow hands, wrong hands."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.hand import delays_ms, ride, tremor_db
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import HandPoint, StagePoint
from mrnav_server.core.hand import JUMPED, JUMPS, OUT_OF_VIEW, HandConfig, HandControl
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.limits import Limits
from mrnav_server.core.shaping import Shaper

BASE = StagePoint(10_000, 10_000, 12_000)
LIMITS = Limits()


def sample(
    t_s: float, x_m: float = 0.0, *, sender_s: float | None = None, clutch: bool = True, valid: bool = True
) -> HandSample:
    sent_s = t_s if sender_s is None else sender_s
    return HandSample("s", 0, sent_s, t_s, HandPoint(x_m, 0.0, 0.0), clutch, valid, new_pose=True)


def engaged(config: HandConfig | None = None) -> HandControl:
    hand = HandControl(config or HandConfig(), LIMITS.speed_um_per_s)
    hand.on_sample(sample(0.0, clutch=False))
    hand.on_sample(sample(1 / 30))
    hand.engage(BASE, 1 / 30)
    return hand


def moved_um(hand: HandControl, now_s: float) -> float:
    reference = hand.reference(now_s)
    assert reference is not None
    return reference.position.x_um - BASE.x_um


@pytest.mark.parametrize("amplitude_m", [1e-4, 5e-4])
@pytest.mark.parametrize("frequency_hz", [8, 10, 12])
def test_tremor_is_ten_decibels_down_in_what_the_hand_asks_for(
    frequency_hz: float, amplitude_m: float
) -> None:
    assert tremor_db(frequency_hz, amplitude_m, HandConfig())[0] < -10.0


def test_the_tip_follows_within_fifty_milliseconds() -> None:
    filtered_ms, total_ms, _ = delays_ms(60_000.0, HandConfig(dead_band_um=0.0))
    assert filtered_ms < 42.0
    assert total_ms < 50.0


def test_its_velocity_is_the_slope_of_its_places() -> None:
    hand = engaged(HandConfig(dead_band_um=0.0))
    speeds = []
    for k in range(2, 240):
        if k % 2 == 0:
            hand.on_sample(sample(k / 60, 0.04 * k / 60))
        for part in range(7):
            reference = hand.reference((k + part / 7) / 60)
            assert reference is not None
            speeds.append(reference.velocity_um_per_s[0])
    assert np.mean(speeds[-1400:]) == pytest.approx(1600.0, rel=0.005)


def test_a_headsets_errors_do_not_set_the_setpoint_swinging() -> None:
    """Their jerk is beyond the limit: a setpoint that is drawn too firmly swings about the reference."""
    hand, shaper, rng = engaged(), Shaper(LIMITS), np.random.default_rng(3)
    shaper.reset(BASE)
    drift_m, away_um = 0.0, []
    for k in range(1, 1500):
        now_s = k / 100
        if k % 3 == 0:
            drift_m += 0.3e-3 * rng.normal()
            hand.on_sample(sample(now_s, 0.025 * now_s + drift_m + 0.5e-3 * rng.normal()))
        reference = hand.reference(max(now_s, 1 / 30))
        assert reference is not None
        away_um.append(shaper.step(0.01, reference).x_um - reference.position.x_um)
    assert np.std(away_um[100:]) < 40.0


@pytest.mark.parametrize("hand_um_per_s", [200.0, 1000.0, 70_000.0])
def test_nothing_is_lost_of_a_hand_below_the_bound_however_slow(hand_um_per_s: float) -> None:
    run = ride(lambda t_s: 1e-6 * hand_um_per_s * t_s, HandConfig(), 6.0)
    assert run.reference_um[-1] - run.reference_um[0] == pytest.approx(
        0.04 * hand_um_per_s * (run.t_s[-1] - run.t_s[0]), rel=0.01, abs=2.0
    )


def test_a_trembling_hand_within_its_play_moves_nothing() -> None:
    hand = engaged(HandConfig(dead_band_um=50.0))
    for k in range(2, 60):
        hand.on_sample(sample(k / 30, 45e-6 * (-1) ** k))
        assert moved_um(hand, k / 30) == 0.0


def test_the_scale_is_chosen_while_the_clutch_is_open() -> None:
    hand = engaged()
    with pytest.raises(RefusedError, match="open it"):
        hand.choose_scale("fine")
    assert hand.scale == "coarse"
    hand.on_sample(sample(0.1, clutch=False))
    hand.choose_scale("fine")
    assert (hand.scale, hand.gain) == ("fine", 0.01)
    with pytest.raises(RefusedError, match="coarse or fine"):
        hand.choose_scale("finest")
    hand.on_sample(sample(0.2))
    hand.engage(BASE, 0.2)
    for k in range(1, 60):
        hand.on_sample(sample(0.2 + k / 30, 0.001 * min(k, 40)))
        hand.reference(0.2 + k / 30)
    assert moved_um(hand, 2.2) == pytest.approx(0.01 * 40_000, abs=1.0)


def test_a_jump_is_left_out_and_three_let_go() -> None:
    hand = engaged()
    hand.on_sample(sample(2 / 30, 0.5))
    assert moved_um(hand, 0.1) == 0.0
    assert (hand.trouble(0.1), hand.take_jumping(), hand.engaged) == (JUMPED, False, True)
    for k in range(3, 30):
        hand.on_sample(sample(k / 30, 0.5 + 0.001 * (k - 2)))
    assert moved_um(hand, 1.0) == pytest.approx(0.04 * 27_000, rel=0.1)
    for k, x_m in ((36, -1.0), (37, 1.0), (38, 3.0)):
        hand.on_sample(sample(k / 30, x_m))
    assert (hand.trouble(1.3), hand.take_jumping(), hand.engaged) == (JUMPS, True, False)
    assert hand.counters["hand_jumps"] == 4
    assert hand.trouble(4.0) == ""


def test_a_hand_out_of_view_lets_go_and_says_so() -> None:
    hand = engaged()
    hand.on_sample(sample(0.1, valid=False))
    assert (hand.engaged, hand.clutch, hand.trouble(0.1)) == (False, False, OUT_OF_VIEW)


def test_a_sender_whose_clock_runs_fast_gains_no_speed() -> None:
    hand = engaged()
    for k in range(1, 600):
        # 0.1 s a message by its own clock, 10 ms by ours; 15 cm of hand each time.
        hand.on_sample(sample(1 / 30 + 0.01 * k, 0.15 * k, sender_s=0.1 * k))
        hand.reference(1 / 30 + 0.01 * k)
    assert moved_um(hand, 6.03) <= LIMITS.speed_um_per_s * (6.03 + 0.1)


wild = st.one_of(
    st.sampled_from([0.0, math.nan, math.inf, -math.inf, 1e308, -1e308, 100.0, -100.0]),
    st.floats(-0.05, 0.05),
)


@settings(max_examples=150, deadline=None)
@given(
    st.lists(
        st.tuples(
            wild,
            st.sampled_from([0.001, 0.008, 0.017, 0.033, 0.3]),
            st.sampled_from([-5.0, 0.0, 0.001, 0.033, 1e6]),
            st.booleans(),
            st.integers(0, 9),
        ),
        min_size=2,
        max_size=60,
    )
)
def test_no_hand_breaks_a_limit_or_moves_without_a_clutch(
    script: list[tuple[float, float, float, bool, int]],
) -> None:
    """Teleports, NaN, floods, frozen and backward clocks, huge numbers: through the shaper."""
    hand, shaper = engaged(), Shaper(LIMITS)
    shaper.reset(BASE)
    now_s, sender_s = 1 / 30, 1 / 30
    acceleration = np.zeros(3)
    for x_m, wait_s, sender_step_s, valid, chance in script:
        now_s, sender_s = now_s + wait_s, sender_s + sender_step_s
        clutch = chance > 0
        hand.on_sample(sample(now_s, x_m, sender_s=sender_s, clutch=clutch, valid=valid or chance > 2))
        if hand.take_closing() and chance > 5:
            hand.engage(shaper.rest_point, now_s)
        if not hand.clutch:
            assert hand.reference(now_s) is None
        for _ in range(5):
            reference = hand.reference(now_s)
            assert reference is None or reference.finite
            shaper.step(0.001, reference)
            turned = np.array(shaper.acceleration_um_per_s2)
            assert shaper.speed_um_per_s <= LIMITS.speed_um_per_s * (1 + 1e-6)
            assert np.linalg.norm(turned) <= LIMITS.acceleration_um_per_s2 * (1 + 1e-9)
            assert np.linalg.norm(turned - acceleration) <= 0.001 * LIMITS.jerk_um_per_s3 * (1 + 1e-6)
            acceleration = turned
