"""What the control loop asks of the rig around it at every step, and what it tells."""

from collections.abc import Callable
from dataclasses import dataclass


def _fine() -> str:
    return ""


def _silent() -> list[str]:
    return []


def _unheard(_: object) -> None:
    pass


@dataclass(slots=True)
class Surroundings:
    """Whoever watches something else; each is called at every step and must be quick. "" means no objection.

    Attributes:
        recorder_fault: Why a trial's log cannot be relied on.
        supervisor_fault: Why nobody would stop the manipulator if this process died.
        camera_fault: Why the camera's pictures must not be relied on.
        drift_warning: That the vessel or the camera has moved.
        drift_fault: The same, when it is too far for AUTO.
        device_warnings: What the manipulator's driver has to say to the operator.
        beat: Told whether the tip may be in motion.
        announce: Told, once a task, in how many seconds the operator will take over.
    """

    recorder_fault: Callable[[], str] = _fine
    supervisor_fault: Callable[[], str] = _fine
    camera_fault: Callable[[], str] = _fine
    drift_warning: Callable[[], str] = _fine
    drift_fault: Callable[[], str] = _fine
    device_warnings: Callable[[], list[str]] = _silent
    beat: Callable[[bool], None] = _unheard
    announce: Callable[[float], None] = _unheard
