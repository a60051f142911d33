"""A manipulator behind a slow line, in simulated time: late commands, late and noisy readings, and faults."""

import heapq
import math
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from mrnav_server.autonomy.path import PathPlanner
from mrnav_server.core.errors import DeviceError
from mrnav_server.core.frames import HandPoint, StagePoint
from mrnav_server.core.hand import HandConfig
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.limits import Limits
from mrnav_server.core.records import MotionCommand, TipReading
from mrnav_server.core.vessel import VesselMap
from mrnav_server.devices.sensapex.emulated_motion import Goal, Stage
from mrnav_server.devices.sensapex.goto import goto
from tests.loops.conftest import TICK_S, LockStep

STEP_S = 0.001
LAG_S = 0.02
ACCELERATION_UM_PER_S2 = 50_000.0


class Motion(Protocol):
    """How three axes move."""

    def go(self, target_um: Sequence[float], speeds_um_per_s: Sequence[float], now_s: float) -> None: ...
    def halt(self, now_s: float) -> None: ...
    def stall(self, axes: set[int], now_s: float) -> None: ...
    def at_um(self, now_s: float) -> list[float]: ...


class Lag:
    """A servo of first order, as the simulated manipulator has."""

    def __init__(self, start_um: Sequence[float]) -> None:
        self._at_um = list(start_um)
        self._target_um = list(start_um)
        self._speeds = [0.0] * 3
        self._stalled: set[int] = set()
        self._now_s = math.nan

    def go(self, target_um: Sequence[float], speeds_um_per_s: Sequence[float], now_s: float) -> None:
        self.at_um(now_s)
        self._target_um, self._speeds = list(target_um), list(speeds_um_per_s)

    def halt(self, now_s: float) -> None:
        self._target_um = self.at_um(now_s)

    def stall(self, axes: set[int], now_s: float) -> None:
        self.at_um(now_s)
        self._stalled = axes

    def at_um(self, now_s: float) -> list[float]:
        if math.isnan(self._now_s):
            self._now_s = now_s
        while self._now_s < now_s - 1e-9:
            self._now_s += STEP_S
            share = 1.0 - math.exp(-STEP_S / LAG_S)
            for axis in {0, 1, 2} - self._stalled:
                most_um = self._speeds[axis] * STEP_S
                step_um = share * (self._target_um[axis] - self._at_um[axis])
                self._at_um[axis] += min(max(step_um, -most_um), most_um)
        return list(self._at_um)


class Trapezoid:
    """Axes of bounded speed and acceleration, as the emulated controller has."""

    def __init__(self, start_um: Sequence[float]) -> None:
        self._stage = Stage(start_um, ACCELERATION_UM_PER_S2)

    def go(self, target_um: Sequence[float], speeds_um_per_s: Sequence[float], now_s: float) -> None:
        goals = {
            axis: Goal(to_um, speed, ACCELERATION_UM_PER_S2)
            for axis, (to_um, speed) in enumerate(zip(target_um, speeds_um_per_s, strict=True))
        }
        self._stage.go(goals, True, now_s)

    def halt(self, now_s: float) -> None:
        self._stage.halt(now_s)

    def stall(self, axes: set[int], now_s: float) -> None:
        self._stage.stall(axes, now_s)

    def at_um(self, now_s: float) -> list[float]:
        return self._stage.positions_um(now_s)


class SlowDevice:
    """A manipulator as the control loop knows it.

    Args:
        motion: How it moves.
        now_s: When it begins.
        reading_s: Time between two questions for its position.
        up_s: How long a command or a question takes to get there.
        down_s: How long an answer takes to come back.
        noise_um: Standard deviation of a reading.
    """

    def __init__(
        self,
        motion: Motion,
        now_s: float,
        reading_s: float,
        up_s: float,
        down_s: float,
        noise_um: float = 0.1,
    ) -> None:
        self.beside_um = (0.0, 0.0, 0.0)
        """How far beside its targets it comes to rest."""
        self.lost_um = (0.0, 0.0, 0.0)
        """How far its readings are wrong."""
        self.lost_stops = 0
        """How many STOPs the line still loses."""
        self.silent = False
        self.stops_s: list[float] = []
        self._motion = motion
        self._now_s = now_s
        self._reading_s, self._up_s, self._down_s = reading_s, up_s, down_s
        self._noise_um = noise_um
        self._rng = np.random.default_rng(1)
        self._events: list[tuple[float, int, Callable[[float], None]]] = []
        self._number = 0
        self._tip = self._read(now_s)
        self._before = self._tip
        self._ask(now_s)

    def stall(self, axes: set[int]) -> None:
        """Let axes be stuck."""
        self._motion.stall(axes, self._now_s)

    def true_um(self) -> list[float]:
        """Where the axes are."""
        return self._motion.at_um(self._now_s)

    def advance(self, now_s: float) -> None:
        """Let everything happen that is due."""
        while self._events and self._events[0][0] <= now_s:
            at_s, _, act = heapq.heappop(self._events)
            self._now_s = at_s
            act(at_s)
        self._now_s = now_s

    # -- the device

    async def open(self) -> None: ...

    async def close(self) -> None: ...

    def warnings(self) -> list[str]:
        return []

    def tip(self) -> TipReading:
        if self.silent:
            raise DeviceError("the manipulator does not answer")
        return self._tip

    def move_to(self, target: StagePoint, speed_um_per_s: float, now_s: float) -> MotionCommand:
        reading_s = max(self._tip.taken_s - self._before.taken_s, 1e-3)
        speed = math.dist(self._tip.position.array(), self._before.position.array()) / reading_s
        move = goto(target, speed_um_per_s, self._tip.position, speed * (now_s - self._tip.taken_s))
        to_um = [float(at) + beside for at, beside in zip(target.array(), self.beside_um, strict=True)]
        self._at(self._up_s, lambda at_s: self._motion.go(to_um, move.speeds_um_per_s, at_s))
        return MotionCommand(now_s, move.target, move.speed_um_per_s)

    def stop(self) -> None:
        self.stops_s.append(self._now_s)
        if self.lost_stops > 0:
            self.lost_stops -= 1
        else:
            self._at(self._up_s, self._motion.halt)

    def _at(self, delay_s: float, act: Callable[[float], None]) -> None:
        self._number += 1
        heapq.heappush(self._events, (self._now_s + delay_s, self._number, act))

    def _ask(self, asked_s: float) -> None:
        def read(at_s: float) -> None:
            reading = self._read(asked_s)
            self._at(self._down_s, lambda _: self._take(reading))

        self._at(self._up_s, read)
        self._at(self._reading_s, self._ask)

    def _take(self, reading: TipReading) -> None:
        self._before, self._tip = self._tip, reading

    def _read(self, asked_s: float) -> TipReading:
        at_um = np.array(self._motion.at_um(self._now_s)) + self.lost_um
        still = self._motion.at_um(self._now_s)
        moving = math.dist(still, getattr(self, "_still", still)) > 0.01
        self._still = still
        return TipReading(asked_s, StagePoint.of(at_um + self._rng.normal(0.0, self._noise_um, 3)), moving)


class DeviceRig(LockStep):
    """The lock-step rig with a slow device in place of the simulated manipulator; no robot, no camera."""

    def __init__(
        self,
        vessel: VesselMap,
        planner: PathPlanner,
        motion: Callable[[Sequence[float]], Motion],
        reading_s: float = 0.02,
        up_s: float = 0.002,
        down_s: float = 0.002,
        limits: Limits | None = None,
    ) -> None:
        super().__init__(vessel, planner, limits=limits)
        start_um = [float(at) for at in self.world.tip.array()]
        self.device = SlowDevice(motion(start_um), self.now_s, reading_s, up_s, down_s)
        self.control._manipulator = self.control.drive._manipulator = self.device
        self.hand._config = HandConfig(vertical_gain=0.04)
        self.hand_y_m = 0.0
        self.advance(0.2)

    def tick(self) -> None:
        self.now_s += TICK_S
        self.device.advance(self.now_s)
        while self.hand_alive and self.now_s >= self._next_hand_s:
            self._next_hand_s += 1 / 60
            self.send_hand()
        self.control.step(self.now_s)

    def send_hand(self) -> None:
        self._hands += 1
        self.lease.hear("hand", self.now_s)
        point = HandPoint(self.hand_x_m, self.hand_y_m, self.hand_z_m)
        sample = HandSample("hand", self._hands, self.now_s, self.now_s, point, self.clutch, True, True)
        self.hand.on_sample(sample)
        self.control.on_hand(self.now_s, self.now_s)

    def grasp(self) -> None:
        """Close the clutch anew."""
        self.clutch = False
        self.advance(0.05)
        self.clutch = True
        self.advance(0.05)

    def sweep(self, velocity_m_per_s: Sequence[float], span_s: float) -> None:
        """Move the hand at a velocity."""
        for _ in range(round(span_s / TICK_S)):
            self.hand_x_m += velocity_m_per_s[0] * TICK_S
            self.hand_y_m += velocity_m_per_s[1] * TICK_S
            self.hand_z_m += velocity_m_per_s[2] * TICK_S
            self.tick()
