"""The experimenter is led: training period, trial, questionnaire, next; nothing is lost by a crash."""

from itertools import count
from pathlib import Path
from typing import Any

import httpx
import orjson
import pytest

from mrnav_server.app.server import create_app
from mrnav_server.app.study_desk import StudyDesk
from mrnav_server.core.errors import RefusedError
from mrnav_server.loops.trial_log import LOG_NAME, Condition, OperatorKind, header_line, log_line
from mrnav_server.settings import Settings
from mrnav_server.study.plan import new_plan
from mrnav_server.study.study_folder import StudyFolder
from tests.app.fake_rig import OPERATOR_TOKEN, SERVER, SETTINGS, FakeRig
from tests.trial_headers import bare_header


class LoggedTrials:
    """Trials that are nothing but logs."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._numbers = count(1)
        self.begun: list[tuple[str, str, str]] = []
        self.ended: list[str] = []

    def list(self) -> list[dict[str, Any]]:
        return []

    def start(
        self, participant: str, condition: Condition, operator_kind: OperatorKind, notes: str
    ) -> dict[str, Any]:
        trial_id = f"20261122-174500-{next(self._numbers):03d}-{participant}"
        (self._root / trial_id).mkdir(parents=True)
        self._log(trial_id).write_bytes(
            header_line(trial_id, bare_header(participant, condition, "bifurcation"))
        )
        self.begun.append((participant, condition, operator_kind))
        return {"id": trial_id}

    async def end(self, trial_id: str) -> dict[str, Any]:
        self.ended.append(trial_id)
        with self._log(trial_id).open("ab") as file:
            file.write(log_line(1, 0.0, 0.0, "closed", {"status": "ended", "lost_lines": 0}))
        return {"id": trial_id}

    async def live_metrics(self, trial_id: str) -> dict[str, Any] | None:
        return None

    def _log(self, trial_id: str) -> Path:
        return self._root / trial_id / LOG_NAME


@pytest.fixture
def study(tmp_path: Path) -> StudyFolder:
    return StudyFolder.create(tmp_path / "study", new_plan(1, ("bifurcation",), 2, 0, training_s=60.0))


@pytest.fixture
def trials(study: StudyFolder) -> LoggedTrials:
    return LoggedTrials(study.trials)


def desk_of(
    study: StudyFolder, trials: LoggedTrials, vessel: str = "bifurcation", *, target: bool = True
) -> StudyDesk:
    return StudyDesk(study, vessel, trials, lambda: target, lambda: 5.0)


async def test_a_whole_block_in_its_order(study: StudyFolder, trials: LoggedTrials) -> None:
    desk = desk_of(study, trials)
    assert (await desk.state())["step"]["kind"] == "training"
    begun = await desk.next()
    assert (begun["doing"], begun["left_s"]) == (True, 60.0)
    with pytest.raises(RefusedError, match="under way"):
        await desk.next()
    await desk.finish()
    for repetition in (1, 2):
        begun = await desk.next()
        assert begun["step"]["repetition"] == repetition
        assert begun["trial"].endswith("P01")
        await desk.finish()
    asked = await desk.next()
    assert (asked["step"]["kind"], asked["trial"]) == ("questionnaire", begun["trial"])
    assert asked["answered"] is False
    with pytest.raises(RefusedError, match=f"/tlx.trial={begun['trial']}"):
        await desk.finish()
    condition = study.plan.steps[0].condition
    assert trials.begun == [("P01", condition, "human")] * 2
    results = [study.progress(step).trial for step in study.plan.steps if study.progress(step).trial]
    assert desk.results() == set(results)
    assert results == trials.ended == [f"20261122-174500-{number:03d}-P01" for number in (1, 2)]


async def test_an_interrupted_trial_is_done_again_and_is_no_result(
    study: StudyFolder, trials: LoggedTrials
) -> None:
    desk = desk_of(study, trials)
    await desk.next()
    await desk.finish()
    first = (await desk.next())["trial"]
    given_up = await desk.interrupt()
    assert (given_up["again"], given_up["step"]["repetition"]) == (True, 1)
    with pytest.raises(RefusedError, match="no step is under way"):
        await desk.finish()
    second = (await desk.next())["trial"]
    assert first != second
    assert desk.results() == set()
    await desk.finish()
    assert desk.results() == {second}
    assert study.progress(study.plan.steps[1]).trial == second
    assert trials.ended == [first, second]


async def test_after_a_crash_the_same_step_comes_again(study: StudyFolder, trials: LoggedTrials) -> None:
    desk = desk_of(study, trials)
    await desk.next()
    await desk.finish()
    await desk.next()
    found = StudyFolder(study.folder)
    assert [step.id for step in found.recover()] == ["P01-02"]
    state = await desk_of(found, trials).state()
    assert (state["step"]["id"], state["doing"], state["again"]) == ("P01-02", False, True)
    statuses = [(each["status"], each["interrupted"]) for each in state["own"][:3]]
    assert statuses == [("done", 0), ("interrupted", 1), ("waiting", 0)]
    assert state["participants"] == [{"code": "P01", "steps": 8, "done": 1, "interrupted": 1}]


async def test_a_trial_that_was_ended_elsewhere_is_a_result(study: StudyFolder, trials: LoggedTrials) -> None:
    desk = desk_of(study, trials)
    await desk.next()
    await desk.finish()
    trial = (await desk.next())["trial"]
    await trials.end(trial)
    await desk.finish()
    assert study.progress(study.plan.steps[1]).trial == trial
    assert trials.ended == [trial]


async def test_another_vessel_is_asked_for(study: StudyFolder, trials: LoggedTrials) -> None:
    desk = desk_of(study, trials, vessel="network")
    state = await desk.state()
    assert "bifurcation under the microscope" in state["say"]
    assert "goes by vessel network; bifurcation is needed" in state["refusal"]
    assert state["other_vessel"] == desk.next_vessel() == "bifurcation"
    with pytest.raises(RefusedError, match="bifurcation is needed"):
        await desk.next()
    assert trials.begun == []


async def test_a_trial_needs_a_target(study: StudyFolder, trials: LoggedTrials) -> None:
    study.finish(study.plan.steps[0])
    desk = desk_of(study, trials, target=False)
    assert "critical area" in (await desk.state())["refusal"]
    with pytest.raises(RefusedError, match="needs a target"):
        await desk.next()
    assert trials.begun == []


async def test_the_end_is_told(study: StudyFolder, trials: LoggedTrials) -> None:
    for step in study.plan.steps:
        study.finish(step)
    desk = desk_of(study, trials)
    assert "report" in (await desk.state())["say"]
    with pytest.raises(RefusedError, match="every step"):
        await desk.next()


async def test_over_rest(study: StudyFolder) -> None:
    app = create_app(FakeRig(), SETTINGS, study)
    transport = httpx.ASGITransport(app)
    token = {"Authorization": f"Bearer {OPERATOR_TOKEN}"}
    async with httpx.AsyncClient(
        transport=transport, base_url="http://127.0.0.1:8000", headers=token
    ) as page:
        assert (await page.get("/api/v1/study")).json()["steps"] == 8
        assert (await page.post("/api/v1/study/next")).json()["doing"] is True
        refused = await page.post("/api/v1/study/next")
        assert (refused.status_code, refused.json()["code"]) == (409, "step_running")
        assert (await page.post("/api/v1/study/interrupt")).json()["again"] is True
        free = {"participant": "P09", "condition": "with_autonomy", "operator_kind": "human"}
        refused = await page.post("/api/v1/trials", json=free)
        assert (refused.status_code, refused.json()["code"]) == (409, "study_leads")
        assert orjson.loads((study.folder / "progress.jsonl").read_bytes().splitlines()[-1])["trial"] is None
    app.state.context.encoder.close()


async def test_a_step_keeps_its_vessel_and_the_next_one_changes_it(study: StudyFolder) -> None:
    rig = FakeRig(Settings.model_validate({"server": SERVER, "rig": {"vessel": "network"}}))
    app = create_app(rig, rig.settings, study, FakeRig)
    page = httpx.AsyncClient(
        transport=httpx.ASGITransport(app),
        base_url="http://127.0.0.1:8000",
        headers={"Authorization": f"Bearer {OPERATOR_TOKEN}", "X-MRNAV-Session": "a-secret-of-this-page"},
    )
    async with page:
        study.begin(study.plan.steps[0])
        refused = await page.post("/api/v1/vessels/serpentine/choose")
        assert (refused.status_code, refused.json()["code"]) == (409, "not_now")
        assert "step of the study is under way" in refused.json()["detail"]
        study.interrupt(study.plan.steps[0])
        vessels = app.state.context.vessels
        assert not vessels.changed.is_set()
        assert (await page.post("/api/v1/study/vessel")).status_code == 202
        assert vessels.successor.settings.rig.vessel == study.plan.steps[0].model
    app.state.context.encoder.close()
