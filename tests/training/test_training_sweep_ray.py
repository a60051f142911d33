"""A sweep on two local Ray nodes of which one loses its worker, and then dies altogether."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import psutil
import pytest

from tests.vessels import saved_chamber

pytestmark = [pytest.mark.ray, pytest.mark.slow, pytest.mark.timeout(600)]

JOBS = 8
LIMIT_S = 240.0
SETTINGS = {"hidden": 8, "cloning.labels": 20_000, "cloning.updates": 8_000, "cloning.batch": 64, "steps": 0}


def until(condition: Callable[[], object]) -> None:
    deadline_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


def is_up(log: Path) -> bool:
    return "Ray runtime started" in log.read_text()


def workers(node: psutil.Process) -> list[psutil.Process]:
    return [p for p in node.children(recursive=True) if "ray::run_job" in " ".join(p.cmdline())]


@pytest.fixture
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, psutil.Process]]:
    """Yield the address of a cluster of two nodes, and the process of the second."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{probe.getsockname()[1]}"
    logs = tmp_path_factory.mktemp("ray")
    common = ["--block", "--num-cpus=1", "--object-store-memory=100000000", "--disable-usage-stats"]
    head = ["--head", f"--port={address.partition(':')[2]}", "--include-dashboard=false"]
    with ExitStack() as stack:
        started = []
        for name, options in (("head", head), ("second", [f"--address={address}"])):
            log = stack.enter_context((logs / name).open("w"))
            ray = Path(sys.executable).with_name("ray")
            process = subprocess.Popen([ray, "start", *options, *common], stdout=log, stderr=log)
            stack.callback(process.wait)
            stack.callback(end, process.pid)
            started.append(psutil.Process(process.pid))
            until(partial(is_up, logs / name))
        yield address, started[1]


def end(pid: int) -> None:
    if psutil.pid_exists(pid):
        for process in [*psutil.Process(pid).children(recursive=True), psutil.Process(pid)]:
            process.kill()


def test_a_killed_worker_and_a_killed_node_lose_nothing(
    cluster: tuple[str, psutil.Process], tmp_path: Path
) -> None:
    address, second = cluster
    spec, out = tmp_path / "spec.json", tmp_path / "out"
    content = {
        "models": [str(saved_chamber(tmp_path))],
        "seeds": list(range(JOBS)),
        "set": SETTINGS,
        "pairs": 1,
    }
    spec.write_text(json.dumps(content))
    command = [sys.executable, "-m", "mrnav_server.cli.main", "sweep", str(spec)]
    sweep = subprocess.Popen(
        [*command, "--out", str(out), "--ray", address, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )

    until(lambda: len(list(out.glob("*/result.json"))) >= 2 and workers(second))
    os.kill(workers(second)[0].pid, signal.SIGKILL)
    until(lambda: workers(second))
    end(second.pid)

    printed, told = sweep.communicate(timeout=LIMIT_S)
    assert sweep.returncode == 0, told
    answer = json.loads(printed.splitlines()[-1])
    assert (answer["jobs"], answer["done"], answer["failed"]) == (JOBS, JOBS, 0)
    assert answer["lost"] >= 1
    assert answer["leaderboard"][0]["seeds"] == "0 1 2 3 4 5 6 7"
