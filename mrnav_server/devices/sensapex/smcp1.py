"""SMCP1, the wire protocol of Sensapex manipulators: bytes ↔ messages.

Standard library only: the process that stops a manipulator when the server has died imports nothing heavy.
One message is one UDP datagram, big-endian: a header of 16 bytes, then blocks of values.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from mrnav_server.core.errors import WireError

BASE_PORT = 55555
"""A group of devices listens on this port plus its number, 0..10."""
UNDEFINED = 0x7FFFFFFF
"""A position that is not given: this axis stays where it is."""
MAX_DATAGRAM = 1502

ALL_DEVICES = 0x00FF
ALL_PCS = 0x02FF

_VERSION = 0x10
_HEADER = struct.Struct(">BBHHHIHH")
_BLOCK = struct.Struct(">HH")


class Option(IntFlag):
    """What a frame is and what it asks for."""

    REPLY = 0x000
    REQ = 0x001
    ACK = 0x002
    NOTIFY = 0x004
    ERROR = 0x008
    REQ_ACK = 0x010
    REQ_RESP = 0x020
    REQ_NOTIFY = 0x040
    REQ_BCAST = 0x080
    PRIORITY = 0x100
    WAIT_TRIGGER_1 = 0x200


COMMAND = Option.REQ | Option.REQ_ACK
QUERY = COMMAND | Option.REQ_RESP
MOVE = COMMAND | Option.REQ_NOTIFY


class Kind(IntEnum):
    """Message types: requests below 100, notifications from there on."""

    PING = 0
    STOP = 1
    SLEEP = 2
    REBOOT = 3
    ZERO_DRIVE = 4
    CALIBRATE = 5
    WAKE_UP = 7
    SAVE_ZERO = 8
    SET_FEATURE = 11
    GET_FEATURE = 12
    GET_FEATURES = 13
    GET_POSITIONS = 14
    SET_PARAMETER = 15
    GET_PARAMETER = 16
    SET_EXTENDED_FEATURE = 17
    GET_EXTENDED_FEATURE = 18
    GET_VERSION = 23
    GET_INFO = 24
    STORE_MEMORY = 31
    GOTO_MEMORY = 32
    GOTO = 33
    STEP = 34
    GET_ERROR = 41
    CLEAR_ERROR = 42
    AXIS_ANGLE = 44
    HELLO = 100
    POSITION = 101
    STATUS = 102
    ZERO_DRIVE_DONE = 103
    GOTO_DONE = 104
    CALIBRATE_DONE = 121
    DRIVE_LOOP_DONE = 122


class Parameter(IntEnum):
    """Numbers of the device's parameters."""

    MEMORY_SPEED = 2
    DEVICE_ID = 3
    VIRTUAL_X_ANGLE = 4
    UDP_PORT = 6
    SOFT_START = 15
    AXIS_HEAD = 0x80
    HARDWARE_ID = 0x101
    SERIAL = 0x102
    EOW = 0x103
    DETECTED_ANGLE = 0x104
    AXIS_COUNT = 0x105


class Feature(IntEnum):
    """Numbers of the device's features."""

    LEDS_OFF = 16
    PREVENT_MOVEMENT = 17
    LOW_SPEED = 32
    SOFT_START = 33


class Status(IntFlag):
    """Bits of a status notification."""

    BUSY = 0x01
    ERROR = 0x08
    X = 0x10
    Y = 0x20
    Z = 0x40
    W = 0x80


class DataType(IntEnum):
    """Types of the values in a block."""

    VOID = 0
    UINT8 = 1
    INT8 = 2
    UINT16 = 3
    INT16 = 4
    UINT32 = 5
    INT32 = 6
    UINT64 = 7
    INT64 = 8
    CHAR = 9


_CODES = {
    DataType.UINT8: "B",
    DataType.INT8: "b",
    DataType.UINT16: "H",
    DataType.INT16: "h",
    DataType.UINT32: "I",
    DataType.INT32: "i",
    DataType.UINT64: "Q",
    DataType.INT64: "q",
    DataType.CHAR: "B",
}


@dataclass(frozen=True, slots=True)
class Block:
    """Values of one type.

    Attributes:
        values: Whole numbers; bytes of a text.
        data_type: Their type.
    """

    values: tuple[int, ...]
    data_type: DataType = DataType.INT32

    @property
    def text(self) -> str:
        """The values as text."""
        return bytes(value & 0xFF for value in self.values).decode("latin-1").rstrip("\0")


@dataclass(frozen=True, slots=True)
class Message:
    """One SMCP1 message.

    Attributes:
        receiver: Id of a device, a PC, or all of a kind.
        sender: Id of who sends it.
        id: The requester's counter, 0..65535; a retransmission and all answers repeat it.
        options: What it is and what it asks for.
        kind: A ``Kind``, or a number that this module does not know.
        blocks: Its arguments or data.
    """

    receiver: int
    sender: int
    id: int
    options: Option
    kind: int
    blocks: tuple[Block, ...] = ()

    @property
    def values(self) -> tuple[int, ...]:
        """The first block's values; empty without one."""
        return self.blocks[0].values if self.blocks else ()


def encode(message: Message) -> bytes:
    """Return a message as one datagram.

    Raises:
        WireError: If a number does not fit its field.
    """
    try:
        head = _HEADER.pack(
            _VERSION,
            0,
            message.receiver,
            message.sender,
            message.id,
            message.options,
            message.kind,
            len(message.blocks),
        )
        return head + b"".join(_encoded(block) for block in message.blocks)
    except struct.error as error:
        raise WireError("bad_message", f"a number does not fit its field: {error}") from None


def decode(data: bytes) -> Message:
    """Return the message in a datagram.

    Raises:
        WireError: If it is not a whole SMCP1 message.
    """
    if len(data) < _HEADER.size:
        raise WireError("bad_frame", f"{len(data)} bytes are no SMCP1 message")
    version, _, receiver, sender, number, options, kind, count = _HEADER.unpack_from(data)
    if version != _VERSION:
        raise WireError("bad_version", f"SMCP1 has version {_VERSION:#x}, not {version:#x}")
    at, blocks = _HEADER.size, []
    for _ in range(count):
        block, at = _decoded(data, at)
        blocks.append(block)
    return Message(receiver, sender, number, Option(options), kind, tuple(blocks))


def _encoded(block: Block) -> bytes:
    head = _BLOCK.pack(block.data_type, len(block.values))
    if block.data_type is DataType.VOID:
        return head
    body = struct.pack(f">{len(block.values)}{_CODES[block.data_type]}", *block.values)
    return head + body + b"\0" * (-len(body) % 4)


def _decoded(data: bytes, at: int) -> tuple[Block, int]:
    try:
        number, count = _BLOCK.unpack_from(data, at)
        data_type = DataType(number)
        at += _BLOCK.size
        if data_type is DataType.VOID:
            return Block((), data_type), at
        layout = f">{count}{_CODES[data_type]}"
        values = struct.unpack_from(layout, data, at)
    except (struct.error, ValueError) as error:
        raise WireError("bad_frame", f"a block of the message cannot be read: {error}") from None
    size = struct.calcsize(layout)
    return Block(values, data_type), at + size + -size % 4
