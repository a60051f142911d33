"""The rig's modes and severities (docs/safety.md)."""

from enum import Enum, IntEnum


class Mode(Enum):
    """Who may move the magnet, and how."""

    DISARMED = "DISARMED"
    MANUAL = "MANUAL"
    AUTO = "AUTO"
    HOLD = "HOLD"
    FAULT = "FAULT"
    STOP = "STOP"


class Severity(IntEnum):
    """How bad the worst active cause is; a larger one wins."""

    NONE = 0
    WARN = 1
    HOLD = 2
    FAULT = 3
    STOP = 4
