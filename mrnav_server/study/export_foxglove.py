"""What Foxglove draws of a trial: robot, tip, vessel and critical area, the events as a log, and the film."""

import base64
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.film_index import film_frames, film_picture
from mrnav_server.study.export_rows import Row, TrialRows, wall_ns
from mrnav_server.vision.vessel_outline import walls_px

Message = tuple[str, str, int, dict[str, Any]]
"""Channel, schema, wall time in ns, fields."""

_INFO, _WARNING, _ERROR = 2, 3, 4
_LIGHT = {"r": 0.85, "g": 0.87, "b": 0.9, "a": 1.0}
_DARK = {"r": 0.15, "g": 0.17, "b": 0.2, "a": 1.0}
_GREEN = {"r": 0.0, "g": 0.62, "b": 0.45, "a": 0.5}
_LINE_LOOP = 1
_LINE_PX = 2.0
_UPRIGHT = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
_M_PER_UM = 1e-6


@dataclass(frozen=True, slots=True)
class Drawing:
    """What is drawn beside a trial's rows.

    Attributes:
        vessel: Its vessel model; None if it is not at hand, or another than the trial's.
        film: Its film; None to leave it out.
    """

    vessel: VesselMap | None = None
    film: Path | None = None


@dataclass(frozen=True, slots=True)
class _Space:
    """Where everything is drawn, in metres: the stage's frame, or the vessel's without a calibration."""

    frame: str
    matrix: list[list[float]]
    z_um: float

    def point(self, x_px: float, y_px: float) -> dict[str, float]:
        x_um, y_um = (a * x_px + b * y_px + t for a, b, t in self.matrix)
        return _point(x_um, y_um, self.z_um)


def foxglove_messages(trial: TrialRows, drawing: Drawing) -> Iterator[Message]:
    """Yield everything that Foxglove draws, each kind in the order of time."""
    space = _space(trial)
    if not trial.messages:
        return
    first_ns = wall_ns(trial.messages[0][1])
    yield _scene(first_ns, space, "model", _model(trial, drawing, space))
    yield _log(first_ns, _INFO, "trial", _origin(trial))
    for topic, row in trial.messages:
        stamp_ns = wall_ns(row)
        if topic.name == "track" and row["vessel_x_px"] is not None:
            place = space.point(row["vessel_x_px"], row["vessel_y_px"])
            yield _pose("foxglove/robot", stamp_ns, space.frame, place)
            yield _scene(stamp_ns, space, "robot", _robot(drawing, place))
        elif topic.name == "step" and row["tip_x_um"] is not None and space.frame == "stage":
            tip = _point(row["tip_x_um"], row["tip_y_um"], row["tip_z_um"])
            yield _pose("foxglove/tip", stamp_ns, space.frame, tip)
        elif (said := _said(topic.name, row)) is not None:
            yield _log(stamp_ns, said[0], topic.name, said[1])
    if drawing.film is not None:
        # The film's stamps are the server's monotonic clock, as the log's are.
        row = trial.messages[0][1]
        offset_ns = round(row["logged_epoch_s"] * 1e9) - row["logged_mono_ns"]
        yield from _film(drawing.film, offset_ns)


def _space(trial: TrialRows) -> _Space:
    calibration = trial.header["calibration"]
    matrix = calibration.get("stage_from_vessel")
    if matrix is None:
        scale = trial.header["um_per_px"]
        return _Space("vessel", [[scale, 0.0, 0.0], [0.0, scale, 0.0]], 0.0)
    return _Space("stage", matrix, float(calibration.get("floor_z_um") or 0.0))


def _model(trial: TrialRows, drawing: Drawing, space: _Space) -> dict[str, Any]:
    """Return the walls, the critical area, and whose trial it is, in words."""
    drawn: dict[str, Any] = {}
    if drawing.vessel is not None:
        drawn["lines"] = [
            {
                "type": _LINE_LOOP,
                "pose": _posed(_point(0.0, 0.0, 0.0)),
                "thickness": _LINE_PX,
                "scale_invariant": True,
                "points": [space.point(*corner) for corner in wall],
                "color": _LIGHT,
                "colors": [],
                "indices": [],
            }
            for wall in walls_px(drawing.vessel)
        ]
    area_px, epsilon_um = trial.header["area_px"], trial.header["area_epsilon_um"]
    if area_px is not None and epsilon_um is not None:
        across_m = 2.0 * epsilon_um * _M_PER_UM
        drawn["cylinders"] = [
            {
                "pose": _posed(space.point(*area_px)),
                "size": {"x": across_m, "y": across_m, "z": across_m / 50.0},
                "bottom_scale": 1.0,
                "top_scale": 1.0,
                "color": _GREEN,
            }
        ]
    drawn["texts"] = [
        {
            "pose": _posed(space.point(0.0, 0.0)),
            "billboard": True,
            "font_size": 14.0,
            "scale_invariant": True,
            "color": _LIGHT,
            "text": _origin(trial),
        }
    ]
    return drawn


def _robot(drawing: Drawing, place: dict[str, float]) -> dict[str, Any]:
    vessel = drawing.vessel
    radius_um = vessel.robot_radius_px * vessel.um_per_px if vessel else 500.0
    across_m = 2.0 * radius_um * _M_PER_UM
    size = dict.fromkeys("xyz", across_m)
    return {"spheres": [{"pose": _posed(place), "size": size, "color": _DARK}]}


def _origin(trial: TrialRows) -> str:
    labels = trial.labels
    rig = "a simulated rig" if labels["simulated_rig"] else "hardware"
    if labels["operator_kind"] == "simulated":
        return f"{trial.id}: simulated operator {labels['participant']} on {rig}: no evidence about people"
    return f"{trial.id}: participant {labels['participant']} on {rig}"


def _said(topic: str, row: Row) -> tuple[int, str] | None:
    """Return level and words of what is no measurement; None for all else."""
    reason = row.get("reason") or ""
    tail = f": {reason}" if reason else ""
    match topic:
        case "mode":
            level = _WARNING if row["mode"] in ("HOLD", "FAULT", "STOP") else _INFO
            return level, f"{row['before']} → {row['mode']}{tail}"
        case "trial":
            return _INFO, str(row["mark"])
        case "event":
            return (_WARNING if row["event"] in ("fault", "contact") else _INFO), f"{row['event']}{tail}"
        case "ask" if row["refused"]:
            return _WARNING, f"{row['ask']} refused: {row['refused']}"
        case "fail" | "command_failed":
            return _ERROR, f"{topic}{tail}"
    return None


def _film(film: Path, offset_ns: int) -> Iterator[Message]:
    for frame in film_frames(film):
        stamp_ns = round(frame.taken_s * 1e9) + offset_ns
        data = base64.b64encode(film_picture(film, frame)).decode()
        fields = {"timestamp": _stamp(stamp_ns), "frame_id": "image", "data": data, "format": "jpeg"}
        yield "foxglove/film", "foxglove.CompressedImage", stamp_ns, fields


def _pose(channel: str, stamp_ns: int, frame: str, place: dict[str, float]) -> Message:
    fields = {"timestamp": _stamp(stamp_ns), "frame_id": frame, "pose": _posed(place)}
    return channel, "foxglove.PoseInFrame", stamp_ns, fields


def _scene(stamp_ns: int, space: _Space, name: str, drawn: dict[str, Any]) -> Message:
    empty: dict[str, Any] = {kind: [] for kind in _PRIMITIVES}
    entity = {
        "timestamp": _stamp(stamp_ns),
        "frame_id": space.frame,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": False,
        "metadata": [],
    }
    fields = {"deletions": [], "entities": [entity | empty | drawn]}
    return "foxglove/scene", "foxglove.SceneUpdate", stamp_ns, fields


def _log(stamp_ns: int, level: int, name: str, message: str) -> Message:
    stamp = _stamp(stamp_ns)
    fields = {"timestamp": stamp, "level": level, "message": message, "name": name, "file": "", "line": 0}
    return "foxglove/log", "foxglove.Log", stamp_ns, fields


def _posed(place: dict[str, float]) -> dict[str, Any]:
    return {"position": place, "orientation": _UPRIGHT}


def _point(x_um: float, y_um: float, z_um: float) -> dict[str, float]:
    return {"x": x_um * _M_PER_UM, "y": y_um * _M_PER_UM, "z": z_um * _M_PER_UM}


def _stamp(stamp_ns: int) -> dict[str, int]:
    return {"sec": stamp_ns // 10**9, "nsec": stamp_ns % 10**9}


def _object(**properties: object) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _list(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


_PRIMITIVES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
_NUMBER, _INTEGER, _TEXT, _FLAG = ({"type": name} for name in ("number", "integer", "string", "boolean"))
_TIME = _object(sec=_INTEGER, nsec=_INTEGER)
_XYZ = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_POSE = _object(position=_XYZ, orientation=_object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER))
_COLOR = _object(r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_SOLID = _object(pose=_POSE, size=_XYZ, color=_COLOR, bottom_scale=_NUMBER, top_scale=_NUMBER)
_ENTITY = _object(
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_TIME,
    frame_locked=_FLAG,
    metadata=_list(_object(key=_TEXT, value=_TEXT)),
    **{kind: _list(_object()) for kind in _PRIMITIVES},
)
_ENTITY["properties"] |= {
    "spheres": _list(_SOLID),
    "cylinders": _list(_SOLID),
    "lines": _list(
        _object(
            type=_INTEGER,
            pose=_POSE,
            thickness=_NUMBER,
            scale_invariant=_FLAG,
            points=_list(_XYZ),
            color=_COLOR,
            colors=_list(_COLOR),
            indices=_list(_INTEGER),
        )
    ),
    "texts": _list(
        _object(
            pose=_POSE, billboard=_FLAG, font_size=_NUMBER, scale_invariant=_FLAG, color=_COLOR, text=_TEXT
        )
    ),
}

SCHEMAS: dict[str, dict[str, Any]] = {
    "foxglove.Log": _object(
        timestamp=_TIME, level=_INTEGER, message=_TEXT, name=_TEXT, file=_TEXT, line=_INTEGER
    ),
    "foxglove.PoseInFrame": _object(timestamp=_TIME, frame_id=_TEXT, pose=_POSE),
    "foxglove.SceneUpdate": _object(
        deletions=_list(_object(timestamp=_TIME, type=_INTEGER, id=_TEXT)), entities=_list(_ENTITY)
    ),
    "foxglove.CompressedImage": _object(
        timestamp=_TIME,
        frame_id=_TEXT,
        data={"type": "string", "contentEncoding": "base64"},
        format=_TEXT,
    ),
}
"""Foxglove's own schemas by their names, as far as they are used here."""
