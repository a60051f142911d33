"""The training wizard's routes, with the real command behind them."""

import asyncio
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np
import pytest

from mrnav_server.app.server import create_app
from mrnav_server.core.modes import Mode
from mrnav_server.settings import Settings
from mrnav_server.vision.vessel_model import load_vessel_model
from tests.app.fake_rig import OPERATOR_TOKEN, SERVER, FakeRig

QUICK = ["cloning.labels=300", "cloning.updates=2", "steps=0"]
"""Hyper-parameters of a training that learns nothing."""
PATIENCE = 1200
"""Looks at a command, ten a second."""


@pytest.fixture
def rig(tmp_path: Path) -> FakeRig:
    settings = {"server": SERVER, "models": {"root": str(tmp_path / "models")}}
    rig = FakeRig(Settings.model_validate(settings))
    rig.publish(mode=Mode.DISARMED, trial=None)
    return rig


@pytest.fixture
async def client(rig: FakeRig) -> AsyncIterator[httpx.AsyncClient]:
    app = create_app(rig, rig.settings)
    headers = {"Authorization": f"Bearer {OPERATOR_TOKEN}"}
    transport = httpx.ASGITransport(app, raise_app_exceptions=False)
    base = "http://127.0.0.1:8000/api/v1"
    async with httpx.AsyncClient(transport=transport, base_url=base, headers=headers) as client:
        yield client
    await asyncio.to_thread(app.state.context.training.cancel)
    app.state.context.encoder.close()


def picture() -> bytes:
    """Return a drawn vessel: a straight channel of 2 mm in 6 x 6 mm, at 20 µm/px."""
    mask = np.zeros((300, 300), np.uint8)
    mask[100:200, 20:280] = 255
    return cv2.imencode(".png", mask)[1].tobytes()


async def bring(client: httpx.AsyncClient, name: str, content: bytes) -> dict[str, Any]:
    asked = {"name": name, "um_per_px": "20"}
    answer = await client.post(
        "/training/picture", params=asked, content=content, headers={"Content-Type": "image/png"}
    )
    assert answer.status_code == 200, answer.text
    return await until(client, lambda now: now["phase"] != "importing")


async def until(client: httpx.AsyncClient, over: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    for _ in range(PATIENCE):
        now: dict[str, Any] = (await client.get("/training")).json()
        if over(now):
            return now
        await asyncio.sleep(0.1)
    raise AssertionError(now)


async def test_from_a_picture_to_a_policy_in_use(client: httpx.AsyncClient, rig: FakeRig) -> None:
    found = await bring(client, "channel", picture())
    assert (found["phase"], found["refusal"]) == ("imported", "")
    assert found["report"]["junctions"] == 0
    assert found["report"]["width_um"]["median"] == pytest.approx(2000.0, rel=0.05)
    assert (await client.get("/training/models/channel/preview.png")).content.startswith(b"\x89PNG")

    asked = {"model": "channel", "seed": 3, "pairs": 4, "settings": QUICK}
    begun = (await client.post("/training/begin", json=asked)).json()
    assert (begun["phase"], begun["seed"]) == ("training", 3)
    for path, body in (
        ("/training/begin", asked),
        ("/training/live", {"name": "other"}),
        ("/training/use", None),
    ):
        refused = await client.post(path, json=body)
        assert refused.status_code == 409, path
    trained = await until(client, lambda now: now["phase"] != "training")
    assert (trained["phase"], trained["refusal"]) == ("trained", "")
    assert trained["evaluation"]["n"] == 4
    assert trained["evaluation"]["success_low"] <= trained["evaluation"]["success"]

    rig.vessel = load_vessel_model(Path(rig.settings.models.root) / "channel")
    used = (await client.post("/training/use")).json()
    assert ("use_policy", "best-3") in rig.asked
    assert "It drives from now on" in used["used"]
    assert (Path(rig.settings.models.root) / "channel" / "policy.pt").is_file()
    rig.show()
    again = await client.post("/training/live", json={"name": "channel"})
    assert again.json()["code"] == "name_taken"


async def test_a_picture_without_a_vessel_is_refused_in_plain_words(client: httpx.AsyncClient) -> None:
    empty = cv2.imencode(".png", np.full((300, 300), 90, np.uint8))[1].tobytes()
    found = await bring(client, "nothing", empty)
    assert found["phase"] == "failed"
    assert found["refusal"].startswith("photograph: no lumen found")
    assert "nothing" not in {model["name"] for model in found["models"]}


async def test_a_training_can_be_cancelled(client: httpx.AsyncClient) -> None:
    await client.post("/training/begin", json={"model": "bifurcation"})
    over = (await client.post("/training/cancel")).json()
    assert (over["phase"], over["refusal"]) == ("idle", "")
    assert (await client.post("/training/use")).status_code == 409


@pytest.mark.parametrize(
    ("state", "word"),
    [({"mode": Mode.MANUAL, "trial": None}, "disarm"), ({"mode": Mode.DISARMED, "trial": "t"}, "end it")],
)
async def test_nothing_computes_beside_a_rig_in_use(
    client: httpx.AsyncClient, rig: FakeRig, state: dict[str, Any], word: str
) -> None:
    rig.publish(2, **state)
    refused = await client.post("/training/begin", json={"model": "bifurcation"})
    assert refused.status_code == 409
    assert word in refused.json()["detail"]
    assert word in (await client.get("/training")).json()["objection"]


async def test_a_picture_is_of_a_known_kind_and_not_endless(client: httpx.AsyncClient) -> None:
    asked = {"name": "some", "um_per_px": "20"}
    assert (await client.post("/training/picture", params=asked, content=b"x")).json()["code"] == "no_picture"
    large = {"Content-Type": "image/png"}
    answer = await client.post("/training/picture", params=asked, content=bytes(40_000_001), headers=large)
    assert answer.json()["code"] == "body_too_large"
