"""An emulated Sensapex manipulator: what it answers, and what it reports by itself.

It is told the time and every request, and returns what it sends; sockets are the shell's (emulator.py).
What is not known of real devices, and what was chosen here, stands in docs/emulator.md.
"""

import math
import random
from dataclasses import dataclass, replace

from mrnav_server.devices.sensapex.emulated_goals import (
    Goals,
    Limits,
    goto_goals,
    memory_goals,
    step_goals,
    zero_goals,
)
from mrnav_server.devices.sensapex.emulated_motion import TRAVEL_UM, Stage
from mrnav_server.devices.sensapex.emulated_outbox import Address, Answered, Notes, Outbox, Outgoing
from mrnav_server.devices.sensapex.emulated_registers import DeviceModel, Registers
from mrnav_server.devices.sensapex.emulator_faults import AXES, Faults
from mrnav_server.devices.sensapex.smcp1 import (
    ALL_DEVICES,
    Block,
    DataType,
    Feature,
    Kind,
    Message,
    Option,
    Parameter,
    Status,
)

VERSION = (1, 504, 0, 0, 0)
NAME = "emulated uMp"
ZERO_LOST_UM = -1_000_000.0
"""What a device that has lost its zero is off by."""
DONE, STOPPED = 0, 1
"""Codes of a completion."""

_EVERYBODY = frozenset({ALL_DEVICES, 0x04FF, 0x07FF})
_AXIS_BITS = tuple(map(int, (Status.X, Status.Y, Status.Z, Status.W)))
_INT32 = 0x7FFFFFFF


@dataclass(frozen=True, slots=True)
class _Drive:
    """A motion whose end is to be told."""

    requester: int
    peer: Address
    done: Kind
    told: bool
    code: int = DONE


class _SilentError(Exception):
    """The request is refused in the only way that a client sees: without an answer."""


class EmulatedDevice:
    """One manipulator.

    Args:
        model: What kind it is.
        faults: What is wrong with it; nothing if left out.
    """

    def __init__(self, model: DeviceModel, faults: Faults | None = None) -> None:
        self._model = model
        self._direct_id = 0x1000 + model.serial % 100_000
        self._id = self._direct_id if model.serial == model.id else model.id
        middle_um = (TRAVEL_UM / 2,) * 4
        start_um = (*model.start_um, *middle_um[len(model.start_um) :])[: model.axes]
        self._stage = Stage(start_um, model.acceleration_um_per_s2)
        self._registers = Registers(model)
        self._memory_um: dict[int, list[float]] = {}
        self._noise = random.Random(model.seed * 1009 + model.id)
        self._faults = Faults()
        self._frozen_um: list[float] | None = None
        self._drive: _Drive | None = None
        self._mask = 0
        self._next_report_s = math.inf
        self._notes = Notes(self._id)
        self._outbox = Outbox(model.seed)
        self._answered = Answered()
        self._wakes_s: float | None = None
        self.set_faults(faults or Faults(), -math.inf)

    @property
    def id(self) -> int:
        """Its number on the network: a legacy id, or its serial number."""
        return self._model.id

    @property
    def faults(self) -> Faults:
        """What is wrong with it now."""
        return self._faults

    def set_faults(self, faults: Faults, now_s: float) -> None:
        """Let this, and nothing else, be wrong with it."""
        if faults.freeze_reading and self._frozen_um is None:
            self._frozen_um = self._reading_um(now_s)
        elif not faults.freeze_reading:
            self._frozen_um = None
        self._stage.stall(
            (AXES.index(axis) for axis in faults.stall if axis in AXES[: self._model.axes]), now_s
        )
        self._faults = faults

    def reboot(self, now_s: float) -> None:
        """Stand still at once, be deaf and dumb for a while, then say hello."""
        self._stage.cut(now_s)
        self._drive, self._mask, self._next_report_s = None, 0, math.inf
        self._answered.forget()
        self._wakes_s = now_s + self._faults.silence_s

    def true_state(self, now_s: float) -> dict[str, object]:
        """Return what no client can see: where it really is, in µm and µm/s, and whether it moves."""
        self._stage.advance(now_s)
        return {
            "true_um": self._stage.positions_um(now_s),
            "velocity_um_per_s": self._stage.velocities_um_per_s(now_s),
            "moving": not self._stage.at_rest(now_s),
            "rebooting": self._wakes_s is not None,
        }

    def listens_to(self, receiver: int) -> bool:
        """Whether a message to this id is for it."""
        return receiver in _EVERYBODY or receiver in (self._id, self._direct_id)

    def due_s(self, now_s: float) -> float:
        """Return when ``advance`` has something to do next; infinity if never."""
        if self._wakes_s is not None:
            return self._wakes_s
        return min(self._next_report_s, self._stage.next_change_s(now_s))

    def receive(self, message: Message, peer: Address, now_s: float) -> list[Outgoing]:
        """Take a message and return what it sends at once."""
        outgoing = self.advance(now_s)
        if self._wakes_s is not None or not message.options & Option.REQ or message.options & Option.NOTIFY:
            return outgoing
        if self._faults.drop_requests:
            self._faults = replace(self._faults, drop_requests=self._faults.drop_requests - 1)
            return outgoing
        self._outbox.meet(peer, now_s)
        answers = self._answered.find(message, peer, now_s)
        if answers is None:
            answers = self._answers(message, peer, now_s)
            self._answered.keep(message, peer, answers, now_s)
        if answers and self._faults.drop_acks:
            self._faults = replace(self._faults, drop_acks=self._faults.drop_acks - 1)
        else:
            outgoing += self._outbox.to(peer, answers, self._faults, now_s)
        return outgoing + self.advance(now_s)

    def advance(self, now_s: float) -> list[Outgoing]:
        """Return what it sends by itself up to this time."""
        if self._wakes_s is not None:
            if now_s < self._wakes_s:
                return []
            self._wakes_s = None
            return self._told(now_s, Kind.HELLO)
        self._stage.advance(now_s)
        moving = self._stage.moving(now_s)
        mask = sum(bit for bit, moves in zip(_AXIS_BITS, moving, strict=False) if moves)
        outgoing: list[Outgoing] = []
        before, self._mask = self._mask, mask
        if mask != before and not self._faults.no_status:
            outgoing += self._told(now_s, Kind.STATUS, mask)
        if mask and not before:
            self._next_report_s = now_s + self._model.report_s
        if now_s >= self._next_report_s or (before and not mask):
            outgoing += self._told(now_s, Kind.POSITION, *self._reading_nm(now_s))
            # Reports keep their rhythm, but what a late call has missed is not made up for.
            self._next_report_s += self._model.report_s
            if self._next_report_s <= now_s:
                self._next_report_s = now_s + self._model.report_s
        if not mask:
            self._next_report_s = math.inf
            outgoing += self._completion(now_s)
        return outgoing

    def _told(self, now_s: float, kind: Kind, *values: int) -> list[Outgoing]:
        return self._outbox.to_all(self._notes.note(kind, *values), self._faults, now_s)

    def _completion(self, now_s: float) -> list[Outgoing]:
        drive, self._drive = self._drive, None
        if drive is None:
            return []
        if drive.done is Kind.ZERO_DRIVE_DONE and drive.code == DONE:
            self._faults = replace(self._faults, calibration_lost=False)
        if not drive.told or self._faults.lose_completion:
            return []
        options = Option.NOTIFY | Option.REQ | Option.REQ_ACK
        note = replace(self._notes.note(drive.done, drive.code), receiver=drive.requester, options=options)
        return self._outbox.to(drive.peer, (note,), self._faults, now_s)

    def _answers(self, message: Message, peer: Address, now_s: float) -> tuple[Message, ...]:
        sender = message.receiver if message.receiver == self._direct_id else self._id
        error = Option(0)
        data: tuple[Block, ...] = ()
        try:
            if not message.options & Option.WAIT_TRIGGER_1:
                data = self._carried_out(message, peer, now_s)
        except _SilentError:
            return ()
        except (LookupError, ValueError):
            error = Option.ERROR
        answers = []
        if message.options & Option.REQ_ACK:
            answers.append(Message(message.sender, sender, message.id, Option.ACK | error, message.kind))
        if message.options & Option.REQ_RESP:
            blocks = () if error else data or (Block((0,)),)
            answers.append(Message(message.sender, sender, message.id, error, message.kind, blocks))
        return tuple(answers)

    def _carried_out(self, message: Message, peer: Address, now_s: float) -> tuple[Block, ...]:
        """Do what a request asks and return its data.

        Raises:
            LookupError: If the request, or what it names, is unknown, or arguments are missing.
            ValueError: If an argument does not fit.
        """
        values, registers = message.values, self._registers
        match message.kind:
            case Kind.PING:
                return message.blocks
            case Kind.STOP:
                self._stop(now_s)
            case Kind.REBOOT:
                self.reboot(now_s)
            case Kind.SLEEP | Kind.WAKE_UP | Kind.SAVE_ZERO | Kind.CLEAR_ERROR:
                pass
            case Kind.CALIBRATE:
                self._drive = _Drive(message.sender, peer, Kind.CALIBRATE_DONE, True)
            case Kind.SET_FEATURE | Kind.SET_EXTENDED_FEATURE:
                registers.set_feature(values[0], values[1], message.kind == Kind.SET_EXTENDED_FEATURE)
            case Kind.GET_FEATURE | Kind.GET_EXTENDED_FEATURE:
                extended = message.kind == Kind.GET_EXTENDED_FEATURE
                return (Block((values[0], registers.feature(values[0], extended))),)
            case Kind.GET_FEATURES:
                return (Block((registers.feature_mask(),), DataType.UINT64),)
            case Kind.GET_POSITIONS:
                return (Block(self._reading_nm(now_s)),)
            case Kind.SET_PARAMETER:
                registers.set_parameter(values[0], values[1])
                return (Block(values[:2]),)
            case Kind.GET_PARAMETER:
                return (Block((values[0], registers.parameter(values[0]))),)
            case Kind.GET_VERSION:
                return (Block(VERSION),)
            case Kind.GET_INFO:
                return (Block(tuple(f"{NAME}-{self._model.axes}\0".encode()), DataType.CHAR),)
            case Kind.GET_ERROR:
                return (Block((0,), DataType.UINT32),)
            case Kind.AXIS_ANGLE:
                return (Block((registers.parameter(Parameter.VIRTUAL_X_ANGLE),)),)
            case Kind.STORE_MEMORY:
                self._memory_um[values[0]] = self._stage.positions_um(now_s)
            case Kind.GOTO:
                self._move(goto_goals(message, self._limits, -self._zero_error_um), message, peer, now_s)
            case Kind.GOTO_MEMORY:
                at_um = self._memory_um[values[0]]
                self._move(memory_goals(message, self._limits, at_um), message, peer, now_s)
            case Kind.STEP:
                at_um = self._stage.positions_um(now_s)
                self._move(step_goals(message, self._limits, at_um), message, peer, now_s)
            case Kind.ZERO_DRIVE:
                self._move(zero_goals(message, self._limits), message, peer, now_s)
            case _:
                raise LookupError(f"no request {message.kind}")
        return ()

    def _move(self, goals: Goals, message: Message, peer: Address, now_s: float) -> None:
        # An ACK with the error bit counts as success with the vendor's library, so there is none.
        if self._registers.feature(Feature.PREVENT_MOVEMENT):
            raise _SilentError
        self._stage.go(goals.of_axes, goals.together, now_s)
        zero = message.kind == Kind.ZERO_DRIVE
        told = zero or bool(message.options & Option.REQ_NOTIFY)
        done = Kind.ZERO_DRIVE_DONE if zero else Kind.GOTO_DONE
        self._drive = _Drive(message.sender, peer, done, told)

    @property
    def _limits(self) -> Limits:
        usual = self._registers.parameter(Parameter.MEMORY_SPEED)
        return Limits(
            self._model.axes, usual, self._model.fastest_um_per_s, self._model.acceleration_um_per_s2
        )

    def _stop(self, now_s: float) -> None:
        self._stage.halt(now_s)
        if self._drive is not None:
            self._drive = replace(self._drive, code=STOPPED)

    @property
    def _zero_error_um(self) -> float:
        return ZERO_LOST_UM if self._faults.calibration_lost else 0.0

    def _reading_um(self, now_s: float) -> list[float]:
        if self._frozen_um is not None:
            return self._frozen_um
        self._stage.advance(now_s)
        offset_um = (*self._faults.offset_um, 0.0, 0.0, 0.0, 0.0)
        return [
            at_um + offset_um[axis] + self._zero_error_um + self._noise.gauss(0.0, self._faults.noise_um)
            for axis, at_um in enumerate(self._stage.positions_um(now_s))
        ]

    def _reading_nm(self, now_s: float) -> tuple[int, ...]:
        return tuple(max(-_INT32, min(_INT32 - 1, round(at_um * 1000))) for at_um in self._reading_um(now_s))
