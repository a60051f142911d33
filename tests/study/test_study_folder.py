"""A study on disk: it goes on after a crash, and says what was interrupted."""

import json
import stat
from pathlib import Path

import pytest

from mrnav_server.core.errors import ConfigError
from mrnav_server.loops.trial_log import LOG_NAME, header_line, log_line
from mrnav_server.study.demographics import Demographics, keep_demographics, read_demographics
from mrnav_server.study.plan import new_plan
from mrnav_server.study.study_folder import PROGRESS_NAME, StudyFolder
from tests.trial_headers import bare_header

HEADER = bare_header("P01", "with_autonomy", "a")


@pytest.fixture
def study(tmp_path: Path) -> StudyFolder:
    return StudyFolder.create(tmp_path / "study", new_plan(2, ("a", "b"), 1, 0))


def again(study: StudyFolder) -> StudyFolder:
    return StudyFolder(study.folder, wall_clock=lambda: 1.0)


def test_steps_are_done_in_order_and_kept(study: StudyFolder) -> None:
    training, trial = study.plan.steps[:2]
    assert study.next_step == training
    study.begin(training)
    study.finish(training)
    study.begin(trial, "some-trial")
    assert again(study).progress(trial).status == "started"
    study.finish(trial)
    found = again(study)
    assert found.plan == study.plan
    assert (found.progress(trial).status, found.progress(trial).trial) == ("done", "some-trial")
    assert found.next_step == study.plan.steps[2]


@pytest.mark.parametrize(("status", "open_still"), [("ended", False), ("interrupted", True), (None, True)])
def test_a_result_whose_log_was_never_closed_is_none(
    study: StudyFolder, status: str | None, open_still: bool
) -> None:
    training, step = study.plan.steps[:2]
    trial = "20261122-174500-001-P01"
    (study.trials / trial).mkdir(parents=True)
    log = header_line(trial, HEADER)
    if status is not None:
        log += log_line(1, 0.0, 0.0, "closed", {"status": status, "lost_lines": 0})
    (study.trials / trial / LOG_NAME).write_bytes(log)
    for each, its in ((training, None), (step, trial)):
        study.begin(each, its)
        study.finish(each)
    assert again(study).recover() == ([step] if open_still else [])
    assert again(study).next_step == (step if open_still else study.plan.steps[2])


def test_what_a_crash_left_begun_is_interrupted_and_done_again(study: StudyFolder) -> None:
    step = study.plan.steps[0]
    study.begin(step, "first")
    found = again(study)
    assert found.recover() == [step]
    assert again(study).progress(step).status == "interrupted"
    assert found.next_step == step
    found.begin(step, "second")
    found.finish(step)
    done = again(study).progress(step)
    assert (done.status, done.trial, done.interrupted) == ("done", "second", 1)


def test_an_unfinished_last_line_is_no_entry_and_spoils_no_later_one(study: StudyFolder) -> None:
    first, second = study.plan.steps[:2]
    study.begin(first)
    with (study.folder / PROGRESS_NAME).open("ab") as file:
        file.write(b'{"step":"P01-01","sta')
    found = again(study)
    assert found.progress(first).status == "started"
    found.finish(first)
    found.begin(second)
    assert [again(study).progress(step).status for step in (first, second)] == ["done", "started"]


def test_a_questionnaire_belongs_to_the_last_trial_of_its_block(study: StudyFolder) -> None:
    trials = [step for step in study.plan.steps if step.kind == "trial"]
    questionnaires = [step for step in study.plan.steps if step.kind == "questionnaire"]
    assert study.block_trial(questionnaires[0]) is None
    for number, step in enumerate(trials):
        study.begin(step, f"trial-{number}")
        study.finish(step)
    assert [study.block_trial(step) for step in questionnaires] == [
        "trial-1",
        "trial-3",
        "trial-5",
        "trial-7",
    ]


def test_what_is_no_study_or_damaged_is_told(study: StudyFolder, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="mrnav study new"):
        StudyFolder(tmp_path)
    with pytest.raises(ConfigError, match="holds a study already"):
        StudyFolder.create(study.folder, study.plan)
    (study.folder / PROGRESS_NAME).write_text('{"step":"P09-01","status":"done","trial":null}\n')
    with pytest.raises(ConfigError, match="line 1"):
        again(study)


def test_demographics_lie_apart_and_hold_no_name(study: StudyFolder) -> None:
    assert read_demographics(study.folder) == {}
    keep_demographics(study.folder, "P02", Demographics(sex="female"))
    keep_demographics(study.folder, "P01", Demographics(31, "male", "none", "much"))
    keep_demographics(study.folder, "P02", Demographics(44))
    file = study.folder / "demographics.json"
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    content = json.loads(file.read_text())
    assert list(content) == ["P01", "P02"]
    assert read_demographics(study.folder)["P02"] == Demographics(44)
    content["P01"]["name"] = "Ada"
    file.write_text(json.dumps(content))
    with pytest.raises(ConfigError, match="demographics"):
        read_demographics(study.folder)
