"""Autonomy that begins with the magnet far from the robot, as after a calibration."""

from dataclasses import replace

import pytest

from mrnav_server.core.modes import Ask, Mode
from mrnav_server.loops.descent import Descent, HeightConfig
from tests.loops.conftest import LockStep


@pytest.mark.parametrize(("aside_um", "above_um"), [(2800.0, 0.0), (0.0, 5000.0), (2800.0, 5000.0)])
def test_the_magnet_comes_to_the_robot_before_anybody_loses_patience(
    rig: LockStep, aside_um: float, above_um: float
) -> None:
    tip = rig.world.tip
    far = replace(tip, x_um=tip.x_um + aside_um, z_um=min(tip.z_um + above_um, 19_900.0))
    rig.world.place_tip(far)
    rig.advance(1.0)
    rig.mark()
    rig.ask(Ask.ARM)
    rig.start_auto()
    rig.advance_until(Mode.MANUAL, 20.0)
    assert rig.control.scene.distance_um is not None
    assert rig.control.scene.distance_um < 500.0
    height = rig.calibration.height_um(rig.world.tip) / rig.calibration.critical_height_um
    assert height == pytest.approx(1.04, abs=0.005)


def test_a_robot_that_does_not_follow_is_given_up_once_the_magnet_is_there(rig: LockStep) -> None:
    rig.world.place_tip(replace(rig.world.tip, x_um=rig.world.tip.x_um + 2800.0))
    rig.advance(1.0)
    rig.mark()
    rig.ask(Ask.ARM)
    rig.start_auto()
    start = rig.world.robot
    for _ in range(1000):
        rig.world.place_robot(start)
        rig.tick()
        if rig.is_in(Mode.HOLD):
            break
    assert "no progress" in rig.control.machine.reason or "not moved" in rig.control.machine.reason


def test_a_magnet_that_hangs_high_comes_over_the_robot_first(rig: LockStep) -> None:
    calibration, robot = rig.calibration, rig.world.robot
    descent = Descent(HeightConfig(), calibration)
    over = rig.world.tip
    high = replace(over, z_um=over.z_um + 2000.0)
    aside = replace(high, x_um=high.x_um + 1000.0)
    assert descent.reference(robot, over, over) is None
    first = descent.reference(robot, aside, aside)
    assert first is not None
    assert first.position.z_um == aside.z_um
    assert first.position.x_um == pytest.approx(over.x_um, abs=150.0)
    second = descent.reference(robot, high, high)
    assert second is not None
    assert second.position.z_um == pytest.approx(over.z_um, abs=1.0)
    # A robot that is out of sight is not sought: the magnet rests.
    lost = descent.reference(None, high, high)
    assert lost is not None
    assert lost.position == high
    # It goes all the way, not only to where it would not have begun.
    assert descent.reference(robot, replace(over, z_um=over.z_um + 100.0), over) is not None
    assert descent.reference(robot, over, over) is None


@pytest.mark.parametrize("field", ["working", "highest", "speed_um_per_s"])
def test_heights_that_do_not_work_are_refused(field: str) -> None:
    with pytest.raises(ValueError, match=field):
        HeightConfig(**{field: 1.0})
