"""The published schema of ``/ws/twin`` against what the server sends and takes."""

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import orjson
import pytest
from fastapi import FastAPI
from jsonschema import Draft202012Validator

from mrnav_server.app import twin, twin_states
from mrnav_server.app.schemas import AskMessage, GiveHand, Heartbeat, TakeHand
from mrnav_server.app.twin_jsdoc import FILE, twin_types
from mrnav_server.app.twin_schema import PATH, HandMessage, twin_schema
from mrnav_server.cli.simulated_trial import SimulatedTrial
from mrnav_server.cli.virtual_trial import run_in_this_process
from mrnav_server.core.frames import Calibration
from mrnav_server.core.modes import Severity
from mrnav_server.core.records import RigState
from mrnav_server.core.wire_hand import ClientFrame, parse_message
from mrnav_server.core.wire_twin import TWIN_VERSION, twin_state
from mrnav_server.loops.events import Event, EventBus
from tests.app.fake_rig import OPERATOR_TOKEN

TRIAL = SimulatedTrial(
    0, 0, 0, "with_autonomy", "bifurcation", 2500.0, "SIM00", "test", {"MRNAV_AUTOPILOT__SOURCE": "geodesic"}
)


def objects(schema: object) -> Iterator[dict[str, Any]]:
    """Every part of a schema that names properties."""
    if isinstance(schema, dict):
        if "properties" in schema:
            yield schema
        for part in schema.values():
            yield from objects(part)
    elif isinstance(schema, list):
        for part in schema:
            yield from objects(part)


def validator(name: str) -> Draft202012Validator:
    """One definition, with every field forbidden that it does not name."""
    closed = copy.deepcopy(twin_schema())
    for part in objects(closed):
        part["additionalProperties"] = False
    return Draft202012Validator({"$defs": closed["$defs"], "$ref": f"#/$defs/{name}"})


@pytest.mark.timeout(600)
def test_every_message_of_a_trial_is_as_the_schema_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[dict[str, Any]] = []
    send = twin._Client.send

    async def noted(self: twin._Client, text: str) -> None:
        sent.append(json.loads(text))
        await send(self, text)

    def described(state: RigState, calibration: Calibration) -> dict[str, object]:
        fields = twin_state(state, calibration)
        sent.append(orjson.loads(orjson.dumps(fields)))
        return fields

    publish = EventBus.publish

    def told(self: EventBus, event: Event) -> None:
        # Whether a client is there yet when it happens is a matter of luck.
        sent.append(orjson.loads(orjson.dumps(event)))
        publish(self, event)

    monkeypatch.setattr(twin._Client, "send", noted)
    monkeypatch.setattr(twin_states, "twin_state", described)
    monkeypatch.setattr(EventBus, "publish", told)
    assert run_in_this_process(TRIAL, tmp_path)["completed"]
    states = [message for message in sent if message["type"] == "state"]
    assert len(states) > 100
    assert any(state["robot_um"] and state["path"] and state["distance_um"] for state in states)
    others = [message for message in sent if message["type"] != "state"]
    assert {message["type"] for message in others} >= {"snapshot", "event"}
    events = {message["event"] for message in others if message["type"] == "event"}
    assert events >= {"mode", "areas", "lease", "handover", "trial"}
    check = validator("ServerMessage")
    for message in others:
        check.validate(message)
    state = validator("State")
    for message in states[::20]:
        state.validate(message)


@pytest.mark.parametrize("change", [{"more": 1}, {"mode": "IDLE"}, {"count": None}])
def test_a_message_that_drifts_is_noticed(change: dict[str, Any]) -> None:
    good = {"type": "event", "event": "contact", "t": 1.0, "mode": "MANUAL", "count": 1}
    check = validator("ServerMessage")
    assert check.is_valid(good)
    assert not check.is_valid(good | change)


@pytest.mark.parametrize(
    "message",
    [
        {"type": "heartbeat"},
        {"type": "ask", "ask": "auto", "area": "area-1"},
        {"type": "ask", "ask": "stop"},
        {"type": "take_hand", "client": "page", "frame": "webxr"},
        {"type": "give_hand"},
        {"type": "hand", "seq": 1, "t": 2.0, "p": [0.0, 0.1, 0.2], "clutch": True, "valid": True, "pose": 3},
        {"type": "hand", "seq": 1, "t": 2.0, "p": [0.0, 0.1, 0.2], "clutch": True, "valid": True},
    ],
)
def test_what_a_client_sends_is_as_the_schema_says(message: dict[str, Any]) -> None:
    check = validator("ClientMessage")
    assert check.is_valid(message)
    assert not check.is_valid(message | {"more": 1})
    if message["type"] == "hand":
        parse_message(json.dumps(message).encode(), ClientFrame.STAGE)
    else:
        assert isinstance(twin._checked(message), Heartbeat | AskMessage | TakeHand | GiveHand)


def test_the_hand_link_knows_every_field_of_the_schemas_hand() -> None:
    whole = HandMessage(type="hand", seq=1, t=2.0, p=(0.0, 0.1, 0.2), clutch=True, valid=True, pose=3)
    for left_out in HandMessage.model_fields:
        line = json.dumps({k: v for k, v in whole.model_dump().items() if k != left_out}).encode()
        if left_out == "pose":
            parse_message(line, ClientFrame.STAGE)
        else:
            with pytest.raises(Exception, match=left_out):
                parse_message(line, ClientFrame.STAGE)


def test_the_schema_names_this_version_and_every_severity() -> None:
    definitions = twin_schema()["$defs"]
    assert definitions["Snapshot"]["properties"]["v"]["const"] == TWIN_VERSION
    assert definitions["State"]["properties"]["severity"]["enum"] == [one.name for one in Severity]


async def test_the_schema_is_published_and_is_a_schema(app: FastAPI) -> None:
    site = httpx.ASGITransport(app)
    async with httpx.AsyncClient(transport=site, base_url="http://127.0.0.1") as client:
        assert (await client.get(PATH)).status_code == 401
        answer = await client.get(PATH, headers={"Authorization": f"Bearer {OPERATOR_TOKEN}"})
    assert answer.headers["content-type"] == "application/schema+json"
    Draft202012Validator.check_schema(answer.json())
    assert answer.json() == twin_schema()


def test_the_pages_types_are_those_of_the_schema() -> None:
    written = (Path(__file__).parents[2] / FILE).read_text(encoding="utf-8")
    assert written == twin_types(), "the messages have changed: run python docs/write_twin_types.py"
