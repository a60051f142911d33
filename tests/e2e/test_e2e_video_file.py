"""A film drives the whole server: no camera, and the robot that is seen is simulated nowhere."""

import math
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from mrnav_server.core.frames import VesselPoint
from mrnav_server.loops.video_recorder import VIDEO_NAME
from mrnav_server.settings import Settings
from mrnav_server.sim.microscope import Microscope
from mrnav_server.sim.world import SimulatedWorld
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model
from tests.films import played
from tests.rig_process import RigProcess, wait_for

FRAMES = 60
RADIUS_PX = 30.0
"""The filmed robot runs in a circle, in vessel pixels; a simulated one would lie still."""


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds that join without a jump when they are played again and again."""
    path = tmp_path_factory.mktemp("film") / "circle.avi"
    rig = Settings()
    vessel = load_vessel_model(find_model(rig.rig.vessel))
    world = SimulatedWorld(rig.sim, vessel, rig.camera)
    microscope = Microscope(rig.microscope, rig.camera, rig.sim.magnets, vessel, world.true_calibration, 1)
    size = rig.camera.width_px, rig.camera.height_px
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), rig.camera.fps, size)
    assert writer.isOpened()
    center, tip = start(), world.snapshot().magnet
    for number in range(FRAMES):
        turn = 2 * math.pi * number / FRAMES
        robot = VesselPoint(
            center.x_px + RADIUS_PX * math.cos(turn), center.y_px + RADIUS_PX * math.sin(turn)
        )
        writer.write(microscope.render(robot, tip))
    writer.release()
    return path


@cache
def start() -> VesselPoint:
    rig = Settings()
    vessel = load_vessel_model(find_model(rig.rig.vessel))
    return SimulatedWorld(rig.sim, vessel, rig.camera).snapshot().robot


@pytest.fixture
def filmed(film: Path, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[RigProcess]:
    rig = RigProcess(
        tmp_path,
        MRNAV_RIG__CAMERA="file",
        MRNAV_CAMERA__FILE=str(film),
        MRNAV_CAMERA__LOOP=request.param,
        MRNAV_VIDEO__ENABLED="true",
        MRNAV_VIDEO__MIN_FREE_MB="0",
    )
    yield rig
    rig.end()


def off_circle_px(vessel_px: list[float]) -> float:
    center = start()
    return abs(math.dist(vessel_px, (center.x_px, center.y_px)) - RADIUS_PX)


@pytest.mark.parametrize("filmed", ["true"], indirect=True)
def test_a_film_drives_tracking_twin_and_record(filmed: RigProcess) -> None:
    assert filmed.snapshot["rig"]["name"] == "simulated manipulator, file camera"
    filmed.until(lambda s: s["track"]["state"] == "tracking", "finding the filmed robot")
    trial = {"participant": "SIM0", "condition": "without_autonomy", "operator_kind": "simulated"}
    trial_id: str = filmed.post("/api/v1/trials", trial)["id"]

    seen: dict[int, dict[str, Any]] = {}

    def look(state: dict[str, Any]) -> bool:
        if state["robot_vessel_px"] is not None and state["trial"] == trial_id:
            seen[state["seq"]] = state
        return len(seen) >= 150

    filmed.until(look, "the film's twin")
    positions = [state["robot_vessel_px"] for state in seen.values()]
    assert np.median([off_circle_px(position) for position in positions]) < 0.3
    assert np.ptp(np.array(positions), axis=0) == pytest.approx([2 * RADIUS_PX] * 2, abs=1.0)
    assert np.median([state["track"]["age_ms"] for state in seen.values()]) < 100.0

    still = filmed.http.get("/frame.jpg", params={"width": 1600}).content
    picture = cv2.imdecode(np.frombuffer(still, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (1200, 1600, 3)

    result = filmed.post(f"/api/v1/trials/{trial_id}/end", {})
    assert "simulated_truth" not in result
    tracks = [line.data for line in filmed.log(trial_id) if line.topic == "track"]
    found = [track for track in tracks if track["state"] == "tracking" and track["vessel"] is not None]
    assert len(found) >= 0.8 * len(tracks) > 30
    assert np.median([off_circle_px(track["vessel"]) for track in found]) < 0.3
    taken_s = np.diff([track["taken_s"] for track in tracks])
    assert (taken_s > 0.0).all()
    assert np.median(taken_s) == pytest.approx(1 / 30, abs=2e-3)

    assert result["video"]["frames"] > 30
    assert result["video"]["fault"] == ""
    first_s = result["video"]["first_taken_s"]
    stamps_s = [frame.stamp_s for frame in played(filmed.trials / trial_id / VIDEO_NAME)]
    assert len(stamps_s) == result["video"]["frames"]
    tracked_s = np.array([track["taken_s"] for track in tracks])
    apart_s = [float(np.abs(tracked_s - first_s - stamp_s).min()) for stamp_s in stamps_s[1:-1]]
    assert max(apart_s) < 1e-3


@pytest.mark.parametrize("filmed", ["false"], indirect=True)
def test_the_end_of_a_film_is_named_and_nothing_is_believed_after_it(filmed: RigProcess) -> None:
    def ended() -> bool:
        answer = filmed.http.get("/readyz")
        return answer.status_code == 503 and "circle.avi has ended" in answer.text

    wait_for(ended, 30.0, "the film's end")
    wait_for(
        lambda: any("has ended" in event.get("reason", "") for event in filmed.events),
        10.0,
        "the page to be told",
    )
    last = filmed.state["track"]
    filmed.until(lambda s: s["track"]["age_ms"] > last["age_ms"] + 500.0, "a track that ages")
