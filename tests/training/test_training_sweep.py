"""What a sweep's file means: jobs, their names, what is refused, and the leaderboard."""

import csv
import json
import math
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrnav_server.core.errors import ConfigError
from mrnav_server.training.leaderboard import leaderboard, write_leaderboard
from mrnav_server.training.sweep import (
    Event,
    Events,
    Job,
    check,
    expand,
    parse_sweep,
    read_sweep,
    run_sweep,
    settled,
    spec_hash,
)
from mrnav_server.training.sweep_job import ERROR_FILE, RESULT_FILE
from mrnav_server.training.sweep_ray import connect
from mrnav_server.vision.vessel_model import save_vessel_model, vessel_map

VALUES = st.one_of(st.booleans(), st.integers(), st.floats(allow_nan=False, allow_infinity=False), st.text())
SPECS = st.dictionaries(
    st.text(), st.one_of(VALUES, st.dictionaries(st.text(), VALUES, max_size=4)), max_size=6
)


def reverse(spec: dict[str, Any]) -> dict[str, Any]:
    return {k: reverse(v) if isinstance(v, dict) else v for k, v in reversed(spec.items())}


@given(SPECS)
def test_the_hash_does_not_depend_on_the_order_of_keys(spec: dict[str, Any]) -> None:
    assert spec_hash(reverse(spec)) == spec_hash(spec)
    assert spec_hash(json.loads(json.dumps(spec))) == spec_hash(spec)


@given(SPECS, SPECS)
def test_different_specs_have_different_hashes(one: dict[str, Any], other: dict[str, Any]) -> None:
    same = json.dumps(one, sort_keys=True) == json.dumps(other, sort_keys=True)
    assert (spec_hash(one) == spec_hash(other)) == same


def test_the_hash_stays_the_same_between_versions() -> None:
    # A folder of results that is there must be found again.
    assert spec_hash({"seed": 1, "set": {"discount": 0.99}}) == "7a07236d1e2ec96b"


@settings(deadline=None, max_examples=50)
@given(
    presets=st.lists(st.sampled_from(["best", "paper+", "paper"]), min_size=1, max_size=4),
    algos=st.lists(st.sampled_from(["ppo", "a2c"]), min_size=1, max_size=3),
    seeds=st.lists(st.integers(0, 3), min_size=1, max_size=4),
    grid=st.dictionaries(
        st.sampled_from(["steps", "discount", "entropy"]), st.lists(st.integers(0, 2), min_size=1, max_size=2)
    ),
)
def test_the_product_is_complete(
    presets: list[str], algos: list[str], seeds: list[int], grid: dict[str, list[int]]
) -> None:
    models = ["bifurcation"]
    content = {"models": models, "presets": presets, "algos": algos, "seeds": seeds, "set": grid}
    jobs = expand(parse_sweep(content))
    lists: list[list[Any]] = [presets, algos, seeds, *grid.values()]
    sizes = [len(set(values)) for values in lists]
    assert len(jobs) == math.prod(sizes)
    assert len({job.name for job in jobs}) == len(jobs)
    for job in jobs:
        assert job.preset in presets
        assert job.algo in algos
        assert job.seed in seeds
        assert {key: value in grid[key] for key, value in job.settings} == dict.fromkeys(grid, True)


def test_one_value_stands_for_a_list_of_one() -> None:
    short = parse_sweep({"models": "bifurcation", "seeds": 3, "set": {"steps": 5}})
    assert short == parse_sweep({"models": ["bifurcation"], "seeds": [3], "set": {"steps": [5]}})
    (job,) = expand(short)
    assert (job.preset, job.algo, job.seed, job.settings, job.pairs) == (
        "best",
        "ppo",
        3,
        (("steps", 5),),
        500,
    )


def test_toml_and_json_say_the_same(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(
        '{"models": ["serpentine"], "seeds": [0, 1], "set": {"discount": [0.99]}}'
    )
    (tmp_path / "a.toml").write_text('models = ["serpentine"]\nseeds = [0, 1]\n[set]\ndiscount = [0.99]\n')
    assert read_sweep(tmp_path / "a.json") == read_sweep(tmp_path / "a.toml")


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        ({}, "models: Field required"),
        ([], "the whole: should be"),
        ({"models": []}, "models: .*at least 1"),
        ({"models": ["m"], "seed": [0]}, "seed: there is no such field .*seeds"),
        ({"models": ["m"], "seeds": [-1]}, "seeds.0: should be greater"),
        ({"models": ["m"], "seeds": ["1"]}, "seeds.0: should be a valid integer"),
        ({"models": ["m"], "algos": ["sac"]}, "algos.0: should be 'ppo' or 'a2c'"),
        ({"models": ["m"], "pairs": 0}, "pairs: should be greater"),
        ({"models": ["m"], "set": {"steps": [[1]]}}, "set.steps.0: should be a number"),
        ({"models": ["m"], "set": {"steps": [math.inf]}}, "set.steps.0: should be a finite number"),
    ],
)
def test_what_is_wrong_is_named(content: object, fault: str) -> None:
    with pytest.raises(ConfigError, match=fault):
        parse_sweep(content)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.json: cannot be read"):
        read_sweep(tmp_path / "none.json")
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(ConfigError, match=r"bad\.json: is neither JSON"):
        read_sweep(tmp_path / "bad.json")


def test_a_job_that_cannot_start_is_refused_before_any_does() -> None:
    for wrong, fault in (
        ({"presets": ["best", "bset"]}, "bset"),
        ({"set": {"discuont": [0.9]}}, "discuont"),
        ({"set": {"discount": [0.9, 1.5]}}, "discount"),
        ({"set": {"steps": ["many"]}}, "many"),
    ):
        with pytest.raises(ConfigError, match=fault):
            check(expand(parse_sweep({"models": ["bifurcation"], **wrong})))
    check(
        expand(parse_sweep({"models": "bifurcation", "set": {"normalise": [True, False], "steps": [0, 10]}}))
    )
    with pytest.raises(ConfigError, match="nowhere"):
        expand(parse_sweep({"models": ["nowhere"]}))


def test_another_vessel_under_the_same_name_is_another_job(tmp_path: Path) -> None:
    names = []
    for size in (60, 70):
        mask = np.full((size, size), 255, np.uint8)
        save_vessel_model(tmp_path / "m", vessel_map("m", mask, robot_radius_um=100.0), "m", "test")
        names.append(expand(parse_sweep({"models": [str(tmp_path / "m")]}))[0].name)
    assert names[0] != names[1]


def job(seed: int, **changed: float) -> Job:
    return Job("bifurcation", "0" * 64, "best", "ppo", seed, tuple(sorted(changed.items())), 10)


def result(of: Job, success: float = 1.0, spl: float = 0.9) -> dict[str, Any]:
    figures = {"success": success, "spl": spl, "wall_hits": 0.0}
    return {"spec": of.spec(), **figures, "sampled": figures, "cpu_s": 10.0}


def finish(of: Job, out: Path) -> None:
    (out / of.name).mkdir(parents=True)
    (out / of.name / RESULT_FILE).write_text(json.dumps(result(of)))


def test_done_jobs_are_skipped_and_half_written_folders_redone(tmp_path: Path) -> None:
    done, half, failed, fresh = (job(seed) for seed in range(4))
    finish(done, tmp_path)
    for folder, file in ((half, "policy.pt"), (failed, ERROR_FILE)):
        (tmp_path / folder.name).mkdir()
        (tmp_path / folder.name / file).write_text("left over")

    def runner(jobs: Sequence[Job], out: Path) -> Events:
        for one in jobs:
            assert not (out / one.name).exists()
            assert settled(one, out) is None
            finish(one, out)
            yield Event(one, "done")

    events = list(run_sweep([done, half, failed, fresh], tmp_path, runner))
    assert [event.kind for event in events] == ["skipped", "done", "done", "done"]
    again = run_sweep([done, half, failed, fresh], tmp_path, runner)
    assert [event.kind for event in again] == ["skipped"] * 4
    shutil.rmtree(tmp_path / half.name)
    assert [event.job for event in run_sweep([done, half], tmp_path, runner) if event.kind == "done"] == [
        half
    ]


def test_what_a_job_left_tells_what_became_of_it(tmp_path: Path) -> None:
    finish(job(0), tmp_path)
    (tmp_path / job(1).name).mkdir()
    (tmp_path / job(1).name / ERROR_FILE).write_text("Traceback\n  lines\nValueError: too small\n")
    assert settled(job(0), tmp_path) == Event(job(0), "done")
    assert settled(job(1), tmp_path) == Event(job(1), "failed", "ValueError: too small")
    assert settled(job(2), tmp_path) is None


def test_leaderboard_in_closed_form(tmp_path: Path) -> None:
    good, bad = {"discount": 0.999}, {"discount": 0.99}
    results = [
        result(job(0, **bad), 0.1),
        result(job(2, **good), 0.8, spl=0.7),
        result(job(0, **good), 0.6, spl=0.5),
        result(job(1, **good), 0.7, spl=0.6),
    ]
    first, second = rows = leaderboard(results)
    assert (first.setting["discount"], first.seeds, second.seeds) == (0.999, (0, 1, 2), (0,))
    success = first.figures["success_greedy"]
    assert (success.mean, success.deviation) == pytest.approx((0.7, 0.1))
    assert second.figures["success_greedy"].deviation is None
    write_leaderboard(rows, tmp_path)
    stored = json.loads((tmp_path / "leaderboard.json").read_text())
    with (tmp_path / "leaderboard.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    assert [row["spl_greedy"] for row in stored] == pytest.approx([0.6, 0.9])
    assert [float(row["spl_greedy_spread"] or "nan") for row in table] == pytest.approx(
        [0.1, math.nan], nan_ok=True
    )
    assert [row["seeds"] for row in table] == ["0 1 2", "0"]
    assert {row["simulated"] for row in table} == {"True"}


def test_equal_success_is_ranked_by_path_efficiency() -> None:
    rows = leaderboard([result(job(0, clip=0.1), spl=0.8), result(job(0, clip=0.2), spl=0.9)])
    assert [row.setting["clip"] for row in rows] == [0.2, 0.1]


def test_ray_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ConfigError, match=r"pip install 'mrnav-server\[ray\]'"):
        connect("auto")
