"""The lock-step rig under watch: after every step of the control loop its invariants are checked.

What the operator did is kept here a second time, apart from the code under test.
"""

import math
from collections.abc import Mapping

from mrnav_server.app.hand_seat import HandSeat
from mrnav_server.autonomy.path import PathPlanner
from mrnav_server.core.errors import DeviceError, RefusedError
from mrnav_server.core.frames import HandPoint, StagePoint
from mrnav_server.core.hand import HandConfig
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.limits import allowed_target
from mrnav_server.core.modes import ARMED, LATCHED, Ask, Mode, Transition
from mrnav_server.core.records import MotionCommand
from mrnav_server.core.vessel import VesselMap
from mrnav_server.core.wire_hand import ClientFrame, Hello
from tests.loops.conftest import TICK_S, LockStep

HELLO = Hello(role="operator", token="", client="test", frame=ClientFrame.STAGE, rate_hz=60.0, simulated=True)
ONE_STEP_S = 0.05
"""The shaper takes no longer step, however long the loop stalled."""
LONGEST_STOP_S = 0.4
ROUNDING_UM = 1e-3
AWAY_UM = 26.0
LONGEST_AWAY_S = 0.3
STRAY_UM = 60.0
"""The limits may move a command this far from the shaper's setpoint: it overshoots where they bite."""


class WatchedRig(LockStep):
    """A rig that many hands pull at; every step is checked against docs/safety.md.

    Args:
        vessel: The vessel model.
        planner: Plans on it.
    """

    def __init__(self, vessel: VesselMap, planner: PathPlanner) -> None:
        super().__init__(vessel, planner)
        self.hand._config = HandConfig(vertical_gain=0.04)
        self.hand_y_m = 0.0
        self.hand_valid = True
        self.hand_session = "hand"
        self.refuses_moves = False
        self.stalled: set[int] = set()
        self.beside_um = (0.0, 0.0, 0.0)
        self.disobedient = 0
        """How often the tip was found not to do what it was told."""
        self.transitions: set[tuple[Mode, Mode]] = set()
        self.seat = HandSeat(
            self.lease,
            self.hand,
            step=self._on_seat_step,
            hold=self._hold,
            on_message=lambda _: None,
            announce=self._ignore,
            record=self._ignore,
            clock=lambda: self.now_s,
            transform={},
        )
        self.seat.acquire("hand", HELLO, lambda *_: None)
        self._linked = True
        self._ask: Ask | None = None
        self._closing = self._deliberate = False
        self._seen_open = self._was_closed = False
        self._new: list[Transition] = []
        self._moves: list[MotionCommand] = []
        self._stops = 0
        self._told = self._last = self.world.tip
        self._away = [(0.0, 0.0, math.nan)] * 3
        self._excess_um = 0.0
        self._checked_s = self.now_s
        self._held_s = math.nan
        self._hold_um_per_s = 0.0
        self._wrap()

    # -- what the world does to it -----------------------------------------------------------------------

    def ask(self, ask: Ask) -> None:
        self._ask = ask
        try:
            super().ask(ask)
        finally:
            self._ask = None
        if ask is Ask.STOP:
            assert self.is_in(Mode.STOP), "I3: STOP is one step away from everywhere"

    def sits(self, session: str) -> bool:
        """Let a hand link say hello; tell whether it is the rig's hand."""
        mode = self.control.machine.mode
        taken = self.lease.state().hand
        try:
            self.seat.acquire(session, HELLO, lambda *_: None)
        except RefusedError:
            return False
        assert not (taken and session != self.hand_session), "I7: a seat that is taken stays taken"
        if not taken:
            assert mode is not Mode.MANUAL, "I7: the hand changes only after a HOLD"
            self._seen_open = self._was_closed = False
        self.hand_session, self._linked = session, True
        return True

    def leaves(self) -> None:
        """End the hand's link."""
        self._linked = False
        self.seat.leave(self.hand_session)

    def send_hand(self) -> None:
        self.send_as(self.hand_session, clutch=self.clutch, valid=self.hand_valid)

    def send_as(self, session: str, *, clutch: bool, valid: bool = True) -> None:
        self._hands += 1
        holder = self.lease.is_hand(session)
        if self._linked and session == self.hand_session and not self.lease.state().hand:
            # Its seat was freed by silence: it sits down again, as a hand that just came.
            holder, self._seen_open, self._was_closed = True, False, False
        if holder and valid:
            self._closing = clutch and not self._was_closed
            self._deliberate = clutch and self._seen_open
            self._was_closed, self._seen_open = clutch, not clutch
        elif holder:
            self._was_closed = False
        before, moved = self.hand.clutch, len(self._moves)
        point = HandPoint(self.hand_x_m, self.hand_y_m, self.hand_z_m)
        self.seat.take(
            HandSample(session, self._hands, self.now_s, self.now_s, point, clutch, valid, new_pose=True)
        )
        if not holder:
            assert (self.hand.clutch, len(self._moves)) == (before, moved), "I7: a non-holder moves nothing"

    def stall(self, span_s: float) -> None:
        """Keep the control loop from running; then everything comes at once."""
        self.now_s += span_s
        self.world.advance(self.now_s - self.world.time_s)
        self._next_frame_s = max(self._next_frame_s, self.now_s - TICK_S)
        self.control.step(self.now_s)

    def push_tip(self, target: StagePoint) -> None:
        """Drive the manipulator by its own wheel."""
        self.world.set_target(target, 5000.0)
        while self.world.moving:
            self.tick()

    # -- what is checked ---------------------------------------------------------------------------------

    def _wrap(self) -> None:
        """Stand between loop and manipulator, and around each step."""
        control, manipulator = self.control, self.manipulator
        step, move_to, stop, tell = control.step, manipulator.move_to, manipulator.stop, control._tell_change

        def told(change: Transition) -> None:
            self._new.append(change)
            tell(change)

        def moved(target: StagePoint, speed_um_per_s: float, now_s: float) -> MotionCommand:
            if self.refuses_moves:
                raise DeviceError("the line is busy")
            sent = move_to(self._disobeyed(target), speed_um_per_s, now_s)
            self._told = target
            if self._disobedience:
                sent = MotionCommand(sent.sent_s, target, sent.speed_um_per_s)
            self._moves.append(sent)
            return sent

        def stopped() -> None:
            self._stops += 1
            stop()

        def checked(now_s: float) -> None:
            before = self.control.machine.mode
            shaper = self.control.drive.shaper
            at, velocity, acceleration = (
                shaper.position,
                shaper.velocity_um_per_s,
                shaper.acceleration_um_per_s2,
            )
            engaged = self.hand.engaged
            self._new, self._moves, self._stops = [], [], 0
            step(now_s)
            dt_s = min(now_s - self._checked_s, ONE_STEP_S)
            self._checked_s = now_s
            if any(change.before not in ARMED and change.after in ARMED for change in self._new):
                at, velocity, acceleration = self._tip_um(), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
                self._told, self._last, self._excess_um = at, at, math.inf
            self._check_changes(before, engaged=engaged)
            self._check_facts()
            self._check_shaper(at, velocity, acceleration, dt_s)
            self._check_hold(velocity, acceleration, dt_s)
            self._check_moves(dt_s)
            self._check_obedience(now_s)
            self._closing = self._deliberate = False

        control.step = checked  # type: ignore[method-assign]
        manipulator.move_to = moved  # type: ignore[method-assign]
        manipulator.stop = stopped  # type: ignore[method-assign]
        control._tell_change = told

    def _check_changes(self, before: Mode, *, engaged: bool) -> None:
        mode, facts = self.control.machine.mode, self.control.facts
        for change in self._new:
            pair = (change.before, change.after)
            self.transitions.add(pair)
            if change.before in LATCHED:
                assert (change.after, self._ask) in (
                    (Mode.DISARMED, Ask.RESET),
                    (Mode.STOP, Ask.STOP),
                ), f"I5: {pair} on {self._ask}"
            elif change.before is Mode.DISARMED and change.after in ARMED:
                assert self._ask is Ask.ARM, f"I6: {pair} on {self._ask}"
            if change.after is Mode.AUTO:
                assert self._ask is Ask.AUTO, f"I2: {pair} on {self._ask}"
            if pair == (Mode.HOLD, Mode.MANUAL):
                assert self._ask is Ask.MANUAL or self._deliberate, "I6: nobody closed the clutch"
            if change.after in LATCHED:
                assert self._stops, "the device is stopped on the way into a latch"
        if before is Mode.AUTO and self._closing and facts.hand_fresh and not facts.fault and not self._ask:
            assert mode is Mode.MANUAL, f"I4: {mode} although the clutch closed"
        if self.hand.engaged and not engaged:
            assert self._deliberate or (before is Mode.AUTO and self._closing), "I6: the hand engaged itself"
        if self.hand.engaged:
            assert mode is Mode.MANUAL, mode

    def _check_facts(self) -> None:
        mode, facts, lease = self.control.machine.mode, self.control.facts, self.lease.state()
        if facts.fault:
            assert mode in LATCHED, f"I8: {mode} with {facts.fault}"
            assert not self._moves, "I8"
        if mode is Mode.MANUAL:
            assert lease.hand, "I7: MANUAL without a hand"
            assert facts.hand_fresh
        if mode is Mode.AUTO:
            assert not facts.auto_refusal, "I2"
            assert lease.holder is not None, "I2: nobody controls the rig"
            seen = self.control.scene.seen
            assert seen is not None
            assert self.now_s - seen.taken_s <= 0.1, "I2: an old sighting"
            assert self.control.scene.area is not None, "I2: no goal"
            console = self.lease.console_heard_within(0.5, self.now_s)
            assert console or self.hand.fresh(self.now_s), "I2: nobody supervises"

    def _check_shaper(
        self,
        at: StagePoint,
        velocity: tuple[float, float, float],
        acceleration: tuple[float, float, float],
        dt_s: float,
    ) -> None:
        shaper, limits, mode = self.control.drive.shaper, self.limits, self.control.machine.mode
        if mode not in ARMED:
            return
        speed, top = shaper.speed_um_per_s, limits.autonomy_speed_um_per_s
        after = shaper.acceleration_um_per_s2
        came_to_rest = speed == 0.0 and math.hypot(*after) == 0.0
        assert speed <= top * 1.005, f"I10: {speed} µm/s"
        assert math.hypot(*after) <= limits.acceleration_um_per_s2 * 1.001, "I10: acceleration"
        slack = 1000.0 if came_to_rest else ROUNDING_UM
        jerk = math.dist(after, acceleration)
        assert jerk <= limits.jerk_um_per_s3 * dt_s * 1.001 + slack, f"I10: jerk {jerk} in {dt_s} s"
        step_um = math.dist(shaper.position.array(), at.array())
        assert step_um <= top * 1.005 * dt_s + ROUNDING_UM, f"I11: the setpoint jumped by {step_um} µm"
        change = math.dist(shaper.velocity_um_per_s, velocity)
        most = limits.acceleration_um_per_s2 * dt_s * 1.001 + (1.0 if came_to_rest else ROUNDING_UM)
        assert change <= most, f"I11: the velocity jumped by {change} µm/s"

    def _check_hold(
        self, velocity: tuple[float, float, float], acceleration: tuple[float, float, float], dt_s: float
    ) -> None:
        shaper = self.control.drive.shaper
        if not self.is_in(Mode.HOLD):
            self._held_s = math.nan
            return
        self._held_s += dt_s
        if math.isnan(self._held_s):
            self._held_s = 0.0
            # A running acceleration has to be taken back first.
            rise = math.hypot(*acceleration) ** 2 / (2.0 * self.limits.jerk_um_per_s3)
            self._hold_um_per_s = math.hypot(*velocity) + rise + 10.0
        assert shaper.speed_um_per_s <= self._hold_um_per_s, "I1: HOLD speeds up"
        if self._held_s > LONGEST_STOP_S:
            assert shaper.at_rest, "I1: HOLD does not come to rest"
            assert not self._moves, "I1: HOLD moves after it came to rest"

    def _check_moves(self, dt_s: float) -> None:
        if self.control.machine.mode not in ARMED:
            assert not self._moves, f"I1: motion in {self.control.machine.mode}"
        assert len(self._moves) <= 1
        for move in self._moves:
            target, tip = move.target, self._tip_um()
            ahead_um = math.dist(target.array(), tip.array())
            top = self.limits.autonomy_speed_um_per_s
            assert ahead_um <= move.speed_um_per_s * self.limits.ahead_s * 1.001, f"{ahead_um} µm ahead"
            assert ahead_um <= top * self.limits.ahead_s * 1.001, f"{ahead_um} µm ahead"
            for value in target.array():
                assert 0.0 <= value <= 20_000.0, "I10: outside the workspace"
            allowed = allowed_target(target, self.limits, self.calibration, self.vessel)
            excess_um = math.dist(target.array(), allowed.array())
            # Once inside, always inside; a tip that was armed outside may only come back.
            assert excess_um <= max(self._excess_um, 1.0) + ROUNDING_UM, f"I10: {excess_um} µm outside"
            self._excess_um = excess_um
            assert self.calibration.height_um(target) >= self.calibration.critical_height_um, "I10: height"
            stray_um = math.dist(target.array(), self.control.drive.shaper.position.array())
            near = ahead_um < 0.999 * top * self.limits.ahead_s
            assert stray_um <= STRAY_UM or not near, f"the command is {stray_um} µm from the setpoint"
            step_um = math.dist(target.array(), self._last.array())
            assert step_um <= 2.0 * top * dt_s + ROUNDING_UM, f"I10: the command jumped by {step_um} µm"
            self._last = target

    def _check_obedience(self, now_s: float) -> None:
        mode, reason = self.control.machine.mode, self.control.machine.reason
        if mode is Mode.FAULT and any(word in reason for word in ("does not move", "rests", "told to be")):
            assert self._new or not self._moves
            self.disobedient += bool(self._new)
        for axis, (told_um, at_um) in enumerate(zip(self._told.array(), self._tip_um().array(), strict=True)):
            # A target that moves is followed with a lag, which may look like a tip that rests beside it.
            rests_beside = self.beside_um[axis] != 0.0 and told_um == self._away[axis][2]
            disobeys = axis in self.stalled or rests_beside
            gap_um = told_um - at_um if disobeys and mode in ARMED else 0.0
            side = math.copysign(1.0, gap_um) if abs(gap_um) > AWAY_UM else 0.0
            since_s = self._away[axis][1] if side == self._away[axis][0] else now_s
            self._away[axis] = (side, since_s, told_um)
            away_s = now_s - since_s if side else 0.0
            assert away_s <= LONGEST_AWAY_S, f"H13: {mode} although axis {axis} is away for {away_s} s"

    @property
    def _disobedience(self) -> bool:
        return bool(self.stalled) or any(self.beside_um)

    def _disobeyed(self, target: StagePoint) -> StagePoint:
        """Return where a tip goes of which axes are stuck, or that rests beside its target."""
        tip = self.world.tip.array()
        beside = target.array() + self.beside_um
        return StagePoint(*(float(tip[axis] if axis in self.stalled else beside[axis]) for axis in range(3)))

    def _tip_um(self) -> StagePoint:
        tip = self.control.scene.tip
        assert tip is not None
        return tip.position

    # -- callbacks ---------------------------------------------------------------------------------------

    def _on_seat_step(self, received_s: float | None) -> None:
        if received_s is None:
            self.control.step(self.now_s)
        else:
            self.control.on_hand(received_s, self.now_s)

    def _hold(self) -> None:
        if self.control.machine.mode in ARMED:
            self.ask(Ask.HOLD)

    def _ignore(self, topic: str, data: Mapping[str, object]) -> None:
        pass


def granted(rig: WatchedRig, ask: Ask) -> bool:
    """Ask; tell whether it was granted."""
    try:
        if ask is Ask.AUTO:
            rig.control.check(ask, rig.now_s)
            rig.start_auto()
        else:
            rig.ask(ask)
    except RefusedError:
        return False
    return True
