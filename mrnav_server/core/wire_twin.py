"""The digital twin's messages as plain dictionaries for JSON (docs/protocol.md).

Lengths are rounded to what a display can show, so that a state fits the hand link's 4096-byte line; a
number that is not finite becomes null.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from mrnav_server.core.camera_map import FloorMap
from mrnav_server.core.frames import Calibration, ImagePoint, StagePoint, VesselPoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import CriticalArea, Percentiles, RigState
from mrnav_server.core.vessel import VesselMap

TWIN_VERSION = 1
MAX_PATH_POINTS = 64


@dataclass(frozen=True, slots=True)
class RigCard:
    """What a client must know of the rig once.

    Attributes:
        name: For people.
        simulated: Whether what it shows comes from the simulator.
        vessel: The vessel model in use.
        calibration: How camera, vessel and stage see each other.
        limits: The motion limits by name, units in the names.
        picture: The camera's pictures.
        camera_format: What the camera really gives, in words; "" where nothing more is known.
    """

    name: str
    simulated: bool
    vessel: VesselMap
    calibration: Calibration
    limits: Mapping[str, float]
    picture: PictureFormat
    camera_format: str = ""


@dataclass(frozen=True, slots=True)
class PolicyCard:
    """A navigation policy as a client lists it.

    Attributes:
        name: Its folder's name.
        kind: For example "torchscript" or "geodesic".
        verified: Whether it may be used with this vessel model.
        reason: If not, why.
    """

    name: str
    kind: str
    verified: bool
    reason: str


def snapshot(
    session: str,
    role: str,
    rig: RigCard,
    policies: Sequence[PolicyCard],
    areas: Sequence[CriticalArea],
    state: RigState | None,
) -> dict[str, object]:
    """Return the first message of a twin client: all that later states refer to.

    Args:
        session: The client's session.
        role: "viewer" or "operator".
        rig: The rig.
        policies: Those that are installed.
        areas: Those that are marked; the active one is named by the state.
        state: The newest state; None before the first control step.
    """
    active = state.critical_area if state else None
    return {
        "type": "snapshot",
        "v": TWIN_VERSION,
        "session": session,
        "role": role,
        "rig": {"simulated": rig.simulated, "name": rig.name},
        "vessel": vessel_fields(rig.vessel),
        "calibration": calibration_fields(rig.calibration),
        "limits": {name: _finite(value) for name, value in rig.limits.items()},
        "camera": {
            "width_px": rig.picture.width_px,
            "height_px": rig.picture.height_px,
            "fps": rig.picture.fps,
            "format": rig.camera_format,
        },
        "policies": [
            {"name": card.name, "kind": card.kind, "verified": card.verified, "reason": card.reason}
            for card in policies
        ],
        "critical_areas": [area_fields(area, active) for area in areas],
        "state": twin_state(state, rig.calibration) if state else None,
    }


def twin_state(state: RigState, calibration: Calibration) -> dict[str, object]:
    """Return one state message.

    Args:
        state: The rig at one control step.
        calibration: Places the robot on the stage.
    """
    track = state.track
    robot = track.vessel if track else None
    return {
        "type": "state",
        "seq": state.seq,
        "t": _rounded(state.t_s, 6),
        "tip_um": _stage(state.tip),
        "setpoint_um": _stage(state.setpoint),
        "tip_px": _pixels(state.tip_px),
        "tip_seen_px": _pixels(state.tip_seen_px),
        "tip_off_um": _rounded(state.tip_off_um, 1),
        "learned": dict(state.learned),
        "robot_um": _pair(*calibration.stage_xy_um(robot)) if robot else None,
        "robot_px": _pixels(track.image if track else None),
        "robot_vessel_px": _pixels(robot),
        "track": {
            "state": track.state.value if track else "searching",
            "confidence": _rounded(track.confidence, 3) if track else 0.0,
            "age_ms": _rounded(state.track_age_ms, 1),
            "sigma_um": _rounded(track.sigma_um, 2) if track else None,
        },
        "mode": state.mode.value,
        "severity": state.severity.name,
        "reason": state.reason,
        "authority": _rounded(state.authority, 3),
        "lease": {
            "epoch": state.lease.epoch,
            "holder": state.lease.holder,
            "console": state.lease.console,
            "client": state.lease.client,
            "hand": state.lease.hand,
        },
        "clutch": state.clutch,
        "hand": dict(state.hand),
        "auto_ready": state.auto_ready,
        "auto_refusal": state.auto_refusal,
        "time_to_handover_s": _rounded(state.time_to_handover_s, 2),
        "critical_area": state.critical_area,
        "distance_um": _rounded(state.distance_um, 1),
        "lead_um": _rounded(state.lead_um, 1),
        "collisions": state.collisions,
        "path": _path_fields(state.path),
        "latency_ms": {name: _percentiles(value) for name, value in state.latency_ms.items()},
        "rates_hz": {name: _rounded(value, 1) for name, value in state.rates_hz.items()},
        "counters": dict(state.counters),
        "trial": state.trial,
    }


def event(name: str, t_s: float, fields: Mapping[str, object]) -> dict[str, object]:
    """Return an event message.

    Args:
        name: mode, handover, handover_announced, contact, fault, areas, trial or lease.
        t_s: When, monotonic, in seconds.
        fields: What belongs to it, ready for JSON.
    """
    return {"type": "event", "event": name, "t": _rounded(t_s, 6), **fields}


def area_fields(
    area: CriticalArea, active: str | None, visited: frozenset[str] = frozenset()
) -> dict[str, object]:
    """Return a critical area; ``active`` is the id of the one in use, ``visited`` those that were reached."""
    return {
        "id": area.id,
        "center": {"x_px": _rounded(area.center.x_px, 2), "y_px": _rounded(area.center.y_px, 2)},
        "epsilon_um": _finite(area.epsilon_um),
        "label": area.label,
        "active": area.id == active,
        "visited": area.id in visited,
    }


def vessel_fields(vessel: VesselMap) -> dict[str, object]:
    """Return what a client draws and measures the vessel with."""
    return {
        "name": vessel.name,
        "size_px": vessel.size_px,
        "um_per_px": vessel.um_per_px,
        "robot_radius_um": vessel.robot_radius_px * vessel.um_per_px,
        "suggested_areas": [{"x_px": area.x_px, "y_px": area.y_px} for area in vessel.suggested_areas],
    }


def calibration_fields(calibration: Calibration) -> dict[str, object]:
    """Return the calibration's maps and sizes, unrounded."""
    return {
        "image_from_vessel": calibration.image_from_vessel.rows(),
        "stage_from_vessel": calibration.stage_from_vessel.rows(),
        "um_per_px": calibration.um_per_px,
        "floor_z_um": calibration.floor_z_um,
        "magnet_offset_um": list(calibration.magnet_offset_um),
        "critical_height_um": calibration.critical_height_um,
        "floor_map": _floor_map_fields(calibration.floor),
    }


def _floor_map_fields(floor: FloorMap | None) -> dict[str, object] | None:
    """Return the camera's full map; ``image_from_vessel`` is the affine nearest to it."""
    if floor is None:
        return None
    rows = [list(floor.homography[row : row + 3]) for row in (0, 3, 6)]
    return {
        "homography": rows,
        "center_px": list(floor.center_px),
        "radial": floor.radial,
        "radius_px": floor.radius_px,
    }


# States come far more often than paths.
@lru_cache(maxsize=8)
def _path_fields(path: tuple[tuple[float, float], ...]) -> tuple[tuple[float | None, float | None], ...]:
    return tuple((_rounded(x, 1), _rounded(y, 1)) for x, y in _thinned(path))


def _thinned(path: Sequence[tuple[float, float]]) -> Sequence[tuple[float, float]]:
    """Return at most 64 points, evenly picked, both ends kept."""
    last = len(path) - 1
    if last < MAX_PATH_POINTS:
        return path
    return [path[i * last // (MAX_PATH_POINTS - 1)] for i in range(MAX_PATH_POINTS)]


def _stage(point: StagePoint | None) -> list[float | None] | None:
    if point is None:
        return None
    return [_rounded(point.x_um, 2), _rounded(point.y_um, 2), _rounded(point.z_um, 2)]


def _pixels(point: ImagePoint | VesselPoint | None) -> list[float | None] | None:
    return None if point is None else _pair(point.x_px, point.y_px)


def _pair(x: float, y: float) -> list[float | None]:
    return [_rounded(x, 2), _rounded(y, 2)]


def _percentiles(value: Percentiles) -> dict[str, float | None]:
    return {"p50": _rounded(value.p50, 2), "p99": _rounded(value.p99, 2)}


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None or not math.isfinite(value) else round(float(value), digits)
