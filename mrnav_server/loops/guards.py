"""From measurements to the facts that settle the mode: every guard and its sentence for the operator."""

from dataclasses import dataclass

from mrnav_server.core.frames import Calibration
from mrnav_server.core.limits import Limits, outside_um
from mrnav_server.core.records import TipReading, Track, TrackState
from mrnav_server.core.vessel import VesselMap

_ARM_WITHIN_UM = 20.0
"""Noise of a tip that rests at the edge of where it may be; from further out it would leap back."""


@dataclass(frozen=True, slots=True)
class GuardConfig:
    """Deadlines and bounds of the guards.

    Attributes:
        track_age_s: AUTO needs a robot seen within this time.
        console_s: Without a hand, AUTO needs the console's heartbeat within this time.
        lead_um: A hold point further than this from the robot means that the robot was left behind.
        tip_age_s: A position older than this is unknown.
        following_error_um: The tip may lag behind its setpoint by this much ...
        following_s: ... for this long.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    track_age_s: float = 0.1
    console_s: float = 0.5
    lead_um: float = 3000.0
    tip_age_s: float = 0.1
    following_error_um: float = 200.0
    following_s: float = 0.2


class FollowingError:
    """How long the tip has been too far behind its setpoint.

    Args:
        config: Bound and duration.
    """

    def __init__(self, config: GuardConfig) -> None:
        self._config = config
        self._since_s: float | None = None

    def fault(self, gap_um: float, now_s: float) -> str:
        """Return the fault, or "" while the tip follows."""
        if gap_um <= self._config.following_error_um:
            self._since_s = None
            return ""
        if self._since_s is None:
            self._since_s = now_s
        if now_s - self._since_s < self._config.following_s:
            return ""
        return f"the manipulator does not follow: {gap_um:.0f} µm behind its setpoint"


def tip_fault(tip: TipReading, config: GuardConfig, now_s: float) -> str:
    """Return why the tip's position cannot be relied on, or ""."""
    age_s = now_s - tip.taken_s
    if age_s > config.tip_age_s:
        return f"the manipulator is silent: its last position is {1000 * age_s:.0f} ms old"
    return ""


def arm_refusal(
    tip: TipReading | None, limits: Limits, calibration: Calibration, vessel: VesselMap, recorder_fault: str
) -> str:
    """Return why the rig must not be armed, or ""."""
    if tip is None:
        return "the manipulator has not reported a position yet"
    if calibration.critical_height_um <= 0:
        return "the critical height is not calibrated: run the height calibration first"
    at = (tip.position.x_um, tip.position.y_um, tip.position.z_um)
    for axis, value, low, high in zip(
        "xyz", at, limits.workspace_min_um, limits.workspace_max_um, strict=True
    ):
        if not low <= value <= high:
            return (
                f"the tip's {axis} = {value:.0f} µm is outside {low:.0f}..{high:.0f}: re-zero the manipulator"
            )
    height_um = calibration.height_um(tip.position)
    if height_um < calibration.critical_height_um:
        return f"the magnet is below its critical height ({height_um:.0f} µm): raise it by hand first"
    stray_um = outside_um(tip.position, limits, calibration, vessel)
    if stray_um > _ARM_WITHIN_UM:
        return (
            f"the magnet is {stray_um:.0f} µm from where it may move: raise it or bring it over the vessel"
            " by hand first"
        )
    return recorder_fault


def track_refusal(track: Track | None, seen: Track | None, config: GuardConfig, now_s: float) -> str:
    """Return why the tracker does not allow AUTO, or "".

    Args:
        track: The newest track.
        seen: The newest track with a position.
        config: Deadlines.
        now_s: Now.
    """
    if track is None or seen is None:
        return "the robot has not been seen yet"
    if track.state is TrackState.SEARCHING:
        return "the robot is lost: bring it into view"
    age_s = now_s - seen.taken_s
    if age_s > config.track_age_s:
        return f"the robot was last seen {1000 * age_s:.0f} ms ago"
    if track.state is TrackState.ACQUIRING:
        return "the robot was just found: waiting for ten good frames"
    return ""


def coupling_refusal(lead_um: float | None, config: GuardConfig) -> str:
    """Return why robot and magnet do not move together, or ""."""
    if lead_um is not None and lead_um > config.lead_um:
        return f"the robot was left behind: {lead_um:.0f} µm from where the magnet holds it"
    return ""
