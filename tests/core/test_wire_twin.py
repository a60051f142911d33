import json
import math
from dataclasses import replace

import numpy as np
import orjson

from mrnav_server.core.frames import Affine2, Calibration, ImagePoint, StagePoint, VesselPoint
from mrnav_server.core.modes import Mode, Severity
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import CriticalArea, LeaseState, Percentiles, RigState, Track, TrackState
from mrnav_server.core.vessel import VesselMap
from mrnav_server.core.wire_twin import PolicyCard, RigCard, area_fields, event, snapshot, twin_state

CALIBRATION = Calibration(
    image_from_vessel=Affine2.scale(10 / 15, 200.0, 0.0),
    stage_from_vessel=Affine2.scale(10.0, 1000.0, 2000.0),
    um_per_px=10.0,
    floor_z_um=500.0,
    magnet_offset_um=(120.0, -30.0),
    critical_height_um=2500.0,
)
TRACK = Track(
    taken_s=9.99,
    frame_number=300,
    state=TrackState.TRACKING,
    image=ImagePoint(400.123456, 300.0),
    vessel=VesselPoint(300.0, 450.0),
    confidence=0.87654,
    sigma_um=3.14159,
    good_frames=12,
)
STATE = RigState(
    seq=41,
    t_s=10.0,
    tip=StagePoint(4100.0, 6500.0, 3100.0),
    setpoint=StagePoint(4110.0, 6505.0, 3100.0),
    tip_px=ImagePoint(401.0, 301.0),
    track=TRACK,
    track_age_ms=12.34,
    mode=Mode.AUTO,
    severity=Severity.WARN,
    reason="the tracker is unsure",
    authority=0.0,
    lease=LeaseState(epoch=3, holder="s1", console="s2", client="HoloLens 2", hand=True),
    clutch=False,
    auto_ready=True,
    auto_refusal="",
    time_to_handover_s=2.5,
    critical_area="area-1",
    distance_um=1234.5678,
    lead_um=321.0,
    collisions=2,
    path=((300.0, 450.0), (310.5, 460.5)),
    latency_ms={name: Percentiles(1.0, 2.0) for name in ("hand_to_command", "frame_to_twin", "tick")},
    rates_hz={"camera": 30.0, "hand": 60.0, "hand_poses": 30.0, "tick": 100.0},
    hand={"scale": "fine", "gain": 0.01, "messages_hz": 60.0, "poses_hz": 30.0},
    counters={"non_finite": 0, "hand_stale": 3},
    trial="20261122-174500-001-P01",
)


def vessel() -> VesselMap:
    lumen = np.ones((8, 8), dtype=bool)
    distance = np.full((8, 8), 60.0, dtype=np.float32)
    return VesselMap("straight", lumen, distance, 10.0, 50.0, "digest", lumen, (VesselPoint(3.0, 4.0),))


def test_a_state_has_the_documented_fields_in_their_units() -> None:
    message = twin_state(STATE, CALIBRATION)
    assert message["type"] == "state"
    assert message["tip_um"] == [4100.0, 6500.0, 3100.0]
    assert message["robot_um"] == [4000.0, 6500.0]
    assert message["robot_px"] == [400.12, 300.0]
    assert message["robot_vessel_px"] == [300.0, 450.0]
    assert message["track"] == {"state": "tracking", "confidence": 0.877, "age_ms": 12.3, "sigma_um": 3.14}
    assert (message["mode"], message["severity"]) == ("AUTO", "WARN")
    assert message["lease"] == {
        "epoch": 3,
        "holder": "s1",
        "console": "s2",
        "client": "HoloLens 2",
        "hand": True,
    }
    assert message["path"] == ((300.0, 450.0), (310.5, 460.5))
    assert message["latency_ms"]["tick"] == {"p50": 1.0, "p99": 2.0}  # type: ignore[index]
    assert set(message) == {
        "type",
        "seq",
        "t",
        "tip_um",
        "setpoint_um",
        "tip_px",
        "tip_seen_px",
        "tip_off_um",
        "learned",
        "robot_um",
        "robot_px",
        "robot_vessel_px",
        "track",
        "mode",
        "severity",
        "reason",
        "authority",
        "lease",
        "clutch",
        "auto_ready",
        "auto_refusal",
        "time_to_handover_s",
        "critical_area",
        "distance_um",
        "lead_um",
        "collisions",
        "path",
        "latency_ms",
        "rates_hz",
        "hand",
        "counters",
        "trial",
    }


def test_before_the_first_frame_and_the_manipulator_there_are_nulls() -> None:
    early = replace(STATE, tip=None, setpoint=None, tip_px=None, track=None, distance_um=None, trial=None)
    message = twin_state(early, CALIBRATION)
    for name in ("tip_um", "setpoint_um", "tip_px", "robot_um", "robot_px", "robot_vessel_px", "distance_um"):
        assert message[name] is None
    assert message["track"] == {"state": "searching", "confidence": 0.0, "age_ms": 12.3, "sigma_um": None}


def test_what_is_not_finite_becomes_null() -> None:
    broken = replace(
        STATE,
        tip=StagePoint(math.nan, math.inf, 3.0),
        track_age_ms=math.inf,
        lead_um=math.nan,
        rates_hz={"camera": math.nan},
        latency_ms={"tick": Percentiles(math.nan, math.inf)},
        path=((math.nan, 1.0),),
    )
    message = twin_state(broken, CALIBRATION)
    assert message["tip_um"] == [None, None, 3.0]
    assert message["lead_um"] is None
    assert message["latency_ms"] == {"tick": {"p50": None, "p99": None}}
    json.dumps(message, allow_nan=False)


def test_numpy_numbers_leave_as_plain_numbers() -> None:
    state = replace(STATE, distance_um=np.float64(5.25), authority=np.float32(0.5))  # type: ignore[arg-type]
    assert orjson.loads(orjson.dumps(twin_state(state, CALIBRATION)))["authority"] == 0.5


def test_a_long_path_is_thinned_with_both_ends_kept() -> None:
    path = tuple((float(i), 2.0 * i) for i in range(1000))
    shown = twin_state(replace(STATE, path=path), CALIBRATION)["path"]
    assert isinstance(shown, tuple)
    assert len(shown) == 64
    assert (shown[0], shown[-1]) == ((0.0, 0.0), (999.0, 1998.0))


def test_a_full_state_fits_a_line_of_the_hand_link() -> None:
    full = replace(
        STATE,
        seq=10**9,
        t_s=987_654.321987,
        path=tuple((1234.567 + i, 1765.432 - i) for i in range(64)),
        reason="r" * 200,
        auto_refusal="a" * 200,
        counters={f"a_counter_{i}": 10**6 for i in range(20)},
    )
    assert len(orjson.dumps(twin_state(full, CALIBRATION))) < 4096


def test_a_snapshot_describes_the_rig() -> None:
    limits = {"speed_um_per_s": 3000.0}
    rig = RigCard("simulated rig", True, vessel(), CALIBRATION, limits, PictureFormat(800, 600, 25.0))
    areas = [CriticalArea("area-1", VesselPoint(300.0, 450.0), 500.0, "clot")]
    message = snapshot(
        "s9", "viewer", rig, [PolicyCard("ppo", "torchscript", False, "other map")], areas, STATE
    )
    assert message["rig"] == {"simulated": True, "name": "simulated rig"}
    assert message["camera"] == {"width_px": 800, "height_px": 600, "fps": 25.0, "format": ""}
    assert message["vessel"] == {
        "name": "straight",
        "size_px": 8,
        "um_per_px": 10.0,
        "robot_radius_um": 500.0,
        "suggested_areas": [{"x_px": 3.0, "y_px": 4.0}],
    }
    assert message["calibration"]["image_from_vessel"] == [[10 / 15, 0.0, 200.0], [0.0, 10 / 15, 0.0]]  # type: ignore[index]
    assert message["critical_areas"] == [
        {
            "id": "area-1",
            "center": {"x_px": 300.0, "y_px": 450.0},
            "epsilon_um": 500.0,
            "label": "clot",
            "active": True,
            "visited": False,
        }
    ]
    assert message["policies"] == [
        {"name": "ppo", "kind": "torchscript", "verified": False, "reason": "other map"}
    ]
    assert message["state"] == twin_state(STATE, CALIBRATION)
    assert set(message) == {
        "type",
        "v",
        "session",
        "role",
        "rig",
        "vessel",
        "calibration",
        "limits",
        "camera",
        "policies",
        "critical_areas",
        "state",
    }
    assert snapshot("s9", "viewer", rig, [], areas, None)["state"] is None


def test_only_the_active_area_says_so() -> None:
    area = CriticalArea("area-2", VesselPoint(1.0, 2.0), 100.0)
    assert area_fields(area, "area-1")["active"] is False
    assert area_fields(area, "area-2")["active"] is True


def test_an_event_carries_its_fields() -> None:
    assert event("contact", 3.25, {"count": 2}) == {
        "type": "event",
        "event": "contact",
        "t": 3.25,
        "count": 2,
    }
