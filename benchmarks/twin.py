"""The twin stream under load: how old a state is at its clients, what sending costs, and who is held up.

Run from a checkout: ``python -m benchmarks.twin``. Prints one JSON object. The server is a whole one on the
simulated rig; the clients have processes of their own on the same machine, and their own work is in the ages.
The server's CPU time is that beyond what the same server takes without these clients. Beside it, when
foxglove-sdk is installed, Foxglove's server sends the same state to the same clients.
"""

import argparse
import importlib.util
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks._twin_clients import Client
from benchmarks._twin_foxglove import PATH, PROTOCOL, SUBSCRIBE
from tests.rig_process import RigProcess

_CLIENTS_A_PROCESS = 25
"""Real ones have a machine each: in one process they wait for one another."""
_STALLED_AGAINST = 10


def twin(seconds: float, counts: tuple[int, ...]) -> dict[str, Any]:
    """Return ages in ms, rates in Hz and CPU in percent of a core, by number of clients.

    Args:
        seconds: Length of each measurement.
        counts: Numbers of clients.
    """
    with tempfile.TemporaryDirectory() as folder:
        rig = RigProcess(Path(folder))
        try:
            rig.until(lambda s: s["track"]["state"] == "tracking", "finding the robot")
            port = rig.ready["port"]
            path = f"/ws/twin?rate_hz=60&token={rig.ready['viewer_token']}"
            idle_percent = _cpu_percent(rig.process.pid, lambda: time.sleep(seconds))
            found = {
                str(count): _measured(rig.process.pid, port, [path], count, seconds, idle_percent)
                for count in counts
            }
            stalled = Client(port, path, "", "", receive_bytes=4096)
            healthy = _measured(rig.process.pid, port, [path], _STALLED_AGAINST, seconds, idle_percent)
            stalled.socket.close()
            state = json.dumps({k: v for k, v in rig.state.items() if k not in ("type", "t")})
        finally:
            rig.end()
    return {
        "simulated": True,
        "seconds": seconds,
        "clients": found,
        "stalled": {"healthy_rate_hz": healthy["slowest_hz"]},
        "foxglove": _foxglove(state, max(counts), seconds),
    }


def _foxglove(state: str, count: int, seconds: float) -> dict[str, float] | None:
    """Return the same figures for Foxglove's server and the largest number of clients; None without it."""
    if importlib.util.find_spec("foxglove") is None:
        return None
    server = subprocess.Popen(
        [sys.executable, "-m", "benchmarks._twin_foxglove"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert server.stdin is not None
        assert server.stdout is not None
        server.stdin.write(state + "\n")
        server.stdin.flush()
        ready = json.loads(server.stdout.readline())
        subscribe = SUBSCRIBE.replace('"channelId":1', f'"channelId":{ready["channel"]}')
        idle_percent = _cpu_percent(server.pid, lambda: time.sleep(seconds))
        options = [PATH, "--protocol", PROTOCOL, "--subscribe", subscribe]
        return _measured(server.pid, ready["port"], options, count, seconds, idle_percent)
    finally:
        server.kill()
        server.wait()


def _measured(
    pid: int, port: int, options: list[str], count: int, seconds: float, idle_percent: float
) -> dict[str, float]:
    path, *more = options
    parts = [min(_CLIENTS_A_PROCESS, count - n) for n in range(0, count, _CLIENTS_A_PROCESS)]
    command = [sys.executable, "-m", "benchmarks._twin_clients", str(port), path]
    processes = [
        subprocess.Popen([*command, str(n), str(seconds), *more], stdout=subprocess.PIPE, text=True)
        for n in parts
    ]
    answers: list[dict[str, list[float]]] = []

    def listen() -> None:
        answers.extend(json.loads(process.communicate()[0]) for process in processes)

    try:
        for process in processes:
            assert process.stdout is not None
            if process.stdout.readline() != "ready\n":
                raise RuntimeError("the clients could not connect: see above")
        cpu_percent = _cpu_percent(pid, listen)
    finally:
        for process in processes:
            process.kill()
    ages_ms = np.concatenate([answer["ages_ms"] for answer in answers])
    rates_hz = np.concatenate([answer["rates_hz"] for answer in answers])
    p50_ms, p99_ms = np.percentile(ages_ms, (50, 99))
    return {
        "p50_ms": round(float(p50_ms), 3),
        "p99_ms": round(float(p99_ms), 3),
        "cpu_percent": round(cpu_percent - idle_percent, 1),
        "rate_hz": round(float(rates_hz.mean()), 1),
        "slowest_hz": round(float(rates_hz.min()), 1),
    }


def _cpu_percent(pid: int, work: Callable[[], None]) -> float:
    """Return what a process takes of a core while something else runs."""
    process = psutil.Process(pid)
    before, began_s = process.cpu_times(), time.monotonic()
    work()
    after, took_s = process.cpu_times(), time.monotonic() - began_s
    return 100.0 * (after.user + after.system - before.user - before.system) / took_s


def main() -> None:
    """Measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--clients", type=int, nargs="+", default=[1, 10, 100])
    asked = parser.parse_args()
    print(json.dumps(twin(asked.seconds, tuple(asked.clients))))


if __name__ == "__main__":
    main()
