"""A vessel that has moved holds AUTO; another calibration is taken while disarmed, and only then."""

from dataclasses import replace

import pytest

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.modes import Ask, Mode, Severity
from tests.loops.conftest import LockStep

MOVED = "the vessel or the camera has moved by 140 µm"


def test_a_vessel_that_moved_too_far_ends_auto_in_hold_and_keeps_it_from_beginning(driving: LockStep) -> None:
    driving.control.surroundings.drift_warning = driving.control.surroundings.drift_fault = lambda: MOVED
    driving.tick()
    assert driving.is_in(Mode.HOLD)
    assert driving.control.machine.reason.startswith(MOVED)
    with pytest.raises(RefusedError, match="140 µm"):
        driving.start_auto()


def test_a_small_motion_warns_and_auto_goes_on(driving: LockStep) -> None:
    driving.control.surroundings.drift_warning = lambda: MOVED
    driving.advance(0.2)
    assert driving.is_in(Mode.AUTO)
    assert driving.control.facts.warning == MOVED
    assert driving.control.machine.severity(driving.control.facts) is Severity.WARN


def test_another_calibration_is_taken_while_disarmed_alone(driving: LockStep) -> None:
    offset_um = driving.calibration.magnet_offset_um
    other = replace(driving.calibration, magnet_offset_um=(offset_um[0] + 500.0, offset_um[1]))
    with pytest.raises(RefusedError, match="disarm"):
        driving.control.recalibrate(other)
    driving.ask(Ask.DISARM)
    driving.advance_until(Mode.DISARMED, 2.0)
    before_um = driving.control.scene.lead_um
    driving.control.recalibrate(other)
    assert driving.control.scene.robot is None
    driving.advance(0.2)
    assert driving.control.scene.lead_um != pytest.approx(before_um, abs=100.0)
