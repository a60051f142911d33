"""The tables of an export: which columns a topic of the log has, in which unit, and what they mean."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

Kind = Literal["float", "int", "bool", "text", "time", "json"]
"""``time`` is a moment by the wall clock; ``json`` is JSON text: of what has no fixed shape."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table.

    Attributes:
        name: With its unit as suffix.
        kind: Type of its values.
        unit: "" for what has none.
        meaning: In plain words.
    """

    name: str
    kind: Kind
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a log line's data.

    Attributes:
        key: Its name in the log.
        columns: One, or one for each number of a vector.
        optional: An empty cell says that the log lacks the field; else, that it is null there.
    """

    key: str
    columns: tuple[Column, ...]
    optional: bool = False

    @property
    def is_vector(self) -> bool:
        """Whether it holds several numbers."""
        return len(self.columns) > 1


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of the log.

    Attributes:
        name: As in the log.
        meaning: What a row is.
        fields: In the log's order.
        own_time: Field with the monotonic time in s at which it happened; "" for when it was logged.
    """

    name: str
    meaning: str
    fields: tuple[Field, ...] = ()
    own_time: str = ""

    @property
    def columns(self) -> tuple[Column, ...]:
        """All columns of the table."""
        place = PLACE if self.name == "track" else ()
        own = (column for field in self.fields for column in field.columns)
        return (*LABELS, *STAMPS, *place, *own, AS_LOGGED)


LABELS = (
    Column("trial", "text", "", "the trial's id"),
    Column("participant", "text", "", "code of the participant or of the simulated operator"),
    Column("condition", "text", "", "with_autonomy or without_autonomy"),
    Column("model", "text", "", "the vessel model"),
    Column("operator_kind", "text", "", "human or simulated; the two are never pooled"),
    Column("simulated_rig", "bool", "", "whether the rig was the simulator"),
)
STAMPS = (
    Column("seq", "int", "", "number of the log's line, from 1"),
    Column("t_s", "float", "s", "when it happened, monotonic, since the trial's start; before it negative"),
    Column("wall_time", "time", "UTC", "the same moment by the wall clock: a label, never a measure"),
    Column("logged_mono_ns", "int", "ns", "when the line was logged, by the server's monotonic clock"),
    Column("logged_epoch_s", "float", "s", "when the line was logged, Unix time"),
)
PLACE = (
    Column("x_um", "float", "µm", "the robot, along x of the vessel's grid; empty if not seen"),
    Column("y_um", "float", "µm", "the robot, along y of the vessel's grid, downwards; empty if not seen"),
)
AS_LOGGED = Column(
    "as_logged_json", "json", "", "the line's data whole, where the columns alone cannot say all of it"
)


def _one(
    name: str, kind: Kind, unit: str, meaning: str, key: str | None = None, *, optional: bool = False
) -> Field:
    return Field(name if key is None else key, (Column(name, kind, unit, meaning),), optional)


def _vector(
    key: str, names: tuple[str, ...], unit: str, meaning: str, kind: Kind = "float", *, optional: bool = False
) -> Field:
    columns = tuple(Column(f"{name}_{unit.replace('µ', 'u')}", kind, unit, meaning) for name in names)
    return Field(key, columns, optional)


def _xyz(before: str) -> tuple[str, ...]:
    return tuple(f"{before}{axis}" for axis in "xyz")


_MODE = _one("mode", "text", "", "the mode in force")
_REASON = _one("reason", "text", "", "why, in plain words", optional=True)
_EVENT = _one("event", "text", "", "what happened")
_TIP = (
    _one("tip_fault", "text", "", "why the tip could not be read", optional=True),
    _one("tip_taken_s", "float", "s", "when the tip was read, monotonic", optional=True),
    _vector("tip_um", _xyz("tip_"), "µm", "the tip on the stage, z up", optional=True),
    _one("tip_moving", "bool", "", "whether the manipulator said that it moves", optional=True),
)
_NOW = _one("now_s", "float", "s", "when, monotonic")

TOPICS = (
    Topic(
        "track",
        "what the tracker said of a picture",
        (
            _one("frame", "int", "", "number of the picture"),
            _one("taken_s", "float", "s", "middle of the exposure, monotonic"),
            _one("state", "text", "", "searching, acquiring or tracking"),
            _vector("image", ("image_x", "image_y"), "px", "the robot in the camera's picture"),
            _vector("vessel", ("vessel_x", "vessel_y"), "px", "the robot in the vessel's grid"),
            _one("confidence", "float", "", "0 to 1"),
            _one("sigma_um", "float", "µm", "standard deviation of the position"),
            _one("good_frames", "int", "", "pictures in a row in which it was seen"),
        ),
        "taken_s",
    ),
    Topic(
        "hand",
        "an accepted hand sample",
        (
            _one("hand_seq", "int", "", "the sender's number of the sample", "seq"),
            _one("sender_s", "float", "s", "the sender's own clock"),
            _one("received_s", "float", "s", "when it came, monotonic"),
            _vector("p_m", _xyz("hand_"), "m", "the hand in its own axes"),
            _one("clutch", "bool", "", "whether the clutch was closed: the hand moves the magnet"),
            _one("valid", "bool", "", "whether the hand was seen by the headset"),
            _one("new_pose", "bool", "", "whether it is not the pose of the sample before"),
        ),
        "received_s",
    ),
    Topic("hand_left", "the hand's connection ended"),
    Topic(
        "command",
        "a setpoint that went to the manipulator; all places on the stage, z up",
        (
            _one("sent_s", "float", "s", "when it was sent, monotonic"),
            _vector("setpoint_um", _xyz("setpoint_"), "µm", "where the tip should be now"),
            _vector("asked_um", _xyz("asked_"), "µm", "the target that was asked for"),
            _one("asked_um_per_s", "float", "µm/s", "the speed that was asked for"),
            _vector("target_um", _xyz("target_"), "µm", "the target that was sent, rounded by the driver"),
            _one("speed_um_per_s", "float", "µm/s", "the speed that was sent"),
            _one("ahead_ms", "float", "ms", "motion left from the setpoint to the target"),
            _MODE,
        ),
        "sent_s",
    ),
    Topic(
        "command_failed",
        "a setpoint that did not reach the manipulator",
        (
            _vector("setpoint_um", _xyz("setpoint_"), "µm", "where the tip should have been"),
            _one("reason", "text", "", "what the driver said"),
        ),
    ),
    Topic(
        "mode",
        "a change of mode",
        (
            _EVENT,
            _one("before", "text", "", "the mode before"),
            _one("mode", "text", "", "the mode from here on"),
            _one("reason", "text", "", "why, in plain words"),
        ),
    ),
    Topic(
        "trial",
        "a mark of the trial: start, go, reached, end",
        (
            _EVENT,
            _one("mark", "text", "", "start, go, reached or end"),
            _one("mark_s", "float", "s", "when it happened, monotonic", "t_s", optional=True),
            _one("id", "text", "", "the trial's id", optional=True),
        ),
        "t_s",
    ),
    Topic(
        "event",
        "what was announced: faults, contacts, hand-overs, areas",
        (
            _EVENT,
            _one("by", "text", "", "of a hand-over: arrival or takeover", optional=True),
            _one("in_s", "float", "s", "time left to the hand-over", optional=True),
            _one("distance_um", "float", "µm", "from the robot to the critical area", optional=True),
            replace(_MODE, optional=True),
            _one("count", "int", "", "wall contacts so far", optional=True),
            _REASON,
        ),
    ),
    Topic(
        "step",
        "a step of the control loop, and the tip reading that it went by",
        (_NOW, _one("by", "text", "", "tick, hand or ask"), *_TIP),
        "now_s",
    ),
    Topic(
        "ask",
        "a mode that was asked for",
        (
            _NOW,
            _one("ask", "text", "", "arm, disarm, manual, auto, hold, stop or reset"),
            _one("submitted", "bool", "", "whether it was to be carried out, and not only checked"),
            _one("refused", "text", "", "why not; empty text if it was granted"),
            *_TIP,
        ),
        "now_s",
    ),
    Topic(
        "area",
        "another critical area",
        (
            _one("within_step", "bool", "", "whether it was chosen within a step of the control loop"),
            _one("id", "text", "", "its id; empty for none"),
            _vector("center_px", ("center_x", "center_y"), "px", "in the vessel's grid", optional=True),
            _one("epsilon_um", "float", "µm", "its radius", optional=True),
            _one("label", "text", "", "what the operator called it", optional=True),
        ),
    ),
    Topic("fail", "a fault from outside the control loop", (_one("reason", "text", "", "in plain words"),)),
    Topic(
        "around",
        "what everybody outside the control loop said, whenever it changed; empty text: nothing to object",
        (
            *(
                _one(name, "text", "", meaning)
                for name, meaning in (
                    ("recorder_fault", "why the log cannot be relied on"),
                    ("supervisor_fault", "why nobody would stop the manipulator if the server died"),
                    ("camera_fault", "why the pictures must not be relied on"),
                    ("drift_warning", "that the vessel or the camera has moved"),
                    ("drift_fault", "the same, when it is too far for autonomy"),
                    ("device_warnings", "what the manipulator's driver says"),
                )
            ),
            _one("leased", "bool", "", "whether anybody controls the rig"),
            _one("hand_seated", "bool", "", "whether a hand belongs to the lease"),
            _one("console_heard", "bool", "", "whether the page was heard lately"),
        ),
    ),
    Topic(
        "learned",
        "what autonomy learnt of magnet and robot",
        (
            _vector("offset_um", ("offset_x", "offset_y"), "µm", "from the robot to where it would rest"),
            _one("friction_lead_um", "float", "µm", "lead that overcomes friction"),
            _one("looks", "int", "", "looks that this rests on"),
        ),
    ),
    Topic(
        "closed",
        "how the log ended",
        (
            _one("status", "text", "", "ended or interrupted"),
            _one("lost_lines", "int", "", "lines that could not be written; empty if unknown"),
        ),
    ),
    Topic("path", "a path that the planner delivered, whole as JSON"),
    Topic("settings", "the settings in force, without the tokens, whole as JSON"),
    Topic("state", "the control loop when the trial began, and the calibration, whole as JSON"),
)

TRIALS_TABLE = (
    *LABELS,
    Column("status", "text", "", "ended, interrupted, or running: the log was never closed"),
    Column("result", "bool", "", "whether it counts: it ended, and ended its step if there is a plan"),
    Column("reached", "bool", "", "whether the target was reached"),
    Column("start_time", "time", "UTC", "the trial's start by the wall clock"),
    Column("duration_s", "float", "s", "from the start to the log's last line"),
    Column("lines", "int", "", "lines of the log after its header"),
    Column("um_per_px", "float", "µm", "size of a pixel of the vessel's grid"),
    Column("area_x_px", "float", "px", "centre of the critical area in the vessel's grid"),
    Column("area_y_px", "float", "px", "centre of the critical area in the vessel's grid"),
    Column("area_epsilon_um", "float", "µm", "its radius"),
    Column("software_version", "text", "", "of the server"),
    Column("log_sha256", "text", "", "digest of the log's whole lines"),
    Column("header_json", "json", "", "the log's first line, as it stands there"),
    Column("tlx_json", "json", "", "the questionnaire's file; empty if there is none"),
)
"""Columns of the table ``trials``, a row a trial; what an import rebuilds a trial from."""

_BY_NAME = {topic.name: topic for topic in TOPICS}


def topic_named(name: str) -> Topic:
    """Return a topic; one that nothing is said of here has its data as JSON alone."""
    return _BY_NAME.get(name, Topic(name, "a topic that this version does not spread over columns"))


def tables() -> Iterator[tuple[str, str, tuple[Column, ...]]]:
    """Yield name, meaning and columns of every table that is described."""
    yield "trials", "a trial", TRIALS_TABLE
    for topic in TOPICS:
        yield topic.name, topic.meaning, topic.columns
