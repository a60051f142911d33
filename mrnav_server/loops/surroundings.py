"""What the control loop asks of the rig around it at every step, and what it tells."""

from collections.abc import Callable
from dataclasses import dataclass

from mrnav_server.core.lease import Lease


def _fine() -> str:
    return ""


def _silent() -> list[str]:
    return []


def _unheard(_: object) -> None:
    pass


@dataclass(frozen=True, slots=True)
class Outlook:
    """What everybody outside the deciders says at one moment; a replay needs no more of them.

    Attributes:
        recorder_fault, supervisor_fault, camera_fault, drift_warning, drift_fault: As in ``Surroundings``.
        device_warnings: In one text.
        leased: Whether anybody controls the rig.
        hand_seated: Whether a hand belongs to the lease.
        console_heard: Whether the page that shares the lease was heard lately.
    """

    recorder_fault: str = ""
    supervisor_fault: str = ""
    camera_fault: str = ""
    drift_warning: str = ""
    drift_fault: str = ""
    device_warnings: str = ""
    leased: bool = False
    hand_seated: bool = False
    console_heard: bool = False


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

    def look(self, lease: Lease, console_s: float, now_s: float) -> Outlook:
        """Ask everybody once; seats of the lease that were silent too long are freed.

        Args:
            lease: Who controls the rig.
            console_s: A page counts as heard for this long.
            now_s: Now.
        """
        lease.expire(now_s)
        return Outlook(
            self.recorder_fault(),
            self.supervisor_fault(),
            self.camera_fault(),
            self.drift_warning(),
            self.drift_fault(),
            "; ".join(self.device_warnings()),
            lease.held,
            lease.state().hand,
            lease.console_heard_within(console_s, now_s),
        )
