"""Jobs in real processes: one killed, one that kills, one that fails, a sweep that is interrupted."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import psutil

from mrnav_server.training.leaderboard import CSV_FILE, JSON_FILE
from mrnav_server.training.sweep import Job, PooledJob, expand, parse_sweep, run_sweep
from mrnav_server.training.sweep_job import read_error, read_result, run_job
from mrnav_server.training.sweep_pool import run_on_processes

QUICK = {"hidden": 8, "cloning.labels": 200, "cloning.updates": 20, "steps": 0}
LIMIT_S = 60.0


def jobs_of(model: Path, count: int) -> list[Job]:
    return expand(
        parse_sweep({"models": [str(model)], "seeds": list(range(count)), "set": QUICK, "pairs": 1})
    )


def kill(pid: int | None) -> None:
    assert pid is not None
    os.kill(pid, signal.SIGKILL)


def test_a_killed_worker_loses_nothing(model: Path, tmp_path: Path) -> None:
    jobs, out = jobs_of(model, 2), tmp_path / "out"
    kinds: dict[PooledJob, list[str]] = {job: [] for job in jobs}
    texts = []
    for event in run_sweep(jobs, out, lambda left, where: run_on_processes(left, where, workers=2)):
        if event.kind == "started" and event.job == jobs[0] and not kinds[jobs[0]]:
            kill(event.pid)
        kinds[event.job].append(event.kind)
        texts.append(event.text)
    assert kinds == {jobs[0]: ["started", "lost", "started", "done"], jobs[1]: ["started", "done"]}
    assert any("SIGKILL" in text for text in texts)
    assert all((out / job.name / "policy.pt").is_file() for job in jobs)


def test_a_job_that_keeps_killing_its_worker_is_named_and_another_that_fails_too(
    model: Path, tmp_path: Path
) -> None:
    good, killer, wrong = jobs_of(model, 3)
    wrong = Job(wrong.model, "0" * 64, wrong.preset, wrong.algo, wrong.seed, wrong.settings, wrong.pairs)
    out = tmp_path / "out"
    counts = Counter[tuple[PooledJob, str]]()
    failures = {}
    for event in run_on_processes([killer, wrong, good], out, workers=1):
        counts[event.job, event.kind] += 1
        if event.kind == "started" and event.job == killer:
            kill(event.pid)
        if event.kind == "failed":
            failures[event.job] = event.text
    assert counts[killer, "started"] == 4
    assert counts[killer, "lost"] == 3
    assert counts[good, "done"] == 1
    assert set(failures) == {killer, wrong}
    assert "4 workers died of it" in failures[killer]
    assert "holds another mask" in failures[wrong]
    assert "holds another mask" in (read_error(out / wrong.name) or "")


def test_a_job_is_a_function_of_its_spec(model: Path, tmp_path: Path) -> None:
    (job,) = jobs_of(model, 1)
    policies = []
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "half-written").touch()
        run_job(job.spec(), tmp_path / name)
        result = read_result(tmp_path / name)
        assert result is not None, read_error(tmp_path / name)
        assert result["spec"] == job.spec()
        assert not (tmp_path / name / "half-written").exists()
        policies.append({key: result[key] for key in ("success", "spl", "steps_ratio", "sampled")})
    assert policies[0] == policies[1]
    before = (tmp_path / "one" / "result.json").stat().st_mtime_ns
    run_job(job.spec(), tmp_path / "one")
    assert (tmp_path / "one" / "result.json").stat().st_mtime_ns == before


def start(spec: Path, out: Path) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "mrnav_server.cli.main", "sweep", str(spec), "--out", str(out)]
    return subprocess.Popen(
        [*command, "--workers", "1", "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def until_done(out: Path, count: int) -> None:
    deadline_s = time.monotonic() + LIMIT_S
    while len(list(out.glob("*/result.json"))) < count:
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


def test_an_interrupted_sweep_goes_on(model: Path, tmp_path: Path) -> None:
    spec, out = tmp_path / "spec.json", tmp_path / "out"
    spec.write_text(json.dumps({"models": [str(model)], "seeds": [0, 1, 2], "set": QUICK, "pairs": 1}))
    first = start(spec, out)
    until_done(out, 1)
    workers = psutil.Process(first.pid).children(recursive=True)
    first.send_signal(signal.SIGINT)
    _, told = first.communicate(timeout=LIMIT_S)
    assert first.returncode == 130, told
    assert "of 3 jobs are done; the same command goes on" in told
    _, alive = psutil.wait_procs(workers, timeout=LIMIT_S)
    assert not alive
    done = len(list(out.glob("*/result.json")))
    assert done < 3

    second = start(spec, out)
    until_done(out, done + 1)
    workers = psutil.Process(second.pid).children(recursive=True)
    second.kill()
    second.communicate(timeout=LIMIT_S)
    _, alive = psutil.wait_procs(workers, timeout=LIMIT_S)
    assert not alive, "workers outlive a sweep that was killed, and would write beside the next one"

    third = start(spec, out)
    printed, told = third.communicate(timeout=LIMIT_S)
    assert third.returncode == 0, told
    answer = json.loads(printed.splitlines()[-1])
    assert answer["jobs"] == 3 == answer["done"] + answer["skipped"]
    assert answer["skipped"] >= done + 1
    assert [row["seeds"] for row in answer["leaderboard"]] == ["0 1 2"]
    assert (out / JSON_FILE).is_file()
    assert (out / CSV_FILE).is_file()


def test_a_failed_job_is_told_and_the_exit_code_says_so(model: Path, tmp_path: Path) -> None:
    spec, out, broken = tmp_path / "spec.json", tmp_path / "out", tmp_path / "broken"
    shutil.copytree(model, broken)
    (broken / "mask.png").unlink()
    spec.write_text(json.dumps({"models": [str(broken), str(model)], "set": QUICK, "pairs": 1}))
    run = start(spec, out)
    printed, told = run.communicate(timeout=LIMIT_S)
    assert run.returncode == 1
    assert "failed: broken, best, ppo, seed 0" in told
    assert "mask.png is missing" in told
    answer = json.loads(printed.splitlines()[-1])
    assert (answer["done"], answer["failed"]) == (1, 1)
    assert [row["model"] for row in answer["leaderboard"]] == [str(model)]
