"""Limits, lease and critical areas."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mrnav_server.core.areas import CriticalAreas
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import Affine2, Calibration, StagePoint, VesselPoint
from mrnav_server.core.lease import Lease
from mrnav_server.core.limits import Limits, allowed_target, outside_um
from mrnav_server.core.vessel import VesselMap
from mrnav_server.vision.vessel_model import vessel_map

CALIBRATION = Calibration(
    image_from_vessel=Affine2.scale(2 / 3, 200.0),
    stage_from_vessel=Affine2.scale(10.0, 1000.0, 1000.0),
    um_per_px=10.0,
    floor_z_um=2000.0,
    magnet_offset_um=(1500.0, -300.0),
    critical_height_um=10_700.0,
)
LIMITS = Limits()


@pytest.fixture(scope="module")
def channel() -> VesselMap:
    mask = np.zeros((1800, 1800), np.uint8)
    cv2.rectangle(mask, (200, 800), (1600, 1000), 255, -1)
    return vessel_map("channel", mask)


@pytest.fixture(scope="module")
def branches() -> VesselMap:
    """Two parallel channels, too far apart for the magnet to cross."""
    mask = np.zeros((1800, 1800), np.uint8)
    cv2.rectangle(mask, (300, 500), (1500, 640), 255, -1)
    cv2.rectangle(mask, (300, 1101), (1500, 1240), 255, -1)
    cv2.rectangle(mask, (300, 500), (420, 1240), 255, -1)
    return vessel_map("branches", mask)


anything = st.floats(allow_nan=True, allow_infinity=True)


@given(anything, anything, anything)
def test_no_target_leaves_the_workspace_or_enters_the_critical_distance(
    channel: VesselMap, x: float, y: float, z: float
) -> None:
    if not all(map(math.isfinite, (x, y, z))):
        with pytest.raises(RefusedError, match="NaN or infinity"):
            allowed_target(StagePoint(x, y, z), LIMITS, CALIBRATION, channel)
        return
    target = allowed_target(StagePoint(x, y, z), LIMITS, CALIBRATION, channel)
    for value in (target.x_um, target.y_um, target.z_um):
        assert 0.0 <= value <= 20_000.0
    assert CALIBRATION.height_um(target) >= 10_700.0 + LIMITS.height_margin_um


def test_an_allowed_target_is_left_alone(channel: VesselMap) -> None:
    wish = StagePoint(10_000.0, 9700.0, 13_200.0)
    assert allowed_target(wish, LIMITS, CALIBRATION, channel) == wish


def test_the_hold_point_stays_near_the_vessel(channel: VesselMap) -> None:
    target = allowed_target(StagePoint(10_000.0, 1000.0, 13_200.0), LIMITS, CALIBRATION, channel)
    held = CALIBRATION.held_point(target)
    assert -channel.wall_distance_px(held.x_px, held.y_px) * 10.0 == pytest.approx(1600.0, abs=30.0)


within_travel = st.floats(0.0, 20_000.0)


@settings(max_examples=300)
@given(within_travel, within_travel)
@example(12_500.0, 9_405.0)
@example(0.0, 0.0)
@example(20_000.0, 20_000.0)
def test_the_hold_point_stays_near_from_everywhere(branches: VesselMap, x_um: float, y_um: float) -> None:
    """Also from beyond the grid and from midway between two branches, where distance has no gradient."""
    target = allowed_target(StagePoint(x_um, y_um, 13_200.0), LIMITS, CALIBRATION, branches)
    held = CALIBRATION.held_point(target)
    edge_x_px, edge_y_px = min(max(held.x_px, 0.0), 1799.0), min(max(held.y_px, 0.0), 1799.0)
    beyond_px = math.hypot(held.x_px - edge_x_px, held.y_px - edge_y_px)
    away_um = 10.0 * (beyond_px - branches.wall_distance_px(edge_x_px, edge_y_px))
    assert away_um <= LIMITS.lead_um + 1.0
    assert outside_um(target, LIMITS, CALIBRATION, branches) < 1.0


def test_how_far_outside_a_point_is(channel: VesselMap) -> None:
    inside = StagePoint(10_000.0, 9700.0, 13_200.0)
    assert outside_um(inside, LIMITS, CALIBRATION, channel) == 0.0
    low = StagePoint(10_000.0, 9700.0, 12_750.0)
    assert outside_um(low, LIMITS, CALIBRATION, channel) == pytest.approx(100.0)


def test_areas_say_how_far_the_wall_is(channel: VesselMap) -> None:
    areas = CriticalAreas(channel)
    with pytest.raises(RefusedError, match=r"inside the wall") as refused:
        areas.add(VesselPoint(900, 700), 500, "")
    assert "1000 µm" in str(refused.value)
    with pytest.raises(RefusedError, match=r"move the center 2[0-9]{2} µm further in"):
        areas.add(VesselPoint(900, 825), 500, "")
    with pytest.raises(RefusedError, match="epsilon_um"):
        areas.add(VesselPoint(900, 900), 5, "")
    with pytest.raises(RefusedError, match="outside the vessel model"):
        areas.add(VesselPoint(1e6, 900), 500, "")
    area = areas.add(VesselPoint(900, 900), 500, "clot")
    assert areas.list() == [area]
    assert areas.replace(area.id, VesselPoint(950, 900), 400, "clot").center.x_px == 950
    areas.remove(area.id)
    with pytest.raises(RefusedError, match="no critical area"):
        areas.get(area.id)


def test_one_hand_and_one_console() -> None:
    lease = Lease()
    lease.take_console("page", "Dashboard", 0.0)
    lease.take_hand("hand", "HoloLens", 0.0)
    epoch = lease.epoch
    with pytest.raises(RefusedError, match="HoloLens has control"):
        lease.take_hand("second", "Other", 1.0)
    with pytest.raises(RefusedError, match="Dashboard has control"):
        lease.take_console("page2", "Other", 1.0)
    lease.take_hand("hand", "HoloLens", 1.0)
    assert lease.epoch == epoch
    assert lease.is_hand("hand")
    assert not lease.is_hand("page")
    assert lease.state().client == "HoloLens and Dashboard"


def test_silent_seats_expire_and_change_the_epoch() -> None:
    lease = Lease(ttl_s=2.0)
    lease.take_console("page", "Dashboard", 0.0)
    lease.take_hand("hand", "HoloLens", 0.0)
    lease.hear("hand", 1.5)
    epoch = lease.epoch
    assert lease.expire(2.5) == ["page"]
    assert lease.epoch > epoch
    assert lease.holds("hand")
    assert lease.expire(3.6) == ["hand"]
    assert not lease.held
