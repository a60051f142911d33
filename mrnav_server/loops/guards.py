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
        position_min_um: A position below this on any axis means that the manipulator lost its zero.
        position_max_um: A position above this does too.
        off_target_um: On each axis the tip lies between the targets of the last moments, to within this; it
            never rests further than this from its target.
        off_target_s: How long those last moments are, 0.1 to 0.2 s: what a manipulator may lag behind.
        following_error_um: The tip may be further than this ...
        following_lag_s: ... from every target of this time ...
        following_s: ... for no longer than this.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, never changed

    track_age_s: float = 0.1
    console_s: float = 0.5
    lead_um: float = 3000.0
    tip_age_s: float = 0.1
    position_min_um: float = -200.0
    position_max_um: float = 20_200.0
    off_target_um: float = 25.0
    off_target_s: float = 0.16
    following_error_um: float = 200.0
    following_lag_s: float = 0.06
    following_s: float = 0.2

    def __post_init__(self) -> None:
        if not 0.1 <= self.off_target_s <= 0.2:
            raise ValueError("off_target_s must lie between 0.1 and 0.2 s")
        if not 5.0 <= self.off_target_um <= 200.0:
            raise ValueError("off_target_um must lie between 5 and 200 µm")
        if not self.position_min_um < self.position_max_um:
            raise ValueError("position_min_um must be less than position_max_um")


def tip_fault(tip: TipReading, config: GuardConfig, now_s: float) -> str:
    """Return why the tip's position cannot be relied on, or ""."""
    age_s = now_s - tip.taken_s
    if age_s > config.tip_age_s:
        return f"the manipulator is silent: its last position is {1000 * age_s:.0f} ms old"
    for axis, at_um in zip("XYZ", (tip.position.x_um, tip.position.y_um, tip.position.z_um), strict=True):
        if not config.position_min_um <= at_um <= config.position_max_um:
            return (
                f"the manipulator's zero calibration is lost: it reads {axis} = {at_um:.0f} µm; calibrate it"
                " on its touch screen"
            )
    return ""


def arm_refusal(tip: TipReading | None, limits: Limits, calibration: Calibration, vessel: VesselMap) -> str:
    """Return why the tip must not be set in motion from where it is, or ""."""
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
    if tip.moving:
        return "the tip still moves: wait until it rests"
    stray_um = outside_um(tip.position, limits, calibration, vessel)
    if stray_um > _ARM_WITHIN_UM:
        return (
            f"the magnet is {stray_um:.0f} µm from where it may move: raise it or bring it over the vessel"
            " by hand first"
        )
    return ""


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
