from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrnav_server.core.frames import HandPoint
from mrnav_server.core.hand_stream import HandSample, HandStream
from mrnav_server.core.peer_limits import Strikes, TokenBucket
from mrnav_server.core.wire_hand import HandMessage, Increment


def hand(
    seq: int, t_s: float, x_m: float = 0.0, pose: int | None = None, *, valid: bool = True
) -> HandMessage:
    return HandMessage(seq, t_s, HandPoint(x_m, 0.0, 0.0), clutch=True, valid=valid, pose=pose)


def step(seq: int, t_s: float, dx_m: float, *, valid: bool = True) -> Increment:
    return Increment(seq, t_s, HandPoint(dx_m, 0.0, 0.0), clutch=True, valid=valid)


def accepted(stream: HandStream, message: HandMessage | Increment, received_s: float) -> HandSample:
    sample = stream.take(message, received_s)
    assert sample is not None
    return sample


def test_a_sample_carries_what_was_sent_and_when_it_came() -> None:
    stream = HandStream("s1", Counter())
    sample = accepted(stream, hand(3, 100.0, 0.25, pose=9), 5.0)
    assert sample == HandSample(
        "s1", 3, 100.0, 5.0, HandPoint(0.25, 0.0, 0.0), clutch=True, valid=True, new_pose=True
    )


def test_only_a_rising_seq_counts() -> None:
    counters: Counter[str] = Counter()
    stream = HandStream("s1", counters)
    taken = [stream.take(hand(seq, 0.01 * seq, seq), 0.01 * i) for i, seq in enumerate([1, 2, 2, 1, 4, 3, 5])]
    assert [sample.seq for sample in taken if sample] == [1, 2, 4, 5]
    assert counters["hand_out_of_order"] == 3


@settings(max_examples=500, deadline=None)
@given(
    st.lists(st.floats(-0.01, 0.01), min_size=1, max_size=40),
    st.randoms(use_true_random=False),
    st.data(),
)
def test_loss_duplication_and_reordering_do_not_drift(
    moves_m: list[float], chance: object, data: st.DataObject
) -> None:
    poses_m = [0.0]
    for move_m in moves_m:
        poses_m.append(poses_m[-1] + move_m)
    sent = [hand(seq, seq / 60, x_m) for seq, x_m in enumerate(poses_m)]
    disturbed = data.draw(st.lists(st.sampled_from(sent), max_size=80))
    stream = HandStream("s1", Counter())
    # What arrives is any shuffled, thinned and repeated choice; the newest message arrives last.
    now_s, position_m = 0.0, None
    for message in [*disturbed, hand(len(sent), len(sent) / 60, poses_m[-1])]:
        now_s = max(now_s, message.t_s)
        sample = stream.take(message, now_s)
        if sample is not None:
            position_m = sample.point.x_m
    assert position_m == poses_m[-1]


def test_a_stalled_burst_is_dropped_but_its_fresh_end() -> None:
    counters: Counter[str] = Counter()
    stream = HandStream("s1", counters)
    for seq in range(60):
        assert stream.take(hand(seq, 50 + seq / 60, 0.001 * seq), seq / 60 + 0.002)
    # One second of messages arrives at once, 1 s after the last.
    burst = [stream.take(hand(seq, 50 + seq / 60), 2.0) for seq in range(60, 120)]
    fresh = [sample.seq for sample in burst if sample]
    assert fresh == [seq for seq in range(60, 120) if 2.0 - 0.002 - seq / 60 <= 0.1]
    assert counters["hand_stale"] == 60 - len(fresh)


def test_increments_of_a_stale_burst_move_nothing() -> None:
    stream = HandStream("s1", Counter())
    before = accepted(stream, step(0, 0.0, 0.01), 10.0).point
    for seq in range(1, 57):
        assert stream.take(step(seq, seq / 60, 0.005), 11.2) is None
    after = accepted(stream, step(57, 1.2, 0.0), 11.2).point
    assert after == before


def test_increments_and_positions_give_the_same_pose() -> None:
    positions, steps = HandStream("a", Counter()), HandStream("b", Counter())
    x_m = 0.0
    for seq in range(100):
        x_m += 0.001 * (seq % 7 - 3)
        from_position = accepted(positions, hand(seq, seq / 60, x_m), seq / 60)
        from_step = accepted(steps, step(seq, seq / 60, 0.001 * (seq % 7 - 3)), seq / 60)
        assert from_step.point.x_m == pytest.approx(from_position.point.x_m, abs=1e-12)


def test_an_increment_without_a_seen_hand_moves_nothing() -> None:
    stream = HandStream("s1", Counter())
    accepted(stream, step(0, 0.0, 0.01), 0.0)
    sample = accepted(stream, step(1, 0.01, 5.0, valid=False), 0.01)
    assert (sample.point.x_m, sample.valid, sample.new_pose) == (0.01, False, False)


def test_a_repeated_pose_number_is_not_a_new_pose() -> None:
    stream = HandStream("s1", Counter())
    poses = [accepted(stream, hand(i, i / 60, i // 2 * 0.01, pose=i // 2), i / 60).new_pose for i in range(6)]
    assert poses == [True, False, True, False, True, False]


def test_without_numbers_a_repeat_shows_as_the_same_time_or_place() -> None:
    stream = HandStream("s1", Counter())
    assert accepted(stream, hand(0, 0.0, 0.1), 0.0).new_pose
    assert not accepted(stream, hand(1, 0.016, 0.1), 0.016).new_pose
    assert accepted(stream, hand(2, 0.033, 0.2), 0.033).new_pose
    assert not accepted(stream, hand(3, 0.033, 0.3), 0.034).new_pose


def test_clocks_that_drift_apart_do_not_make_a_session_stale() -> None:
    stream = HandStream("s1", Counter())
    # Two hours at 100 ppm: the clocks end 0.72 s apart.
    for seq in range(72_000):
        now_s = seq * 0.1
        assert stream.take(hand(seq, now_s * (1 - 100e-6)), now_s)


@pytest.mark.parametrize("offset_s", [-1e6, 0.0, 1e6])
def test_the_clocks_need_no_common_zero(offset_s: float) -> None:
    stream = HandStream("s1", Counter())
    assert stream.take(hand(0, offset_s), 5.0)
    assert stream.take(hand(1, offset_s + 0.05), 5.149)
    assert stream.take(hand(2, offset_s + 0.10), 5.201) is None


def test_a_bucket_passes_the_rate_and_forgives_a_burst() -> None:
    bucket = TokenBucket(rate_per_s=120.0, burst=120.0)
    assert sum(bucket.take(0.0) for _ in range(1000)) == 120
    assert sum(bucket.take(1.0 + i / 1000) for i in range(10_000)) == pytest.approx(120 + 1200, abs=2)


def test_three_strikes_within_a_second_are_too_many() -> None:
    strikes = Strikes(limit=3, within_s=1.0)
    assert [strikes.strike(t_s) for t_s in (0.0, 0.6, 1.2, 1.5, 1.6)] == [False, False, False, True, False]
