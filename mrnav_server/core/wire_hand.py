"""The hand link's messages: lines from a headset to records, and the server's answers (docs/protocol.md)."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from mrnav_server.core.errors import WireError
from mrnav_server.core.frames import HandPoint
from mrnav_server.core.wire import Fields, encode_line

HAND_PROTOCOL_VERSION = 1
MAX_RATE_HZ = 120.0
_REACH_M = 100.0
_LONGEST_CLOCK_S = 1e10


class ClientFrame(Enum):
    """The axes in which a client reports the hand; it declares them once."""

    UNITY = "unity"
    """Left-handed: x right, y up, z forward."""
    WEBXR = "webxr"
    """Right-handed: x right, y up, z back."""
    STAGE = "stage"
    """The stage as the operator sees it from above: x right, y towards the operator, z up."""

    def hand_point(self, xyz_m: tuple[float, float, float]) -> HandPoint:
        """Return a point, or a difference of two, of this frame in the hand frame."""
        x_m, y_m, z_m = xyz_m
        match self:
            case ClientFrame.UNITY:
                return HandPoint(x_m, y_m, -z_m)
            case ClientFrame.WEBXR:
                return HandPoint(x_m, y_m, z_m)
            case ClientFrame.STAGE:
                return HandPoint(x_m, z_m, y_m)


@dataclass(frozen=True, slots=True)
class Hello:
    """The first line of a client.

    Attributes:
        role: What it wants to be, "viewer" or "operator".
        token: Its secret.
        client: Its name, for people.
        frame: The axes of its positions.
        rate_hz: How often it wants the twin, 1 to 120 Hz.
        simulated: Whether a model stands in for the operator.
        model: Name of that model; "" for a person.
        seed: Seed of that model.
    """

    role: str
    token: str
    client: str
    frame: ClientFrame
    rate_hz: float
    simulated: bool
    model: str = ""
    seed: int | None = None


@dataclass(frozen=True, slots=True)
class HandMessage:
    """Where the fingertip is.

    Attributes:
        seq: Rises with every message of a connection.
        t_s: The sender's own monotonic clock, in seconds.
        point: Cumulative position.
        clutch: Whether the operator's clutch is closed.
        valid: Whether the headset sees the hand.
        pose: Number of the tracker's pose; a repeated one is no motion. None if the client numbers none.
    """

    seq: int
    t_s: float
    point: HandPoint
    clutch: bool
    valid: bool
    pose: int | None = None


@dataclass(frozen=True, slots=True)
class Increment:
    """How far the fingertip moved since the message before.

    Attributes:
        seq, t_s, clutch, valid: As in HandMessage.
        step: Difference of two positions.
    """

    seq: int
    t_s: float
    step: HandPoint
    clutch: bool
    valid: bool


@dataclass(frozen=True, slots=True)
class Ping:
    """Asks for the server's time; ``t_s`` is the sender's own clock, in seconds."""

    t_s: float


@dataclass(frozen=True, slots=True)
class ScaleChoice:
    """Asks for "coarse" or "fine" motion; ``scale`` is as the client wrote it."""

    scale: str


def parse_hello(line: bytes) -> Hello:
    """Read a client's first line.

    Raises:
        WireError: ``hello_first`` for another message, ``bad_version``, or what is wrong with a field.
    """
    fields = Fields(line)
    if fields.text("type") != "hello":
        raise WireError("hello_first", "the first line must be a hello")
    # Another version may have other fields, so it is looked at first.
    version = fields.whole("v")
    if version != HAND_PROTOCOL_VERSION:
        raise WireError("bad_version", f"this server speaks version {HAND_PROTOCOL_VERSION}, not {version}")
    role = fields.text("role")
    if role not in ("viewer", "operator"):
        raise WireError("bad_message", "role must be viewer or operator")
    frame = fields.text("frame")
    if frame not in _FRAMES:
        raise WireError("bad_message", f"frame must be one of {', '.join(_FRAMES)}")
    hello = Hello(
        role=role,
        token=fields.text("token", max_chars=256),
        client=fields.text("client"),
        frame=_FRAMES[frame],
        rate_hz=fields.number("rate_hz", 1.0, MAX_RATE_HZ),
        simulated=fields.flag("simulated"),
        model=fields.text("model") if fields.has("model") else "",
        seed=fields.whole("seed") if fields.has("seed") else None,
    )
    fields.finish()
    return hello


def parse_message(line: bytes, frame: ClientFrame) -> HandMessage | Increment | Ping | ScaleChoice:
    """Read a line that follows the hello.

    Args:
        line: One line, with or without its newline.
        frame: What the client declared; positions come out in the hand frame.

    Raises:
        NumberError: If a number is not finite or out of range: the peer may stay.
        WireError: If anything else is wrong: the peer breaks the protocol.
    """
    fields = Fields(line)
    message: HandMessage | Increment | Ping | ScaleChoice
    kind = fields.text("type")
    match kind:
        case "hand":
            message = HandMessage(
                seq=fields.whole("seq"),
                t_s=_clock_s(fields),
                point=frame.hand_point(fields.vector("p", _REACH_M)),
                clutch=fields.flag("clutch"),
                valid=fields.flag("valid"),
                pose=fields.whole("pose") if fields.has("pose") else None,
            )
        case "increment":
            message = Increment(
                seq=fields.whole("seq"),
                t_s=_clock_s(fields),
                step=frame.hand_point(fields.vector("d", _REACH_M)),
                clutch=fields.flag("clutch"),
                valid=fields.flag("valid"),
            )
        case "ping":
            message = Ping(_clock_s(fields))
        case "scale":
            message = ScaleChoice(fields.text("scale"))
        case _:
            raise WireError("bad_message", "type must be hand, increment, ping or scale")
    fields.finish()
    return message


def welcome_line(
    session: str, lease: bool, limits: Mapping[str, float], transform: Mapping[str, object]
) -> bytes:
    """Return the answer to a good hello."""
    return encode_line(
        {
            "type": "welcome",
            "v": HAND_PROTOCOL_VERSION,
            "session": session,
            "lease": lease,
            "limits": dict(limits),
            "transform": dict(transform),
        }
    )


def lease_line(lease: bool, code: str, message: str) -> bytes:
    """Return what tells a hand that it lost the rig's seat, did not get it, or has it again."""
    return encode_line({"type": "lease", "lease": lease, "code": code, "message": message})


def error_line(code: str, message: str) -> bytes:
    """Return the last line to a peer that is dropped."""
    return encode_line({"type": "error", "code": code, "message": message})


def pong_line(t_s: float, t_server_s: float) -> bytes:
    """Return the answer to a ping; both times in seconds, each on its own clock."""
    return encode_line({"type": "pong", "t": t_s, "t_server": t_server_s})


def scale_line(scale: str, refusal: str) -> bytes:
    """Return the answer to a choice of scale: which one was asked for, and why not if it was refused."""
    return encode_line({"type": "scale", "scale": scale, "ok": not refusal, "message": refusal})


def _clock_s(fields: Fields) -> float:
    return fields.number("t", -_LONGEST_CLOCK_S, _LONGEST_CLOCK_S)


_FRAMES = {frame.value: frame for frame in ClientFrame}
