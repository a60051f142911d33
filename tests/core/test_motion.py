import numpy as np
import pytest

from mrnav_server.core.motion import segments
from tests.core.trajectories import circle, line, times


def test_stamps_that_repeat_or_fall_and_unseen_robots_are_dropped() -> None:
    t_s = times(20)
    xy_um = circle(1000.0, 1000.0)(t_s)
    messy_s = np.concatenate([t_s, t_s[100:110]])
    messy_um = np.concatenate([xy_um, np.full((10, 2), 1e6)])
    order = np.argsort(messy_s, kind="stable")
    messy_s, messy_um = messy_s[order], messy_um[order]
    messy_um[50] = np.nan
    messy_s = np.append(messy_s, 3.0)
    messy_um = np.append(messy_um, [[-1e6, 0.0]], axis=0)
    (segment,) = segments(messy_s, messy_um)
    assert np.hypot(*segment.xy_um.T) == pytest.approx(1000.0, abs=0.1)


def test_a_gap_of_more_than_a_fifth_of_a_second_splits() -> None:
    t_s = times(10)
    xy_um = line(1000.0)(t_s)
    assert len(segments(t_s, xy_um)) == 1
    for lost, pieces in ((5, 1), (6, 2)):
        kept = (t_s < 4.99) | (t_s > 4.99 + lost / 30)
        assert len(segments(t_s[kept], xy_um[kept])) == pieces
    assert segments(np.array([np.nan]), np.array([[0.0, 0.0]])) == []
