"""A rig without devices: what the server asks of it is noted, what it publishes is put by the test."""

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from fastapi import FastAPI

from mrnav_server.app.page_hand import Tell
from mrnav_server.app.serve import RigServer, bound_socket, uvicorn_config
from mrnav_server.app.video import VideoEncoder
from mrnav_server.core.areas import CriticalAreas
from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import Affine2, Calibration, ImagePoint, VesselPoint
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.modes import Mode, Severity
from mrnav_server.core.picture import PictureFormat
from mrnav_server.core.records import Frame, LeaseState, Percentiles, RigState
from mrnav_server.core.vessel import VesselMap
from mrnav_server.core.wire_hand import Hello
from mrnav_server.core.wire_twin import RigCard, snapshot
from mrnav_server.loops.events import EventBus
from mrnav_server.loops.latest import Latest
from mrnav_server.settings import Settings
from mrnav_server.vision.vessel_model import vessel_map

OPERATOR_TOKEN = "operator-0123456789"
VIEWER_TOKEN = "viewer-0123456789ab"
CHIEF_TOKEN = "chief-0123456789"
SERVER = {
    "operator_token": OPERATOR_TOKEN,
    "viewer_token": VIEWER_TOKEN,
    "chief_token": CHIEF_TOKEN,
    "port": 0,
    "hand_port": 0,
}
SETTINGS = Settings.model_validate({"server": SERVER})

STATE = RigState(
    seq=1,
    t_s=1.0,
    tip=None,
    setpoint=None,
    tip_px=None,
    track=None,
    track_age_ms=0.0,
    mode=Mode.DISARMED,
    severity=Severity.NONE,
    reason="",
    authority=1.0,
    lease=LeaseState(epoch=0, holder=None, console=None, client="", hand=False),
    clutch=False,
    auto_ready=False,
    auto_refusal="no lease",
    time_to_handover_s=None,
    critical_area=None,
    distance_um=None,
    lead_um=None,
    collisions=0,
    path=(),
    latency_ms={"tick": Percentiles(0.5, 2.0)},
    rates_hz={"camera": 30.0},
    hand={"scale": "coarse", "gain": 0.04, "messages_hz": 60.0, "poses_hz": 30.0},
    counters={"stale": 3},
    trial=None,
    learned={"offset_um": [0.0, 0.0], "friction_lead_um": 0.0, "looks": 0},
)


def vessel() -> VesselMap:
    """A straight vessel, 200 px wide, in a grid of 400 px."""
    mask = np.zeros((400, 400), np.uint8)
    mask[100:300, 10:390] = 255
    return vessel_map("straight", mask)


class FakeTrials:
    def __init__(self, note: Callable[..., None]) -> None:
        self._note = note
        self._trials: list[dict[str, Any]] = []
        self.running = ""

    def list(self) -> list[dict[str, Any]]:
        return self._trials

    def start(self, participant: str, condition: str, operator_kind: str, notes: str) -> dict[str, Any]:
        self._note("start_trial", participant)
        self._trials.append({"id": f"trial-{len(self._trials) + 1}", "participant": participant})
        return self._trials[-1]

    async def end(self, trial_id: str) -> dict[str, Any]:
        self._note("end_trial", trial_id)
        return {"id": trial_id, "duration_s": 1.0}

    async def live_metrics(self, trial_id: str) -> dict[str, Any] | None:
        return {"id": trial_id, "reached": False, "metrics": {}} if trial_id == self.running else None


class FakeRegistration:
    def __init__(self, note: Callable[..., None]) -> None:
        self._note = note

    def state(self) -> dict[str, Any]:
        return {"registered": False}

    async def find(self, session: str) -> dict[str, Any]:
        self._note("find", session)
        return {"accepted": True}

    async def adjust(self, session: str, dx_um: float, dy_um: float, turn_deg: float) -> dict[str, Any]:
        self._note("adjust", session, str((dx_um, dy_um, turn_deg)))
        return {"accepted": True}


class FakeCalibration:
    def __init__(self, note: Callable[..., None]) -> None:
        self._note = note

    def state(self) -> dict[str, Any]:
        return {"phase": "idle"}

    def begin(
        self, session: str, changes: Mapping[str, float | int], water_depth_um: float
    ) -> dict[str, Any]:
        self._note("begin", session, f"{dict(changes)} {water_depth_um:g}")
        return {"phase": "waiting"}

    def next(self, session: str) -> dict[str, Any]:
        self._note("next", session)
        return {"phase": "moving"}

    def cancel(self) -> dict[str, Any]:
        self._note("cancel")
        return {"phase": "idle"}

    def use(self, session: str) -> dict[str, Any]:
        self._note("use", session)
        return {"phase": "done"}


class FakeSeat:
    """Satisfies ``app.page_hand.Seat``: the first session sits, until a test says otherwise."""

    transform: ClassVar[Mapping[str, object]] = {"gain": 0.04, "fine_gain": 0.01, "vertical_gain": 0.0}

    def __init__(self) -> None:
        self.counters: Counter[str] = Counter()
        self.holder: tuple[str, str, Tell] | None = None
        self.samples: list[HandSample] = []
        self.told: list[tuple[str, str]] = []
        self.time_s = 100.0

    def now_s(self) -> float:
        return self.time_s

    def acquire(self, session: str, hello: Hello, tell: Tell) -> None:
        if self.holder is not None:
            raise RefusedError("lease_held", f"{self.holder[1]} has control")
        self.holder = (session, hello.client, tell)

    def take(self, sample: HandSample) -> None:
        self.samples.append(sample)

    def on_bad_numbers(self, session: str) -> None:
        self.told.append(("bad_numbers", session))

    def leave(self, session: str) -> None:
        self.told.append(("left", session))
        if self.holder is not None and self.holder[0] == session:
            self.holder = None


class FakeRig:
    """Satisfies ``app.rig_port.RigPort``."""

    def __init__(self, settings: Settings = SETTINGS) -> None:
        self.settings = settings
        self.vessel = vessel()
        self.calibration = Calibration(
            image_from_vessel=Affine2.scale(2 / 3, 200.0, 0.0),
            stage_from_vessel=Affine2.scale(10.0),
            um_per_px=10.0,
            floor_z_um=2000.0,
            magnet_offset_um=(0.0, 0.0),
            critical_height_um=3000.0,
        )
        self.states: Latest[RigState] = Latest()
        self.frames: Latest[Frame] = Latest()
        self.encoder = VideoEncoder(self.frames)
        self.events = EventBus()
        self.areas = CriticalAreas(self.vessel)
        self.hand_port = 0
        self.simulated = True
        self.asked: list[tuple[str, ...]] = []
        self.refusal: RefusedError | None = None
        self.not_ready: list[str] = []
        self.failure: Exception | None = None
        self.closing: Callable[[], None] | None = None
        self.hand_seat = FakeSeat()
        self.trials = FakeTrials(self._note)
        self.registration = FakeRegistration(self._note)
        self.calibrating = FakeCalibration(self._note)

    @property
    def console(self) -> "FakeRig":
        return self

    def publish(self, seq: int = 1, **changes: Any) -> None:  # noqa: ANN401 - any field of a state
        self.states.put(replace(STATE, seq=seq, **changes))

    def show(self, number: int = 0, width_px: int = 160, height_px: int = 120) -> None:
        self.frames.put(Frame(number, number / 30.0, np.full((height_px, width_px, 3), 90, np.uint8)))

    def snapshot(self, session: str, role: str) -> dict[str, Any]:
        card = RigCard("fake", True, self.vessel, self.calibration, {}, PictureFormat(160, 120))
        return snapshot(session, role, card, [], self.areas.list(), self.states.value)

    def to_vessel(self, frame: str, x: float, y: float) -> VesselPoint:
        if frame == "image":
            return self.calibration.vessel_point(ImagePoint(x, y))
        return VesselPoint(x / 10.0, y / 10.0) if frame == "stage" else VesselPoint(x, y)

    async def ask(self, name: str, session: str, area: str | None) -> None:
        self._note(name, session, area or "")

    def stop_now(self, session: str) -> None:
        self.asked.append(("stop_now", session))

    def take_lease(self, session: str, client: str) -> None:
        self._note("take_lease", session, client)

    async def take_over(self, session: str, client: str) -> None:
        self._note("take_over", session, client)

    def give_lease(self, session: str) -> None:
        self._note("give_lease", session)

    def choose_area(self, area_id: str) -> None:
        self._note("choose_area", area_id)

    def choose_scale(self, session: str, scale: str) -> None:
        self._note("choose_scale", session, scale)

    def heartbeat(self, session: str) -> None:
        self.asked.append(("heartbeat", session))

    async def use_policy(self, folder: Path) -> None:
        self._note("use_policy", folder.name)

    def policies(self) -> list[dict[str, Any]]:
        return [{"name": "ppo", "kind": "torchscript", "verified": True, "reason": ""}]

    def require_idle(self, session: str) -> None:
        self._note("require_idle", session)

    def readiness(self) -> list[str]:
        return self.not_ready

    async def run(self, started: asyncio.Event) -> None:
        self.publish()
        self.hand_port = 4242
        started.set()
        if self.failure is not None:
            raise self.failure
        try:
            await asyncio.Event().wait()
        finally:
            if self.closing is not None:
                await asyncio.to_thread(self.closing)
            self.asked.append(("stopped",))

    def _note(self, *ask: str) -> None:
        if self.refusal is not None:
            raise self.refusal
        self.asked.append(ask)


@asynccontextmanager
async def listening(app: FastAPI) -> AsyncIterator[int]:
    """Serve an app on a free port, as the process does; yields the port."""
    server = RigServer(uvicorn_config(app, SETTINGS.server))
    with bound_socket("127.0.0.1", 0) as listener:
        listener.listen()
        async with asyncio.TaskGroup() as group:
            group.create_task(server.serve([listener]))
            try:
                yield listener.getsockname()[1]
            finally:
                server.should_exit = True
