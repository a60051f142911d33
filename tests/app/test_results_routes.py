"""Trials on disk, as pages ask for them."""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np
import pytest

from mrnav_server.app import results_routes
from mrnav_server.app.reporting import ReportError
from mrnav_server.app.server import create_app
from mrnav_server.core.tlx import KEYS, shown_pairs
from mrnav_server.loops.video_recorder import VIDEO_NAME, VideoRecorder
from mrnav_server.settings import Settings
from mrnav_server.study.trial_report import write_trial_report
from tests.app.fake_rig import OPERATOR_TOKEN, SERVER, VIEWER_TOKEN, FakeRig
from tests.recorded_trials import GO_S, RecordedTrial, shipped_vessel

OPERATOR, VIEWER = ({"Authorization": f"Bearer {token}"} for token in (OPERATOR_TOKEN, VIEWER_TOKEN))


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A person's trial with a report, a simulated operator's without one, and one that still runs."""
    root = tmp_path_factory.mktemp("trials")
    write_trial_report(RecordedTrial("P01").record(root), shipped_vessel())
    RecordedTrial("SIM01", "without_autonomy", "simulated").record(root)
    RecordedTrial("P03").record(root, close=False)
    return root


@pytest.fixture
def rig(root: Path) -> FakeRig:
    return FakeRig(Settings.model_validate({"server": SERVER, "recording": {"root": str(root)}}))


@pytest.fixture
async def client(rig: FakeRig) -> AsyncIterator[httpx.AsyncClient]:
    app = create_app(rig, rig.settings)
    transport = httpx.ASGITransport(app, raise_app_exceptions=False)
    async with httpx.AsyncClient(
        transport=transport, base_url="http://127.0.0.1:8000", headers=OPERATOR
    ) as client:
        yield client
    app.state.context.encoder.close()


def trial(root: Path, number: int) -> str:
    return sorted(path.name for path in root.iterdir())[number - 1]


def answers(mental: int = 50) -> dict[str, Any]:
    return {
        "ratings": {**dict.fromkeys(KEYS, 50), "mental": mental},
        "choices": [{"left": a, "right": b, "chosen": a} for a, b in shown_pairs("trial")],
    }


async def test_the_list_tells_whose_trials_they_are(client: httpx.AsyncClient, root: Path) -> None:
    found = (await client.get("/api/v1/results", headers=VIEWER)).json()
    running, simulated, person = found["trials"]
    assert [each["id"] for each in found["trials"]] == [trial(root, number) for number in (3, 2, 1)]
    assert (running["status"], simulated["status"], person["status"]) == ("running", "ended", "ended")
    assert (simulated["operator_kind"], simulated["simulated"], simulated["metrics"]) == (
        "simulated",
        True,
        None,
    )
    assert (person["operator_kind"], person["simulated_rig"]) == ("human", True)
    assert person["metrics"]["completion_s"] == pytest.approx(12.0)
    assert set(person["metrics"]["flags"]) <= set(found["flags"])
    assert person["in_study"] is None


async def test_a_result_is_live_while_the_trial_runs(
    client: httpx.AsyncClient, rig: FakeRig, root: Path
) -> None:
    rig.trials.running = trial(root, 3)
    live = (await client.get(f"/api/v1/trials/{trial(root, 3)}/result")).json()
    assert live["live"] is True
    over = (await client.get(f"/api/v1/trials/{trial(root, 1)}/result")).json()
    assert "live" not in over
    assert over["metrics"]["contacts"] == 0


async def test_what_is_drawn_comes_as_the_report_wrote_it(client: httpx.AsyncClient, root: Path) -> None:
    answer = await client.get(f"/api/v1/trials/{trial(root, 1)}/trajectory")
    assert answer.content == (root / trial(root, 1) / "trajectory.json").read_bytes()
    missing = await client.get(f"/api/v1/trials/{trial(root, 2)}/trajectory")
    assert (missing.status_code, missing.json()["code"]) == (404, "no_result")
    assert "POST /api/v1/trials/" in missing.json()["detail"]


async def test_a_missing_report_is_made_on_demand(
    client: httpx.AsyncClient, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Path] = []

    async def report(folder: Path) -> dict[str, Any]:
        asked.append(folder)
        if len(asked) > 1:
            raise ReportError("error: it holds no track")
        return {"id": folder.name}

    monkeypatch.setattr(results_routes, "trial_report", report)
    path = f"/api/v1/trials/{trial(root, 2)}/result"
    assert (await client.post(path)).json() == {"id": trial(root, 2)}
    assert asked == [root / trial(root, 2)]
    failed = await client.post(path)
    assert (failed.status_code, failed.json()["code"]) == (409, "no_report")
    assert "holds no track" in failed.json()["detail"]
    running = await client.post(f"/api/v1/trials/{trial(root, 3)}/result")
    assert (running.status_code, running.json()["code"]) == (409, "trial_running")
    assert len(asked) == 2


async def test_a_trial_is_played_back_with_its_film(client: httpx.AsyncClient, root: Path) -> None:
    path = f"/api/v1/trials/{trial(root, 1)}"
    recorder = VideoRecorder(root / trial(root, 1) / VIDEO_NAME)
    jpeg = cv2.imencode(".jpg", np.zeros((48, 64, 3), np.uint8))[1].tobytes()
    recorder.add(GO_S + 0.5, jpeg)
    recorder.finish()
    told = (await client.get(f"{path}/playback", headers=VIEWER)).json()
    assert (told["id"], told["status"], told["size_px"]) == (trial(root, 1), "ended", 1800)
    assert told["walls_px"]
    assert [each["mode"] for each in told["modes"]] == ["AUTO", "MANUAL"]
    assert [each["kind"] for each in told["marks"]] == ["auto", "go", "reached"]
    assert len({len(column) for column in told["frames"].values()}) == 1
    assert told["film_s"] == [0.5]
    picture = await client.get(f"{path}/film/0.jpg")
    assert (picture.headers["content-type"], picture.content) == ("image/jpeg", jpeg)
    for missing in (f"{path}/film/1.jpg", f"{path}/film/-1.jpg", "/api/v1/trials/none/playback"):
        assert (await client.get(missing)).status_code in {404, 409, 422}
    running = await client.get(f"/api/v1/trials/{trial(root, 3)}/playback")
    assert (running.status_code, running.json()["code"]) == (409, "trial_running")


async def test_a_questionnaire_is_asked_kept_and_corrected(client: httpx.AsyncClient, root: Path) -> None:
    path = f"/api/v1/trials/{trial(root, 1)}/tlx"
    form = (await client.get(f"{path}/form")).json()
    assert [scale["key"] for scale in form["scales"]] == list(KEYS)
    assert form["pairs"] == [list(pair) for pair in shown_pairs(trial(root, 1))]
    assert (form["filled"], form["may_answer"], form["mark_step"]) == (False, True, 5)
    none = await client.get(path)
    assert (none.status_code, none.json()["code"]) == (404, "no_tlx")

    first = await client.post(path, json=answers())
    assert (first.status_code, first.json()["weighted"]) == (200, 50.0)
    assert (await client.post(path, json=answers())).json() == first.json()
    other = await client.post(path, json=answers(100))
    assert (other.status_code, other.json()["code"]) == (409, "tlx_exists")
    corrected = await client.post(path, json={**answers(100), "replace": True})
    assert len(corrected.json()["replaced"]) == 1
    assert (await client.get(path)).json() == corrected.json()

    listed = (await client.get("/api/v1/results")).json()["trials"]
    assert [each["tlx"] is not None for each in listed] == [False, False, True]
    table = (await client.get("/api/v1/tlx.csv")).text.splitlines()
    assert len(table) == 2
    assert table[1].startswith(trial(root, 1))
    assert (await client.get(f"{path}/form", headers=VIEWER)).json()["may_answer"] is False


@pytest.mark.parametrize(
    ("number", "change", "status", "code"),
    [
        (2, {}, 409, "simulated_operator"),
        (3, {}, 409, "trial_running"),
        (1, {"ratings": dict.fromkeys(KEYS, 33)}, 409, "bad_ratings"),
        (1, {"ratings": dict.fromkeys(KEYS, 50.0)}, 422, "invalid_request"),
        (1, {"choices": answers()["choices"][:14]}, 409, "bad_choices"),
        (1, {"weights": {}}, 422, "invalid_request"),
    ],
)
async def test_bad_answers_are_refused(
    client: httpx.AsyncClient, root: Path, number: int, change: dict[str, Any], status: int, code: str
) -> None:
    path = f"/api/v1/trials/{trial(root, number)}/tlx"
    refused = await client.post(path, json={**answers(), **change})
    assert (refused.status_code, refused.json()["code"]) == (status, code), refused.text
