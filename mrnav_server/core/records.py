"""What crosses layers. Every record carries when it was taken, on the monotonic clock."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from mrnav_server.core.arrays import ByteArray
from mrnav_server.core.frames import ImagePoint, StagePoint, VesselPoint
from mrnav_server.core.modes import Mode, Severity


@dataclass(frozen=True, slots=True)
class Frame:
    """One camera picture.

    Attributes:
        number: Counts the camera's frames from 0; a gap is a dropped frame.
        taken_s: Capture time (not arrival), monotonic, in seconds.
        image: Shape (height, width, 3), BGR, uint8. Readers must not write to it.
    """

    number: int
    taken_s: float
    image: ByteArray


class TrackState(Enum):
    """What the tracker says of its own answer."""

    SEARCHING = "searching"
    """No robot was found yet, or it was lost: re-detection runs."""
    ACQUIRING = "acquiring"
    """Found, but not yet for ten good frames in a row."""
    TRACKING = "tracking"


@dataclass(frozen=True, slots=True)
class Track:
    """Where the robot was seen.

    Attributes:
        taken_s: Capture time of the frame, monotonic, in seconds.
        frame_number: The frame's number.
        state: What the tracker says of its own answer.
        image: Robot's centre in the image; None while searching, or when this frame was rejected.
        vessel: The same in the vessel's grid.
        confidence: Share of rim rays that agree times edge strength, 0..1; 0 when rejected.
        sigma_um: Standard deviation of the position, in µm.
        good_frames: Accepted frames in a row.
    """

    taken_s: float
    frame_number: int
    state: TrackState
    image: ImagePoint | None
    vessel: VesselPoint | None
    confidence: float
    sigma_um: float
    good_frames: int


@dataclass(frozen=True, slots=True)
class TipReading:
    """Where the manipulator says its tip is.

    Attributes:
        taken_s: When the position was true, monotonic, in seconds.
        position: The magnet's centre in the stage frame.
        moving: Whether the device says that it moves.
    """

    taken_s: float
    position: StagePoint
    moving: bool


@dataclass(frozen=True, slots=True)
class MotionCommand:
    """What a manipulator was really sent.

    Attributes:
        sent_s: Monotonic, in seconds.
        target: Absolute target after the driver's own limits and rounding.
        speed_um_per_s: Speed of the move.
    """

    sent_s: float
    target: StagePoint
    speed_um_per_s: float


@dataclass(frozen=True, slots=True)
class CriticalArea:
    """A place where autonomy hands over to the operator.

    Attributes:
        id: Server-made, for example ``"area-1"``.
        center: In the vessel's grid.
        epsilon_um: Radius within which the task counts as arrived, in µm.
        label: Free text.
    """

    id: str
    center: VesselPoint
    epsilon_um: float
    label: str = ""


@dataclass(frozen=True, slots=True)
class LeaseState:
    """Who controls the rig.

    Attributes:
        epoch: Rises at every change of holder.
        holder: Session that holds the lease (the hand if there is one); None when it is free.
        console: Session of the page that shares the lease; None without one.
        client: The holders' own names, for people.
        hand: Whether a hand link belongs to the lease.
    """

    epoch: int
    holder: str | None
    console: str | None
    client: str
    hand: bool


@dataclass(frozen=True, slots=True)
class Percentiles:
    """A latency over the last seconds, in milliseconds."""

    p50: float
    p99: float


@dataclass(frozen=True, slots=True)
class RigState:
    """The whole rig at one control step: what twin clients see and the recorder keeps.

    Attributes:
        seq: Counts published states.
        t_s: When, monotonic, in seconds.
        tip: The reported tip; None before the manipulator is open.
        setpoint: What the shaper wants the tip to be; None while disarmed.
        tip_px: Where the tip appears in the image.
        track: The newest track; None before the first frame.
        track_age_ms: Age of that track by capture time.
        mode, severity, reason: The mode in force and why, in plain words; reason is "" when nothing is wrong.
        authority: Share of the motion that the operator commands, 0 (policy) .. 1 (hand).
        lease: Who controls the rig.
        clutch: Whether the operator's clutch is closed.
        auto_ready: Whether ``start_auto`` would be accepted now.
        auto_refusal: If not, why, in plain words.
        time_to_handover_s: Estimate while in AUTO, else None.
        critical_area: The active area's id.
        distance_um: Robot to the active area's centre; None if either is unknown.
        lead_um: How far the magnet's hold point runs ahead of the robot; None if the robot is not seen.
        collisions: Wall contacts seen since the trial (or the arming) began.
        path: Planned path in vessel grid pixels, shape (n, 2), thinned for display.
        latency_ms: Percentiles by name: hand_to_command, frame_to_twin, tick.
        rates_hz: Measured rates by name: camera, hand, hand_poses, tick.
        hand: scale ("coarse" or "fine"), gain (τ), messages_hz and poses_hz.
        counters: Counts by name, for example non_finite, stale, shielded.
        trial: Id of the running trial; None without one.
        tip_seen_px: Where the tip was seen in the image at the last look; None if it was not.
        tip_off_um: How far that was from where the calibration puts it, at the tip's height.
        learned: What autonomy has learnt of magnet and robot: ``offset_um`` [x, y] along the vessel's axes,
            ``friction_lead_um`` and ``looks``, the camera frames behind them.
    """

    seq: int
    t_s: float
    tip: StagePoint | None
    setpoint: StagePoint | None
    tip_px: ImagePoint | None
    track: Track | None
    track_age_ms: float
    mode: Mode
    severity: Severity
    reason: str
    authority: float
    lease: LeaseState
    clutch: bool
    auto_ready: bool
    auto_refusal: str
    time_to_handover_s: float | None
    critical_area: str | None
    distance_um: float | None
    lead_um: float | None
    collisions: int
    path: tuple[tuple[float, float], ...]
    latency_ms: dict[str, Percentiles]
    rates_hz: dict[str, float]
    hand: dict[str, str | float]
    counters: dict[str, int]
    trial: str | None
    tip_seen_px: ImagePoint | None = None
    tip_off_um: float | None = None
    learned: Mapping[str, object] = field(default_factory=dict)
