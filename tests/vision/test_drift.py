"""Motion of the vessel or the camera: told when it is one, and not for a needle, a robot or the light."""

from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.errors import ConfigError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.vision.drift import Drift, DriftConfig, DriftWatch
from tests.vision.registration_scenes import Scene, shipped

CONFIG = DriftConfig()


@cache
def scene(shift_um: tuple[float, float] = (0.0, 0.0), turn_deg: float = 0.0) -> Scene:
    return Scene.of(shipped("bifurcation"), shift_um, turn_deg)


@pytest.fixture
def watch() -> DriftWatch:
    """A watch that knows the vessel, which lies where the calibration has it."""
    here = scene()
    watch = DriftWatch(CONFIG, here.told, here.vessel)
    for _ in range(3):
        watch.look(here.picture())
    return watch


def looks(watch: DriftWatch, there: Scene, count: int) -> Drift:
    for _ in range(count):
        drift = watch.look(there.picture())
    return drift


@pytest.mark.parametrize(
    ("shift_um", "turn_deg", "moved_um", "holds"),
    [
        ((100.0, -98.0), 0.0, 140.0, True),
        ((0.0, 75.0), 0.0, 75.0, False),
        ((0.0, 0.0), 1.0, 182.0, True),
    ],
)
def test_a_motion_is_told_in_um_after_three_looks(
    watch: DriftWatch, shift_um: tuple[float, float], turn_deg: float, moved_um: float, *, holds: bool
) -> None:
    there = scene(shift_um, turn_deg)
    assert looks(watch, there, 2).warning == ""
    drift = looks(watch, there, 1)
    assert drift.moved_um == pytest.approx(moved_um, abs=10.0)
    assert drift.warning.startswith("the vessel or the camera has moved by")
    assert drift.holds is holds


def test_a_vessel_that_is_put_back_is_well_again(watch: DriftWatch) -> None:
    assert looks(watch, scene((100.0, -98.0)), 3).holds
    assert looks(watch, scene(), 3).warning == ""


def test_a_small_motion_is_measured_but_not_told(watch: DriftWatch) -> None:
    drift = looks(watch, scene((20.0, 10.0)), 5)
    assert drift.moved_um == pytest.approx(22.4, abs=5.0)
    assert drift.warning == ""


def test_walls_that_are_gone_hold_autonomy(watch: DriftWatch) -> None:
    assert not looks(watch, scene((0.0, 1500.0)), 4).holds
    drift = looks(watch, scene((0.0, 1500.0)), 1)
    assert drift.holds
    assert drift.moved_um is None
    assert "not where they were" in drift.warning


def test_walls_that_come_back_are_well_again(watch: DriftWatch) -> None:
    assert looks(watch, scene((0.0, 1500.0)), 5).holds
    assert looks(watch, scene(), 3).warning == ""
    assert looks(watch, scene((0.0, 1500.0)), 4).warning == ""


def test_walls_that_were_covered_at_first_are_learnt_later() -> None:
    here = scene()
    left = here.picture()
    left[:, 950:] = 20
    watch = DriftWatch(CONFIG, here.told, here.vessel)
    known = []
    for picture in (left, here.picture(), here.picture()):
        assert watch.look(picture).warning == ""
        known.append(int(watch._has.sum()))
    assert known[1] > 1.15 * known[0] > 0
    assert looks(watch, scene((100.0, -98.0)), 3).holds


def passing() -> Iterator[ByteArray]:
    """Needle and robot all over the vessel, under a light that goes up and down."""
    here, rng = scene(), np.random.default_rng(3)
    y, x = np.nonzero(here.vessel.free)
    for k in rng.integers(len(x), size=40):
        picture = here.over(VesselPoint(float(x[k]), float(y[k])))
        yield np.clip(picture * rng.uniform(0.6, 1.25), 0.0, 255.0).astype(np.uint8)


def test_needle_robot_and_light_are_no_motion() -> None:
    here = scene()
    watch = DriftWatch(CONFIG, here.told, here.vessel)
    seen = [watch.look(picture) for picture in passing()]
    assert all(drift.warning == "" for drift in seen)
    assert all(drift.moved_um is None or drift.moved_um < 10.0 for drift in seen)
    assert seen[-1].moved_um is not None


def test_a_motion_behind_needle_robot_and_light_is_told_all_the_same() -> None:
    here, there = scene(), scene((100.0, -98.0))
    watch = DriftWatch(CONFIG, here.told, here.vessel)
    for picture in passing():
        watch.look(picture)
    rng = np.random.default_rng(4)
    y, x = np.nonzero(here.vessel.free)
    for k in rng.integers(len(x), size=4):
        drift = watch.look(there.over(VesselPoint(float(x[k]), float(y[k]))))
    assert drift.moved_um == pytest.approx(140.0, abs=10.0)


def test_one_picture_alone_says_nothing(watch: DriftWatch) -> None:
    watch.look(scene((100.0, -98.0)).picture())
    assert looks(watch, scene(), 2).warning == ""
    assert looks(watch, scene(), 5).warning == ""


def test_a_vessel_that_never_was_where_it_should_be_is_told_but_holds_nothing() -> None:
    there = scene((0.0, 1500.0))
    watch = DriftWatch(CONFIG, there.told, there.vessel)
    assert looks(watch, there, 4).warning == ""
    drift = looks(watch, there, 1)
    assert "register the vessel" in drift.warning
    assert not drift.holds


def test_thresholds_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"drift\.warn_um"):
        DriftConfig(warn_um=200.0, hold_um=100.0)
    with pytest.raises(ConfigError, match=r"drift\.look_s"):
        DriftConfig(look_s=0.0)
