"""`mrnav study`: plan, status, what participants tell, and a simulated study that goes on."""

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from mrnav_server.cli import study_job
from mrnav_server.cli.simulated_trial import SimulatedTrial
from mrnav_server.cli.study import studies
from mrnav_server.cli.study_job import StudyJob, finished_trial, jobs_of, run_study_job
from mrnav_server.cli.study_lead import led_study, variables
from mrnav_server.cli.study_plan import named_models
from mrnav_server.core.errors import ConfigError
from mrnav_server.loops.trial_log import list_trials, new_trial_id
from mrnav_server.study.plan import new_plan
from mrnav_server.study.study_folder import StudyFolder


def run(*arguments: str, code: int = 0) -> str:
    outcome = CliRunner().invoke(studies, [str(each) for each in arguments])
    if isinstance(outcome.exception, ConfigError):
        raise outcome.exception
    assert outcome.exit_code == code, outcome.output
    return outcome.output


def last_json(output: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(output.strip().splitlines()[-1])
    return found


def test_a_study_is_planned_and_says_where_it_stands(tmp_path: Path) -> None:
    folder = str(tmp_path / "study")
    wanted = ("new", folder, "--participants", "3", "--models", "network,serpentine", "--seed", "4")
    found = last_json(run(*wanted, "--json"))
    assert (found["trials"], found["trials_done"], found["models"]) == (24, 0, ["network", "serpentine"])
    assert found["next"]["kind"] == "training"
    study = StudyFolder(Path(folder))
    assert study.plan == new_plan(3, ("network", "serpentine"), 2, 4)
    study.begin(study.steps[0])
    study.interrupt(study.steps[0])
    assert last_json(run("status", folder, "--json"))["codes"]["P01"]["interrupted"] == 1
    assert "P01-01" in run("status", folder)
    with pytest.raises(ConfigError, match="holds a study already"):
        run(*wanted)


def test_models_are_checked_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no-such"):
        run("new", str(tmp_path / "study"), "--participants", "1", "--models", "no-such")
    assert not (tmp_path / "study").exists()
    assert named_models(["network,serpentine", "bifurcation"]) == ["network", "serpentine", "bifurcation"]
    assert len(named_models(None)) >= 3


def test_what_participants_tell_is_checked_and_kept_apart(tmp_path: Path) -> None:
    StudyFolder.create(tmp_path, new_plan(2, ("network",), 1, 0))
    run("tell", str(tmp_path), "P02", "--age", "31", "--mr", "none")
    assert json.loads((tmp_path / "demographics.json").read_text())["P02"]["age_years"] == 31
    with pytest.raises(ConfigError, match="age_years"):
        run("tell", str(tmp_path), "P02", "--age", "310")
    with pytest.raises(ConfigError, match="P03"):
        run("tell", str(tmp_path), "P03")


def test_a_server_takes_up_a_study_at_its_next_step(tmp_path: Path) -> None:
    study = StudyFolder.create(tmp_path, new_plan(1, ("network", "serpentine"), 1, 0))
    study.begin(study.steps[0])
    taken_up = led_study(tmp_path)
    assert taken_up.progress(study.steps[0]).status == "interrupted"
    for step in study.steps[:2]:
        taken_up.finish(step)
    assert variables(taken_up) == {
        "MRNAV_RECORDING__ROOT": str(tmp_path / "trials"),
        "MRNAV_RIG__VESSEL": study.steps[2].model,
    }
    simulated = StudyFolder.create(tmp_path / "other", new_plan(1, ("network",), 1, 0, "simulated"))
    with pytest.raises(ConfigError, match="mrnav study simulate"):
        led_study(simulated.folder)


def test_a_job_goes_on_after_the_trial_that_it_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study = StudyFolder.create(tmp_path, new_plan(2, ("network", "serpentine"), 2, 0, "simulated"))
    done: list[SimulatedTrial] = []

    def fake(trial: SimulatedTrial, root: Path) -> dict[str, Any]:
        if len(done) == 2:
            done.append(trial)
            raise RuntimeError("the power went")
        done.append(trial)
        folder = root / new_trial_id(root, trial.code, datetime(2026, 11, 22, tzinfo=UTC))
        folder.mkdir()
        return {"ended": {"folder": str(folder)}, "completed": True, "reason": ""}

    monkeypatch.setattr(study_job, "run_in_this_process", fake)
    job = jobs_of(study)[0]
    folder = tmp_path / "jobs" / job.name
    run_study_job(job.spec(), folder)
    assert "the power went" in (folder / "error.txt").read_text()
    run_study_job(job.spec(), folder)
    assert not (folder / "error.txt").exists()
    assert len(done) == 5
    steps = job.steps(study.plan)
    finished = [finished_trial(folder, step) for step in steps]
    ids = [each["trial"] for each in finished if each is not None]
    assert len(set(ids)) == 4
    assert sorted(path.name for path in study.trials.iterdir()) == sorted(ids)
    assert {(trial.condition, trial.repetition) for trial in done} == {
        (condition, r) for condition in study.plan.conditions for r in (0, 1)
    }
    assert {trial.code for trial in done} == {job.code}


def test_the_same_operator_meets_the_same_in_both_conditions() -> None:
    plan = new_plan(3, ("network",), 2, 7, "simulated")
    own = [study_job.simulated_trial(plan, step) for step in plan.steps if step.code == "SIM02"]
    assert {trial.operator for trial in own} == {7001}
    assert sorted(trial.practice for trial in own) == [0, 1, 2, 3]
    frictions = {(trial.repetition, trial.environment("x")["MRNAV_SIM__FRICTION"]) for trial in own}
    assert len(frictions) == 2


def test_no_two_jobs_share_a_step(tmp_path: Path) -> None:
    study = StudyFolder.create(tmp_path, new_plan(3, ("network", "serpentine"), 1, 0, "simulated"))
    jobs = jobs_of(study)
    steps = [step.id for job in jobs for step in job.steps(study.plan)]
    assert sorted(steps) == sorted(step.id for step in study.steps)
    assert len({job.name for job in jobs}) == len(jobs)
    assert StudyJob(**jobs[0].spec()) == jobs[0]


@pytest.mark.timeout(600)
def test_a_study_is_simulated_and_labelled(tmp_path: Path) -> None:
    folder = str(tmp_path / "study")
    wanted = (
        "simulate",
        folder,
        "--participants",
        "1",
        "--trials",
        "1",
        "--models",
        "bifurcation",
        "--workers",
        "1",
    )
    found = last_json(run(*wanted, "--json"))
    assert found == {"simulated": True, "folder": folder, "trials": 2, "done": 2, "failed": 0}
    trials = list_trials(tmp_path / "study" / "trials")
    assert [trial.status for trial in trials] == ["ended", "ended"]
    assert {trial.header.condition for trial in trials} == {"with_autonomy", "without_autonomy"}
    assert {trial.header.operator_kind for trial in trials} == {"simulated"}
    assert {trial.header.participant for trial in trials} == {"SIM01"}
    assert not list((tmp_path / "study").rglob("tlx.json"))
    # The same command has nothing left to do; other numbers are another study.
    assert last_json(run(*wanted, "--json"))["done"] == 2
    with pytest.raises(ConfigError, match="other numbers"):
        run(*wanted, "--seed", "1")
