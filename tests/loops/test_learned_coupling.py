"""What the observer learns is kept from task to task, and makes the next one better."""

import math

import pytest

from mrnav_server.core.modes import Ask, Mode
from tests.loops.conftest import LockStep


def learned(rig: LockStep) -> tuple[float, float, float, int]:
    fields = rig.autopilot.learned
    offset_um, lead_um, looks = fields["offset_um"], fields["friction_lead_um"], fields["looks"]
    assert isinstance(offset_um, list)
    assert isinstance(lead_um, float)
    assert isinstance(looks, int)
    return offset_um[0], offset_um[1], lead_um, looks


def test_it_is_kept_from_task_to_task(rig: LockStep) -> None:
    assert learned(rig) == (0.0, 0.0, 400.0, 0)
    rig.mark(0)
    rig.ask(Ask.ARM)
    rig.start_auto()
    rig.advance_until(Mode.MANUAL, 20.0)
    rig.advance(0.5)
    first = learned(rig)
    assert first[3] > 30
    rig.mark(1)
    rig.start_auto()
    assert learned(rig) == first, "a task begins with what the one before has learnt"
    rig.advance_until(Mode.MANUAL, 20.0)
    assert learned(rig)[3] > first[3]
    # What the magnet's calibrated offset is wrong by, as the world knows it, in the vessel's axes. A single
    # way that hardly bends does not tell it from the lead; two do.
    told, true = rig.calibration.magnet_offset_um, rig.world.true_calibration.magnet_offset_um
    error_um = (true[0] - told[0], true[1] - told[1])
    assert math.hypot(*error_um) == pytest.approx(100.0)
    assert math.dist(learned(rig)[:2], error_um) < 60.0
