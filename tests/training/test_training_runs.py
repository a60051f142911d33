"""Running a training: settings, monitor, checkpoints, and what it prints."""

import csv
import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from mrnav_server.core.errors import ConfigError
from mrnav_server.training.checkpoint import load_checkpoint, save_checkpoint
from mrnav_server.training.monitor import Board
from mrnav_server.training.presets import Algorithm, adjust, find_preset, preset_from
from mrnav_server.training.progress import Report
from mrnav_server.training.train import TrainingResult, resume, train
from mrnav_server.vision.vessel_model import save_vessel_model, vessel_map

QUICK = (
    *("steps=2048", "environments=16", "horizon=16", "max_steps=40", "critic_updates=1", "hidden=16"),
    *("cloning.labels=500", "cloning.updates=10", "cloning.batch=64"),
)


def quick(model: Path, out: Path, algorithm: Algorithm = "ppo") -> TrainingResult:
    return train(model, "best", 5, out, pairs=2, algorithm=algorithm, settings=QUICK)


def test_settings_reach_the_network_the_algorithm_and_the_cloning() -> None:
    changed = adjust(
        find_preset("paper"),
        "a2c",
        ["steps=2_000", "hidden=32", "masked=true", "encoding=fourier", "cloning.labels=7", "rms_decay=0.9"],
    )
    assert (changed.hidden, changed.masked, changed.encoding) == (32, True, "fourier")
    assert (changed.a2c.steps, changed.a2c.rms_decay, changed.cloning.labels) == (2000, 0.9, 7)
    assert changed.ppo == find_preset("paper").ppo


@pytest.mark.parametrize(
    ("assignment", "said"),
    [
        ("gamma=0.9", "gamma: no such setting of ppo; there are encoding, hidden.*discount.*cloning.labels"),
        ("rms_decay=0.9", "no such setting of ppo"),
        ("cloning.gamma=1", "cloning.gamma: no such"),
        ("steps", "name=value"),
        ("steps=many", "steps: 'many' is not a whole number"),
        ("learning_rate=fast", "not a number"),
        ("discount=1.5", "discount must be at least 0 and at most 1, not 1.5"),
        ("learning_rate=nan", "learning_rate must be"),
        ("environments=0", "environments must be at least 1"),
        ("masked=maybe", "masked: 'maybe' is not one of true, false"),
        ("encoding=sine", "not one of raw, fourier"),
        ("name=x", "name: no such"),
    ],
)
def test_bad_settings_are_refused(assignment: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        adjust(find_preset("best"), "ppo", [assignment])


def test_a_preset_survives_its_record() -> None:
    preset = adjust(find_preset("best"), "ppo", ["steps=7", "cloning.batch=9"])
    assert preset_from(asdict(preset)) == preset
    assert preset_from(asdict(preset)) != replace(preset, hidden=1)


def test_the_monitor_file_is_one_that_stable_baselines_reads(model: Path, tmp_path: Path) -> None:
    from stable_baselines3.common.monitor import load_results

    result = quick(model, tmp_path / "out")
    with (tmp_path / "out" / "monitor.csv").open() as file:
        head = json.loads(file.readline().removeprefix("#"))
        rows = list(csv.DictReader(file))
    assert (head["model"], head["algo"], head["preset"], head["seed"]) == ("chamber", "ppo", "best", 5)
    assert head["steps"] == result.environment_steps == 2048
    assert list(rows[0]) == ["r", "l", "t", "is_success", "s"]
    assert sum(int(row["l"]) for row in rows) <= 2048
    assert [int(row["s"]) for row in rows] == sorted(int(row["s"]) for row in rows)
    assert 0 < int(rows[-1]["s"]) <= 2048
    for row in rows:
        assert (float(row["r"]) > 900) == (row["is_success"] == "True")
    table = load_results(str(tmp_path / "out"))
    assert table["l"].tolist() == [int(row["l"]) for row in rows]


class StoppedError(Exception):
    """Ends a training in the middle."""


@pytest.mark.parametrize("algorithm", ["ppo", "a2c"])
@pytest.mark.parametrize("stop_at", [0, 3, 5])
def test_a_resumed_training_equals_one_that_was_not_interrupted(
    model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, algorithm: Algorithm, stop_at: int
) -> None:
    whole = quick(model, tmp_path / "whole", algorithm)
    monkeypatch.setattr("mrnav_server.training.train.CHECKPOINT_EVERY_S", -1.0)

    def stop(report: Report) -> None:
        if report.stage == "clone" and stop_at == 0 and report.done == 1.0:
            monkeypatch.setattr("mrnav_server.training.train.CHECKPOINT_EVERY_S", 1e9)
        if report.stage == "reinforce" and report.steps >= 256 * max(1, stop_at):
            raise StoppedError

    broken = tmp_path / "broken"
    with pytest.raises(StoppedError):
        train(model, "best", 5, broken, stop, 2, algorithm=algorithm, settings=QUICK)
    assert not (broken / "policy.pt").exists()
    torch.manual_seed(99)
    resumed = resume(model, broken, pairs=2)
    assert resumed.curve == whole.curve
    assert resumed.greedy == whole.greedy
    final, again = load_checkpoint(tmp_path / "whole"), load_checkpoint(broken)
    for part in ("network", "learner"):
        assert flat(final[part]) == flat(again[part])
    for name in ("whole", "broken"):
        table = np.genfromtxt(
            tmp_path / name / "monitor.csv", delimiter=",", skip_header=2, usecols=(0, 1, 4)
        )
        assert len(table) > 10
    first, second = (
        (tmp_path / name / "monitor.csv").read_text().splitlines() for name in ("whole", "broken")
    )
    untimed = [[row.split(",")[:2] + row.split(",")[3:] for row in lines[1:]] for lines in (first, second)]
    assert untimed[0] == untimed[1]


def flat(tree: object) -> object:
    """Return a state as values that compare."""
    if isinstance(tree, dict):
        return {str(key): flat(value) for key, value in tree.items()}
    if isinstance(tree, list | tuple):
        return [flat(value) for value in tree]
    return tree.tolist() if isinstance(tree, torch.Tensor | np.ndarray) else tree


def test_resuming_needs_the_checkpoint_and_the_same_vessel(model: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"checkpoint\.pt is missing: --resume takes"):
        resume(model, tmp_path)
    (tmp_path / "checkpoint.pt").write_bytes(b"no checkpoint")
    with pytest.raises(ConfigError, match="is not a checkpoint"):
        resume(model, tmp_path)
    quick(model, tmp_path / "out")
    mask = np.full((60, 60), 255, np.uint8)
    mask[30:32, 30:32] = 0
    other = vessel_map("other", mask, robot_radius_um=100.0)
    save_vessel_model(tmp_path / "other", other, "other", "test")
    with pytest.raises(ConfigError, match="another vessel model than other"):
        resume(tmp_path / "other", tmp_path / "out")


def test_a_checkpoint_holds_arrays_tensors_and_large_numbers(tmp_path: Path) -> None:
    random = np.random.default_rng(3)
    state = {
        "a": np.arange(3),
        "t": torch.ones(2),
        "n": {"random": random.bit_generator.state},
        "l": [1, 2.5],
    }
    save_checkpoint(tmp_path, state)
    back = load_checkpoint(tmp_path)
    assert back["a"].tolist() == [0, 1, 2]
    assert torch.equal(back["t"], torch.ones(2))
    assert back["n"]["random"] == random.bit_generator.state
    assert back["l"] == [1, 2.5]
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint.pt"]


def test_the_record_keeps_the_contract(model: Path, tmp_path: Path) -> None:
    record = json.loads(json.dumps(quick(model, tmp_path / "out").record()))
    contract = {"model", "policy", "mode", "n", "success", "success_low", "spl", "wall_hits", "steps_ratio"}
    assert contract | {"cpu_s", "wall_s", "steps"} <= set(record)
    assert (record["model"], record["policy"], record["mode"]) == ("chamber", "chamber-best", "greedy")
    assert (record["n"], record["steps"], record["sampled"]["mode"]) == (2, 2048, "sample")
    assert record["cpu_s"] > 0
    assert record["wall_s"] > 0


def test_tensorboard_is_asked_for_where_it_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "torch.utils.tensorboard.writer", None)
    with pytest.raises(ConfigError, match=r"mrnav-server\[tensorboard\]"):
        Board(tmp_path)
