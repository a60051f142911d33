"""The simulated camera's faults, from the sensor to the mode: named, and AUTO holds. Simulated time."""

import cv2
import pytest

from mrnav_server.autonomy.path import PathPlanner
from mrnav_server.core.errors import DeviceError
from mrnav_server.core.modes import Ask, Mode
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import TrackState
from mrnav_server.core.vessel import VesselMap
from mrnav_server.sim.devices import SimulatedCamera
from mrnav_server.sim.microscope import Microscope, MicroscopeConfig
from mrnav_server.sim.world import SimConfig
from mrnav_server.vision.frame_watch import FrameWatch
from mrnav_server.vision.tracker import Tracker, TrackerConfig
from tests.loops.conftest import TICK_S, LockStep

HOLD_WITHIN_S = 0.1 + TICK_S


class FilmedRig(LockStep):
    """A rig whose tracks come from pictures: time passes while the camera waits."""

    def __init__(self, vessel: VesselMap, planner: PathPlanner, microscope: Microscope) -> None:
        super().__init__(vessel, planner)
        self.camera_alive = False
        self.clock_s = self.now_s
        self.held_s: float | None = None
        self.said: list[str] = []
        self.camera = SimulatedCamera(
            SimConfig(),
            PictureFormat(),
            self.world.snapshot,
            microscope.render,
            lambda: self.clock_s,
            self.wait,
        )
        self.tracker = Tracker(TrackerConfig(), self.calibration)
        self.watch = FrameWatch(PictureFormat().fps)
        self.camera.open()

    def wait(self, span_s: float) -> None:
        self.clock_s += span_s
        while self.now_s + TICK_S <= self.clock_s + 1e-9:
            self.tick()
            if self.held_s is None and self.is_in(Mode.HOLD):
                self.held_s = self.now_s

    def film(self, span_s: float) -> None:
        """Read, watch and track as the tracking loop does."""
        end_s = self.clock_s + span_s
        while self.clock_s < end_s:
            try:
                frame = self.camera.read(0.5)
                fault = self.watch.look(frame, self.clock_s)
                self.control.scene.see(self.tracker.update(frame))
            except DeviceError as error:
                fault = str(error)
                self.reopen()
            if fault not in self.said[-1:]:
                self.said.append(fault)

    def reopen(self) -> None:
        self.camera.close()
        self.wait(0.1)
        try:
            self.camera.open()
        except DeviceError:
            return

    def drive(self) -> None:
        """Start AUTO and go until the robot is under way."""
        self.film(0.5)
        self.mark()
        self.ask(Ask.ARM)
        self.start_auto()
        self.film(0.5)
        assert self.is_in(Mode.AUTO)
        self.held_s = None


@pytest.fixture(scope="module")
def microscope(bifurcation: VesselMap, planner: PathPlanner) -> Microscope:
    cv2.setNumThreads(1)
    rig = LockStep(bifurcation, planner)
    return Microscope(
        MicroscopeConfig(), PictureFormat(), SimConfig().magnets, bifurcation, rig.calibration, seed=5
    )


@pytest.fixture
def filmed(bifurcation: VesselMap, planner: PathPlanner, microscope: Microscope) -> FilmedRig:
    rig = FilmedRig(bifurcation, planner, microscope)
    rig.drive()
    return rig


def held_after_s(rig: FilmedRig, span_s: float = 0.3) -> float:
    """Return how long after now AUTO was held."""
    began_s = rig.clock_s
    rig.film(span_s)
    assert rig.held_s is not None, "AUTO was not held"
    return rig.held_s - began_s


def test_a_frozen_camera_holds_auto_and_is_named(filmed: FilmedRig) -> None:
    filmed.camera.freeze()
    # The first of the frozen pictures is a true one.
    assert held_after_s(filmed) <= HOLD_WITHIN_S + 1 / 30
    assert "frozen" in filmed.said[-1]


def test_a_black_camera_holds_auto_and_is_named(filmed: FilmedRig) -> None:
    filmed.camera.black_out()
    assert held_after_s(filmed) <= HOLD_WITHIN_S
    assert "black" in filmed.said[-1]


def test_an_unplugged_camera_holds_auto_and_is_named(filmed: FilmedRig) -> None:
    filmed.camera.unplug()
    assert held_after_s(filmed) <= HOLD_WITHIN_S
    assert "unplugged" in filmed.said[-1]


def test_a_camera_that_lags_holds_auto_and_is_named(filmed: FilmedRig) -> None:
    filmed.camera.slow_down(0.12)
    assert held_after_s(filmed, 1.2) <= HOLD_WITHIN_S + 1 / 30
    assert filmed.said[-1].startswith("the camera is late")


def test_a_camera_at_half_its_rate_is_named(filmed: FilmedRig) -> None:
    filmed.camera.slow_down(0.055)
    filmed.film(0.8)
    assert filmed.said[-1] == "the camera is slow: a frame every 60 ms instead of 33 ms"


@pytest.mark.parametrize("fault", ["freeze", "black_out", "unplug"])
def test_a_camera_that_works_again_is_tracked_again_without_a_restart(filmed: FilmedRig, fault: str) -> None:
    getattr(filmed.camera, fault)()
    filmed.film(0.3)
    assert filmed.is_in(Mode.HOLD)
    filmed.camera.recover()
    filmed.film(0.6)
    assert filmed.said[-1] == ""
    track = filmed.tracker.update(filmed.camera.read(0.5))
    assert track.state is TrackState.TRACKING
    # What clears never resumes motion.
    assert filmed.is_in(Mode.HOLD)
