"""Every message of ``/ws/twin`` by its fields, and their JSON Schema (docs/protocol.md).

The pages' types are made from this schema; tests hold it against what the server really sends.
"""

from functools import cache
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter
from pydantic.json_schema import SkipJsonSchema

from mrnav_server.app.schemas import TwinMessage
from mrnav_server.core.modes import Mode
from mrnav_server.core.records import TrackState

PATH = "/api/v1/twin.schema.json"
Pair = tuple[float, float]
Triple = tuple[float, float, float]
AffineRows = tuple[Triple, Triple]
SeverityName = Literal["NONE", "WARN", "HOLD", "FAULT", "STOP"]


class _Message(BaseModel):
    model_config = ConfigDict(use_attribute_docstrings=True, frozen=True)


class VesselPoint(_Message):
    """In the vessel's grid."""

    x_px: float
    y_px: float


class CriticalArea(_Message):
    """A place where autonomy hands over to the operator."""

    id: str
    center: VesselPoint
    epsilon_um: float
    label: str
    active: bool
    visited: bool
    """Whether autonomy has arrived there."""


class Policy(_Message):
    """A navigation policy that is installed."""

    name: str
    kind: str
    verified: bool
    """Whether it may be used with this vessel model."""
    reason: str
    """If not, why."""


class Lease(_Message):
    """Who controls the rig."""

    epoch: int
    """Rises at every change of holder."""
    holder: str | None
    """Seat of the hand if there is one, else of the console."""
    console: str | None
    """Seat of the page that controls the rig."""
    client: str
    """The holders' own names."""
    hand: bool
    """Whether the holder has a live hand link."""


class Percentiles(_Message):
    """In milliseconds."""

    p50: float
    p99: float


class Track(_Message):
    """What the tracker says of the robot."""

    state: TrackState
    confidence: float
    """0..1."""
    age_ms: float
    sigma_um: float | None
    """Standard deviation of the position."""


class Learned(_Message):
    """What autonomy has learnt of magnet and robot."""

    offset_um: Pair
    """Along the vessel's axes."""
    friction_lead_um: float
    looks: int
    """Camera frames behind the two."""


class HandState(_Message):
    """How far the tip goes for the hand's motion, and how often the hand is heard."""

    scale: Literal["coarse", "fine"]
    gain: float
    messages_hz: float
    poses_hz: float


class Latencies(_Message):
    """Over the last seconds."""

    hand_to_command: Percentiles
    frame_to_twin: Percentiles
    tick: Percentiles


class Rates(_Message):
    """Over the last seconds."""

    camera: float
    hand: float
    hand_poses: float
    tick: float


class State(_Message):
    """The whole rig at one control step."""

    type: Literal["state"]
    seq: int
    """Counts published states."""
    t: float
    """When, on the server's monotonic clock, in seconds."""
    tip_um: Triple | None
    """Where the magnet is."""
    setpoint_um: Triple | None
    """Where the magnet should be; null while disarmed."""
    tip_px: Pair | None
    """Where the magnet appears in the image."""
    tip_seen_px: Pair | None
    """Where the magnet was seen in the image at the last look."""
    tip_off_um: float | None
    """How far that was from tip_px."""
    learned: Learned
    robot_um: Pair | None
    """On the stage."""
    robot_px: Pair | None
    """In the image."""
    robot_vessel_px: Pair | None
    """In the vessel's grid."""
    track: Track
    mode: Mode
    severity: SeverityName
    reason: str
    """Why, in plain words; "" when nothing is wrong."""
    authority: float
    """Share of the motion that the hand commands, 0..1."""
    lease: Lease
    clutch: bool
    hand: HandState
    auto_ready: bool
    auto_refusal: str
    """If AUTO would not be granted, why."""
    time_to_handover_s: float | None
    critical_area: str | None
    """Id of the active area."""
    distance_um: float | None
    """Robot to the active area's centre."""
    lead_um: float | None
    """How far the magnet's hold point runs ahead of the robot."""
    collisions: int
    """Wall contacts since the trial, or the arming, began."""
    path: Annotated[list[Pair], Field(max_length=64)]
    """Planned path in the vessel's grid."""
    latency_ms: Latencies
    rates_hz: Rates
    counters: dict[str, int]
    trial: str | None
    """Id of the running trial."""


class RigName(_Message):
    """What stands here."""

    simulated: bool
    name: str


class Vessel(_Message):
    """The vessel model in use."""

    name: str
    size_px: int
    um_per_px: float
    robot_radius_um: float
    suggested_areas: list[VesselPoint]


class FloorMap(_Message):
    """The camera's whole map of the vessel's floor, where it is not affine."""

    homography: tuple[Triple, Triple, Triple]
    center_px: Pair
    radial: float
    radius_px: float


class Calibration(_Message):
    """How camera, vessel and stage see each other; rows of the affine maps are [a, b, tx], [c, d, ty]."""

    image_from_vessel: AffineRows
    stage_from_vessel: AffineRows
    um_per_px: float
    floor_z_um: float
    magnet_offset_um: Pair
    critical_height_um: float
    floor_map: FloorMap | None


class Camera(_Message):
    """The camera's pictures."""

    width_px: int
    height_px: int
    fps: float
    format: str
    """What a camera or film really gives, in words; "" where nothing more is known."""


class Snapshot(_Message):
    """The first message: all that later states refer to."""

    type: Literal["snapshot"]
    v: Literal[1]
    session: str
    """This connection's secret, for the header of REST requests."""
    seat: str
    """The name under which others see this connection, as in `lease`."""
    role: Literal["viewer", "operator"]
    chief: bool
    """Whether this connection may take control from another operator."""
    rig: RigName
    vessel: Vessel
    calibration: Calibration
    limits: dict[str, float | None]
    """By name, units in the names."""
    camera: Camera
    policies: list[Policy]
    critical_areas: list[CriticalArea]
    state: State | None
    """Null before the first control step."""


class _Event(_Message):
    type: Literal["event"]
    t: float
    """When, on the server's monotonic clock, in seconds."""


class ModeEvent(_Event):
    """The mode has changed."""

    event: Literal["mode"]
    before: Mode
    mode: Mode
    reason: str


class HandoverAnnounced(_Event):
    """The operator will take over soon."""

    event: Literal["handover_announced"]
    in_s: float
    distance_um: float | None


class Handover(_Event):
    """Autonomy has handed over to the operator."""

    event: Literal["handover"]
    by: Literal["arrival", "takeover"]
    distance_um: float | None


class Contact(_Event):
    """The robot touched a wall."""

    event: Literal["contact"]
    mode: Mode
    count: int


class Fault(_Event):
    """Something is wrong."""

    event: Literal["fault"]
    reason: str


class Recovered(_Event):
    """Something that was wrong is right again."""

    event: Literal["recovered"]
    reason: str


class AreasEvent(_Event):
    """The critical areas have changed."""

    event: Literal["areas"]
    critical_areas: list[CriticalArea]
    """In the order of their visits."""
    next: str | None
    """The one to which AUTO goes if none is named."""


class LeaseEvent(_Event):
    """Another controls the rig."""

    event: Literal["lease"]
    epoch: int
    client: str
    reason: str = ""


class HandEvent(_Event):
    """The hand's scale was chosen."""

    event: Literal["hand"]
    scale: Literal["coarse", "fine"]
    gain: float


class VesselPose(_Message):
    """Where the vessel model lies, relative to where the calibration has it."""

    dx_um: float
    dy_um: float
    turn_deg: float


class RegistrationEvent(_Event):
    """The vessel was registered."""

    event: Literal["registration"]
    pose: VesselPose
    by: Literal["auto", "hand"]
    overlap: float | None
    overlap_by: Literal["lumen", "wall"]
    residual_um: float | None
    calibration: Calibration
    """What holds from now on."""


class CalibrationEvent(_Event):
    """Another calibration holds."""

    event: Literal["calibration"]
    file: str
    calibration: Calibration
    """What holds from now on."""


class TrialStart(_Event):
    """A trial began."""

    event: Literal["trial"]
    mark: Literal["start"]
    id: str


class TrialMark(_Event):
    """First motion (`go`), or the end of a dwell in the target (`reached`)."""

    event: Literal["trial"]
    mark: Literal["go", "reached"]
    t_s: float
    """When it was so, on the server's monotonic clock."""


class SimulatedTruth(_Message):
    """What the simulator knows of a trial."""

    collisions: int
    lifted: bool


class TrialEnd(_Event):
    """A trial ended."""

    event: Literal["trial"]
    mark: Literal["end"]
    id: str
    collisions: int
    collisions_in_auto: int
    reached_s: float | None
    final_distance_um: float | None
    latency_ms: dict[str, Percentiles]
    simulated: bool
    video: dict[str, Any] | SkipJsonSchema[None] = None
    """The film, if there is one."""
    simulated_truth: SimulatedTruth | SkipJsonSchema[None] = None
    """Only on a simulated rig."""


class VesselChanging(_Event):
    """Another vessel model takes the place of this one: the link breaks, and comes back to it."""

    event: Literal["vessel_changing"]
    vessel: str


class RigStopped(_Event):
    """The server ends; the rig comes to rest first."""

    event: Literal["rig_stopped"]
    mode: Mode


class Answer(_Message):
    """The answer to an ask, in the order of the asks."""

    type: Literal["answer"]
    ok: bool
    code: str
    message: str


class HandTransform(_Message):
    """How the rig maps the hand's motion."""

    gain: float
    fine_gain: float
    vertical_gain: float


class HandLease(_Message):
    """Whether this page is the rig's hand."""

    type: Literal["lease"]
    lease: bool
    code: str
    message: str
    transform: HandTransform | SkipJsonSchema[None] = None
    """Only when it just became it."""


class HandMessage(_Message):
    """Where the fingertip is, from a page that has taken the hand's seat."""

    model_config = ConfigDict(extra="forbid")

    type: Literal["hand"]
    seq: Annotated[int, Field(ge=0)]
    """Rises with every message of the connection."""
    t: float
    """The sender's own monotonic clock, in seconds."""
    p: Triple
    """Cumulative position in metres."""
    clutch: bool
    valid: bool
    """Whether the hand is seen."""
    pose: Annotated[int, Field(ge=0)] | SkipJsonSchema[None] = None
    """Number of the tracker's pose; a repeated one is no motion."""


TwinEvent = (
    ModeEvent
    | HandoverAnnounced
    | Handover
    | Contact
    | Fault
    | Recovered
    | AreasEvent
    | LeaseEvent
    | HandEvent
    | RegistrationEvent
    | CalibrationEvent
    | TrialStart
    | TrialMark
    | TrialEnd
    | VesselChanging
    | RigStopped
)
_UNIONS = {
    "TwinEvent": TypeAdapter[Any](TwinEvent),
    "ServerMessage": TypeAdapter[Any](Snapshot | State | TwinEvent | Answer | HandLease),
    "ClientMessage": TypeAdapter[Any](TwinMessage | HandMessage),
}


@cache
def twin_schema() -> dict[str, Any]:
    """Return the JSON Schema of the messages of both directions, in version 1.

    A receiver must ignore fields and events that it does not know, so the server's messages may have more.
    """
    unions, shared = TypeAdapter.json_schemas(
        [(name, "validation", adapter) for name, adapter in _UNIONS.items()],
        ref_template="#/$defs/{model}",
    )
    definitions = dict(shared["$defs"])
    definitions |= {name: unions[name, "validation"] for name in _UNIONS}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": PATH,
        "title": "Messages of /ws/twin, version 1",
        "anyOf": [{"$ref": "#/$defs/ServerMessage"}, {"$ref": "#/$defs/ClientMessage"}],
        "$defs": definitions,
    }
