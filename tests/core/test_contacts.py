import math
from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mrnav_server.core.contacts import ContactCounter, contact_starts


def count(steps: list[tuple[float, float | None]]) -> int:
    counter = ContactCounter()
    began = sum(counter.step(clearance_um, t_s) for t_s, clearance_um in steps)
    assert began == counter.count
    return counter.count


def test_a_contact_begins_at_zero_clearance() -> None:
    assert count([(0.0, 0.1)]) == 0
    assert count([(0.0, 0.0)]) == 1
    assert count([(0.0, -30.0)]) == 1


def test_sliding_along_a_wall_is_one_contact() -> None:
    assert count([(0.03 * i, 15.0 * (i % 2) - 1.0) for i in range(100)]) == 1


def test_a_contact_rearms_after_more_than_20_um_for_a_fifth_of_a_second() -> None:
    touch, clear = (0.0, -1.0), [(0.1, 20.5), (0.2, 20.5), (0.31, 20.5)]
    assert count([touch, *clear, (0.32, -1.0)]) == 2
    assert count([touch, *clear[:2], (0.29, -1.0)]) == 1
    assert count([touch, (0.1, 20.0), (0.5, 20.0), (0.6, -1.0)]) == 1
    assert count([touch, (0.1, 30.0), (0.25, 10.0), (0.3, 30.0), (0.45, 30.0), (0.46, -1.0)]) == 1


def test_a_robot_that_is_not_seen_neither_touches_nor_rearms() -> None:
    assert count([(0.0, None), (0.1, math.nan)]) == 0
    assert count([(0.0, -1.0), (0.1, 50.0), (0.2, None), (0.35, 50.0), (0.4, -1.0)]) == 1
    assert count([(0.0, -1.0), (0.1, 50.0), (0.2, math.nan), (0.3, 50.0), (0.51, 50.0), (0.6, -1.0)]) == 2


@given(st.lists(st.one_of(st.none(), st.floats(-100, 100)), max_size=60))
def test_contacts_lie_at_least_the_rearm_time_apart(clearances_um: list[float | None]) -> None:
    counter = ContactCounter()
    begins_s = [0.05 * i for i, gap_um in enumerate(clearances_um) if counter.step(gap_um, 0.05 * i)]
    assert all(later - earlier >= 0.2 for earlier, later in pairwise(begins_s))
    assert bool(begins_s) == any(gap_um is not None and gap_um <= 0 for gap_um in clearances_um)


def test_contact_starts_are_where_a_contact_begins() -> None:
    t_s = 0.11 * np.arange(7, dtype=np.float64)
    clearance_um = np.array([50.0, -1.0, np.nan, 30.0, 30.0, 30.0, -1.0])
    assert contact_starts(t_s, clearance_um) == [1, 6]
