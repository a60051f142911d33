"""Jobs on this machine: a few processes at a time, each for one job, with one thread.

A process that is killed takes nothing with it but its own job, which is started again.
"""

import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Sequence
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

from mrnav_server.training.sweep import Event, Events, PooledJob, Work, dead, settled
from mrnav_server.training.sweep_job import run_job

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def run_on_processes(jobs: Sequence[PooledJob], out: Path, workers: int, work: Work = run_job) -> Events:
    """Run jobs in processes of this machine; ending the iteration early ends them.

    Args:
        jobs: Each job once.
        out: Gets one folder per job.
        workers: Processes at a time, at least 1.
        work: What is done with each.
    """
    waiting, lost = deque(jobs), Counter[PooledJob]()
    running: dict[int, tuple[SpawnProcess, PooledJob]] = {}
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                job = waiting.popleft()
                process = _start(job, out, work)
                running[process.sentinel] = process, job
                yield Event(job, "started", pid=process.pid)
            for sentinel in wait(list(running)):
                assert isinstance(sentinel, int)
                process, job = running.pop(sentinel)
                process.join()
                event = settled(job, out)
                if event is None:
                    lost[job] += 1
                    event = dead(job, lost[job], f"process {process.pid} {_end(process.exitcode or 0)}")
                    if event.kind == "lost":
                        waiting.append(job)
                yield event
    finally:
        for process, _ in running.values():
            process.kill()
            process.join()


def _start(job: PooledJob, out: Path, work: Work) -> SpawnProcess:
    arguments = work, job.spec(), out / job.name
    process = get_context("spawn").Process(target=_work, args=arguments, daemon=True)
    process.start()
    return process


def _end(code: int) -> str:
    if code >= 0:
        return f"left with {code}"
    return f"was ended by {signal.Signals(-code).name}"


def _work(work: Work, spec: dict[str, Any], folder: Path) -> None:
    signal.signal(
        signal.SIGINT, signal.SIG_IGN
    )  # Ctrl-C reaches the whole group; the sweep ends its workers.
    threading.Thread(target=_die_with_parent, daemon=True).start()
    os.environ.update(dict.fromkeys(_THREADS, "1"))  # Read when PyTorch is imported; Ray does the same.
    work(spec, folder)


def _die_with_parent() -> None:
    """End this process when the sweep is killed, or two would write to one folder when it is run again."""
    parent = parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)
