"""A study that comes to its next vessel, led through the page against a real server."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from mrnav_server.study.plan import new_plan
from mrnav_server.study.study_folder import StudyFolder
from tests.e2e.test_e2e_dashboard import PATIENCE_MS, page
from tests.rig_process import RigProcess

__all__ = ["page"]
pytestmark = [pytest.mark.browser, pytest.mark.timeout(180)]


@pytest.fixture
def study(tmp_path: Path) -> StudyFolder:
    study = StudyFolder.create(
        tmp_path / "study", new_plan(2, ("bifurcation", "network"), 1, 3, "human", 60.0)
    )
    training = study.plan.steps[0]
    assert training.kind == "training"
    study.finish(training)
    return study


@pytest.fixture
def rig(tmp_path: Path, study: StudyFolder) -> Iterator[RigProcess]:
    rig = RigProcess(tmp_path, arguments=("--study", str(study.folder)))
    yield rig
    rig.end()


def test_the_next_vessel_takes_the_place_of_the_last(rig: RigProcess, study: StudyFolder, page: Page) -> None:
    first, second = study.plan.steps[1:3]
    assert first.model != second.model
    page.goto(rig.ready["url"])
    name, go = page.get_by_test_id("vessel-name"), page.get_by_test_id("study-go")
    expect(name).to_have_text(first.model, timeout=PATIENCE_MS)
    page.get_by_test_id("take").click()
    page.get_by_test_id("suggest").click()
    go.click()
    expect(go).to_have_text("End trial", timeout=PATIENCE_MS)
    go.click()
    expect(go).to_have_text(f"{second.model} is in place", timeout=2 * PATIENCE_MS)
    expect(page.get_by_test_id("study-say")).to_have_text(f"Put vessel {second.model} under the microscope.")
    go.click()
    expect(name).to_have_text(second.model, timeout=2 * PATIENCE_MS)
    # Who led before leads on; the areas were the other vessel's.
    expect(page.get_by_test_id("arm")).to_be_enabled(timeout=PATIENCE_MS)
    expect(page.get_by_test_id("study-trouble")).to_contain_text("a trial needs a target")
    page.get_by_test_id("suggest").click()
    expect(go).to_have_text("Begin trial", timeout=PATIENCE_MS)
    go.click()
    expect(go).to_have_text("End trial", timeout=PATIENCE_MS)
    trial = study.trials / rig.http.get("/api/v1/state").json()["trial"]
    assert f'"{second.model}"' in (trial / "log.jsonl").read_text().splitlines()[0]
