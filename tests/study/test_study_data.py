from pathlib import Path

import numpy as np
import pytest

from mrnav_server.core.errors import ConfigError
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.trial_log import LOG_NAME
from mrnav_server.study.figure_paths import outside_share, task_mean, tasks
from mrnav_server.study.measures import FIVE, HANDOVER
from mrnav_server.study.plan import new_plan
from mrnav_server.study.report_appendix import trial_flags
from mrnav_server.study.study_data import Study, read_study
from mrnav_server.study.study_folder import StudyFolder
from tests.study.fabricated_study import Fabricator, Way, small_way

WAY = small_way()
PATH_PX = WAY.path_px()


def bend(name: str) -> VesselMap:
    assert name == "bend"
    return WAY.vessel


def read(folder: Path, **options: object) -> Study:
    return read_study(folder, find_vessel=bend, **options)  # type: ignore[arg-type]


def test_a_study_is_measured_from_its_logs(tmp_path: Path) -> None:
    Fabricator(tmp_path / "trials").study([WAY], operators=2)
    told: list[tuple[int, int]] = []
    study = read(tmp_path, on_trial=lambda done, total: told.append((done, total)))
    assert [trial.header.participant for trial in study.trials] == ["SIM01"] * 2 + ["SIM02"] * 2
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]
    with_autonomy, without = study.trials[:2]
    speed, completion = (measure.of for measure in FIVE[:2])
    assert 1.2 < speed(with_autonomy) / speed(without) < 1.5
    # The ease in and out is filtered away at the ends; else length = speed x time.
    assert with_autonomy.metrics.path_um == pytest.approx(
        speed(with_autonomy) * completion(with_autonomy), rel=0.05
    )
    assert with_autonomy.path_um.shape[1] == 2
    assert np.hypot(*(with_autonomy.path_um[0] / 10 - PATH_PX[0])) < 40.0
    assert study.left_out == ()
    assert len(with_autonomy.log_sha256) == 64


def test_the_hand_over_is_measured_where_control_passed(tmp_path: Path) -> None:
    Fabricator(tmp_path).study([WAY], operators=1)
    with_autonomy, without = read(tmp_path).trials
    take_over = HANDOVER[-1].of
    # The hand grips with the frame of the switch.
    assert take_over(with_autonomy) == pytest.approx(0.0, abs=0.05)
    assert np.isnan(take_over(without))
    # Without autonomy the window begins where the critical area is entered.
    assert without.handover is not None
    assert without.handover.peak_jerk_um_per_s3 > 0


def test_flags_and_means_know_what_did_not_arrive(tmp_path: Path) -> None:
    maker = Fabricator(tmp_path)
    maker.study([WAY], operators=2)
    maker.trial(WAY, PATH_PX, "SIM01", "with_autonomy", reached=False)
    study = read(tmp_path)
    assert "not_reached" in trial_flags(study.trials[-1])
    assert tasks(study) == ["bend"]
    mean = task_mean(study, "bend", "with_autonomy")
    assert mean is not None
    assert (mean.operators, mean.paths) == (2, 2)
    assert outside_share(mean, WAY.vessel) == 0.0
    assert 1.0 < float(np.median(mean.sd_um)) < 300.0


def test_a_mean_of_different_ways_is_seen(tmp_path: Path) -> None:
    Fabricator(tmp_path).study([WAY], operators=1)
    mean = task_mean(read(tmp_path), "bend", "without_autonomy")
    assert mean is not None
    # The way to the middle of the bend's circle leaves the lumen.
    mean.xy_um[:] = np.linspace(mean.xy_um[0], [600.0, 4400.0], len(mean.xy_um))
    assert outside_share(mean, WAY.vessel) > 0.3


def test_trials_to_other_places_are_other_tasks(tmp_path: Path) -> None:
    maker = Fabricator(tmp_path)
    back = Way(WAY.vessel, WAY.area, WAY.start)
    maker.study([WAY, back], operators=1)
    assert {trial.task for trial in read(tmp_path).trials} == {"bend", "bend, place 2"}


def test_human_and_simulated_are_never_pooled(tmp_path: Path) -> None:
    maker = Fabricator(tmp_path)
    maker.study([WAY], operators=1, kind="human", code="P")
    maker.study([WAY], operators=2)
    with pytest.raises(ConfigError, match="2 trials are of people and 4 of simulated operators"):
        read(tmp_path)
    human, simulated = (read(tmp_path, operators=kind) for kind in ("human", "simulated"))
    assert (human.operators, human.people, human.simulated) == (("P01",), "participants", True)
    assert (simulated.operators, simulated.people) == (("SIM01", "SIM02"), "simulated operators")
    assert "no evidence about people" in simulated.origin


def test_hardware_and_simulated_rig_are_never_pooled(tmp_path: Path) -> None:
    maker = Fabricator(tmp_path)
    maker.trial(WAY, PATH_PX, "P01", "with_autonomy", "human", simulated_rig=False)
    maker.trial(WAY, PATH_PX, "P01", "without_autonomy", "human", simulated_rig=False)
    assert read(tmp_path).origin == "participants on hardware"
    assert not read(tmp_path).simulated
    maker.trial(WAY, PATH_PX, "P01", "without_autonomy", "human")
    with pytest.raises(ConfigError, match="hardware and some on the simulated rig"):
        read(tmp_path)


def test_only_results_of_the_plan_count(tmp_path: Path) -> None:
    planned = StudyFolder.create(tmp_path, new_plan(1, ("bend",), 1, 0, "human", 60.0))
    maker = Fabricator(tmp_path / "trials")
    made: dict[str, list[str]] = {}
    for step in planned.plan.steps:
        if step.kind != "questionnaire":
            trial = maker.trial(WAY, PATH_PX, step.code, step.condition, "human").name
            planned.begin(step, trial)
            planned.finish(step)
            made.setdefault(step.kind, []).append(trial)
    again = maker.trial(WAY, PATH_PX, "P01", "with_autonomy", "human").name
    study = read(tmp_path)
    assert [trial.id for trial in study.trials] == made["trial"]
    assert [trial for trial, _ in study.left_out] == [*made["training"], again]
    assert all("not a result of the plan" in why for _, why in study.left_out)


def test_interrupted_trials_are_named_and_left_out(tmp_path: Path) -> None:
    folders = Fabricator(tmp_path).study([WAY], operators=1)
    broken = Fabricator(tmp_path, 1).trial(WAY, PATH_PX, "SIM02", "with_autonomy") / LOG_NAME
    lines = broken.read_bytes().splitlines(keepends=True)
    broken.write_bytes(b"".join(lines[:-3]))
    study = read(tmp_path)
    assert len(study.trials) == len(folders)
    assert study.left_out == ((broken.parent.name, "running"),)


def test_a_trial_of_another_mask_is_left_out(tmp_path: Path) -> None:
    Fabricator(tmp_path).study([WAY], operators=1)
    log = next(tmp_path.iterdir()) / LOG_NAME
    log.write_bytes(log.read_bytes().replace(WAY.vessel.digest.encode(), b"0" * 64))
    with pytest.raises(ConfigError, match="both conditions"):
        read(tmp_path)


def test_nothing_to_report_is_said(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="holds no finished trial"):
        read(tmp_path)
    with pytest.raises(ConfigError, match="is no folder"):
        read(tmp_path / "nowhere")
    Fabricator(tmp_path).trial(WAY, PATH_PX, "SIM01", "with_autonomy")
    with pytest.raises(ConfigError, match="no finished trial of human operators"):
        read(tmp_path, operators="human")
    with pytest.raises(ConfigError, match="both conditions are needed"):
        read(tmp_path)
